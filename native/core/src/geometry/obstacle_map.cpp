#include "alula/geometry/obstacle_map.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "alula/base/constants.hpp"
#include "alula/base/least.hpp"
#include "alula/base/require.hpp"

namespace alula {
namespace {

using geometry::dot;
using geometry::from_rows;
using geometry::norm;

constexpr double kRounding = 1e-14;  // bound on the error of a distance, as a fraction of the coordinates

// The distance that an obstacle must have to be clear of a ball of radius d, for coordinates up to `extent`.
double with_rounding(double d, double extent = 0) { return (1 + 1e-8) * d + 1e-9 + kRounding * extent; }

double largest(geometry::Vec3 p) { return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}); }

bool is_usable(geometry::Vec3 a, geometry::Vec3 b, double d) { return is_finite(a) && is_finite(b) && is_size(d); }

Contact contact(ObstacleKind kind, std::uint32_t index, geometry::Vec3 p, double distance, geometry::Vec3 normal) {
  return {kind, index, distance, normal, p - distance * normal};
}

// ObstacleMap::near of a map that visits all contacts.
void near_of(const ObstacleMap& map, geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
             MapMemory& memory) {
  found.clear();
  if (most == 0) return;
  double within = reach;
  const auto keep = [&](const Contact& c) {
    if (!keep_least(found, most, c, nearer)) return;
    within = std::nextafter(found.front().distance, kInfinity);  // the index decides between equal distances
  };
  map.visit(p, within, std::ref(keep), memory);
  std::sort(found.begin(), found.end(), nearer);
}

// True if distance(k) is at least `needed` for all obstacles of a tree near the segment a..b.
template <class Distance>
bool is_clear_of(const geometry::Bvh& tree, geometry::Vec3 a, geometry::Vec3 b, double needed, MapMemory& memory,
                 Distance&& distance) {
  double within = needed;  // ends the search once an obstacle is nearer
  const auto look_at = [&](std::uint32_t k) {
    if (within < needed || !(distance(k) < needed)) return;
    within = -kInfinity, memory.nearest = k;
  };
  if (memory.nearest < tree.order().size()) look_at(memory.nearest);
  tree.visit_near(a, b - a, within, [&](std::uint32_t, std::uint32_t k) { look_at(k); });
  return within == needed;
}

}  // namespace

bool nearer(const Contact& a, const Contact& b) {
  return std::tie(a.distance, a.kind, a.index) < std::tie(b.distance, b.kind, b.index);
}

void ObstacleMap::visit(geometry::Vec3 p, const double& reach, const Visit& visit, MapMemory& memory) const {
  near(p, reach, kVisited, memory.contacts, memory);
  for (const Contact& c : memory.contacts)
    if (c.distance < reach) visit(c);
}

EllipsoidMap::EllipsoidMap(std::shared_ptr<const EllipsoidIndex> index) : index_(std::move(index)) {
  require(index_ != nullptr, "a map of ellipsoids needs an index");
}

MapMemory EllipsoidMap::memory() const {
  MapMemory memory;
  memory.found.reserve(kVisited);
  memory.contacts.reserve(kVisited);
  return memory;
}

double EllipsoidMap::distance(geometry::Vec3 p, double upto, MapMemory& memory) const {
  return index_->clearance(p, upto, memory.nearest);
}

double EllipsoidMap::segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const {
  // A point of the segment that is nearer than `upto` is within this of its start.
  const double reach_of_start = upto + norm(b - a);
  index_->nearest(a, b, reach_of_start, 1, memory.found);
  return memory.found.empty() ? upto : std::max(0.0, memory.found[0].distance);
}

void EllipsoidMap::near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
                        MapMemory& memory) const {
  index_->nearest(p, p, reach, most, memory.found);
  found.clear();
  for (const Found& each : memory.found)
    found.push_back(contact(ObstacleKind::ellipsoid, each.item, p, each.distance,
                            geometry::signed_distance(index_->ellipsoid(each.item), p).normal));
}

bool EllipsoidMap::is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory&) const {
  return is_usable(a, b, d) && !index_->is_near(a, b, with_rounding(d));
}

EllipsoidSetMap::EllipsoidSetMap(std::shared_ptr<const EllipsoidSet> set) : set_(std::move(set)) {
  require(set_ != nullptr, "a map of ellipsoids needs a set");
}

double EllipsoidSetMap::distance(geometry::Vec3 p, double upto, MapMemory& memory) const {
  return set_->clearance(p, p, upto, memory.nearest, memory.scratch);
}

double EllipsoidSetMap::segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const {
  return std::max(0.0, set_->clearance(a, b, upto, memory.nearest, memory.scratch));
}

void EllipsoidSetMap::visit(geometry::Vec3 p, const double& reach, const Visit& visit, MapMemory&) const {
  set_->tree().visit_near(p, {}, reach, [&](std::uint32_t, std::uint32_t k) {
    const auto [ellipsoid, radius] = set_->grown(k);
    const geometry::SignedDistance at = geometry::signed_distance(ellipsoid, p);
    const double distance = at.value - radius;
    if (distance < reach) visit(contact(ObstacleKind::ellipsoid, k, p, distance, at.normal));
  });
}

void EllipsoidSetMap::near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
                           MapMemory& memory) const {
  near_of(*this, p, reach, most, found, memory);
}

bool EllipsoidSetMap::is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const {
  if (!is_usable(a, b, d)) return false;
  const double needed = with_rounding(d, std::max(largest(a), largest(b)));
  return is_clear_of(set_->tree(), a, b, needed, memory, [&](std::uint32_t k) {
    const auto [ellipsoid, radius] = set_->grown(k);
    return geometry::signed_distance(ellipsoid, a, b, needed + radius) - radius;
  });
}

HullMap::HullMap(std::shared_ptr<const PolytopeSet> hulls) : hulls_(std::move(hulls)) {
  require(hulls_ != nullptr, "a map of hulls needs hulls");
  for (std::size_t k = 0; k < hulls_->size(); ++k)
    most_planes_ = std::max(most_planes_, hulls_->polytope(k).offsets.size());
  if (const geometry::Box* box = hulls_->tree().bounds())
    extent_ = std::max(largest(box->lower), largest(box->upper));
}

MapMemory HullMap::memory() const {
  MapMemory memory;
  memory.scratch.reserve(2 * most_planes_);
  return memory;
}

double HullMap::distance(geometry::Vec3 p, double upto, MapMemory& memory) const {
  return hulls_->clearance(p, p, upto, memory.nearest, memory.scratch);
}

double HullMap::segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const {
  return std::max(0.0, hulls_->clearance(a, b, upto, memory.nearest, memory.scratch));
}

void HullMap::visit(geometry::Vec3 p, const double& reach, const Visit& visit, MapMemory&) const {
  hulls_->tree().visit_near(p, {}, reach, [&](std::uint32_t, std::uint32_t k) {
    const geometry::SignedDistance at = geometry::signed_distance(hulls_->polytope(k), p, reach);
    if (at.value < reach) visit(contact(ObstacleKind::hull, k, p, at.value, at.normal));
  });
}

void HullMap::near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
                   MapMemory& memory) const {
  near_of(*this, p, reach, most, found, memory);
}

bool HullMap::is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const {
  if (!is_usable(a, b, d)) return false;
  const double needed = with_rounding(d, std::max({extent_, largest(a), largest(b)}));
  return is_clear_of(hulls_->tree(), a, b, needed, memory, [&](std::uint32_t k) {
    return geometry::signed_distance(hulls_->polytope(k), a, b, needed, memory.scratch);
  });
}

FenceMap::FenceMap(std::vector<geometry::HalfSpace> planes) : planes_(std::move(planes)) {
  for (const geometry::HalfSpace& plane : planes_) {
    require(std::abs(norm(plane.normal) - 1) <= 1e-9, "a normal of a fence is not a unit vector");
    require(std::isfinite(plane.offset), "an offset of a fence is not finite");
    extent_ = std::max(extent_, std::abs(plane.offset));
  }
}

double FenceMap::distance_of(geometry::Vec3 p) const {
  double least = kInfinity;
  for (const geometry::HalfSpace& plane : planes_) least = std::min(least, plane.offset - dot(plane.normal, p));
  return least;
}

double FenceMap::distance(geometry::Vec3 p, double, MapMemory&) const { return distance_of(p); }

double FenceMap::segment_distance(geometry::Vec3 a, geometry::Vec3 b, double, MapMemory&) const {
  return std::max(0.0, std::min(distance_of(a), distance_of(b)));
}

void FenceMap::near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found, MapMemory&) const {
  found.clear();
  for (std::uint32_t l = 0; l < planes_.size(); ++l) {
    const double distance = planes_[l].offset - dot(planes_[l].normal, p);
    if (distance < reach) found.push_back(contact(ObstacleKind::fence, l, p, distance, -1.0 * planes_[l].normal));
  }
  std::sort(found.begin(), found.end(), nearer);
  found.resize(std::min(most, found.size()));
}

bool FenceMap::is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory&) const {
  const double needed = with_rounding(d, std::max({extent_, largest(a), largest(b)}));
  return is_usable(a, b, d) && distance_of(a) >= needed && distance_of(b) >= needed;
}

MapUnion::MapUnion(std::vector<std::shared_ptr<const ObstacleMap>> maps) : maps_(std::move(maps)) {
  require(!maps_.empty(), "a union of maps needs a map");
  for (const auto& map : maps_) require(map != nullptr, "a part of a union of maps is missing");
}

MapMemory MapUnion::memory() const {
  MapMemory memory;
  for (const auto& map : maps_) memory.parts.push_back(map->memory());
  return memory;
}

double MapUnion::distance(geometry::Vec3 p, double upto, MapMemory& memory) const {
  for (std::size_t i = 0; i < maps_.size(); ++i) upto = std::min(upto, maps_[i]->distance(p, upto, memory.parts[i]));
  return upto;
}

double MapUnion::segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const {
  for (std::size_t i = 0; i < maps_.size(); ++i)
    upto = std::min(upto, maps_[i]->segment_distance(a, b, upto, memory.parts[i]));
  return upto;
}

void MapUnion::near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
                    MapMemory& memory) const {
  std::vector<Contact>& all = memory.contacts;
  all.clear();
  for (std::size_t i = 0; i < maps_.size(); ++i) {
    maps_[i]->near(p, reach, most, found, memory.parts[i]);
    all.insert(all.end(), found.begin(), found.end());
  }
  std::stable_sort(all.begin(), all.end(), nearer);
  found.assign(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(std::min(most, all.size())));
}

void MapUnion::visit(geometry::Vec3 p, const double& reach, const Visit& visit, MapMemory& memory) const {
  for (std::size_t i = 0; i < maps_.size(); ++i) maps_[i]->visit(p, reach, visit, memory.parts[i]);
}

bool MapUnion::is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const {
  for (std::size_t i = 0; i < maps_.size(); ++i)
    if (!maps_[i]->is_clear(a, b, d, memory.parts[i])) return false;
  return true;
}

GrownMap::GrownMap(std::shared_ptr<const ObstacleMap> map, double by) : map_(std::move(map)), by_(by) {
  require(map_ != nullptr, "a grown map needs a map");
  require(is_size(by), "obstacles grow by a finite length of at least 0");
}

double GrownMap::distance(geometry::Vec3 p, double upto, MapMemory& memory) const {
  return map_->distance(p, upto + by_, memory) - by_;
}

double GrownMap::segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const {
  return std::max(0.0, map_->segment_distance(a, b, upto + by_, memory) - by_);
}

void GrownMap::near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
                    MapMemory& memory) const {
  map_->near(p, reach + by_, most, found, memory);
  for (Contact& c : found) c.distance -= by_, c.point = c.point + by_ * c.normal;
}

bool GrownMap::is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const {
  return is_size(d) && map_->is_clear(a, b, d + by_, memory);
}

}  // namespace alula
