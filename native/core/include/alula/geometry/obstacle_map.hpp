// Static obstacle maps: one interface to ellipsoids, convex hulls, fences and unions of them.
//
// The signed distance of a map is 1-Lipschitz: outside the obstacles it is the Euclidean distance to the nearest one,
// inside it is negative. A certificate over a map (alula/filters/shield.hpp) uses only this and the swept clearance.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "alula/geometry/clearance.hpp"
#include "alula/geometry/ellipsoid_index.hpp"
#include "alula/geometry/solid.hpp"

namespace alula {

enum class ObstacleKind : std::uint8_t { ellipsoid, hull, fence };

// An obstacle near a point. point = p - distance * normal.
struct Contact {
  ObstacleKind kind = ObstacleKind::ellipsoid;
  std::uint32_t index = 0;  // of the ellipsoid, the hull or the plane of a fence, within its map
  double distance = 0;      // signed [m]
  geometry::Vec3 normal;    // unit vector, from the obstacle to the free side: the gradient of the distance
  geometry::Vec3 point;     // of the obstacle's surface, nearest to p
};

// Memory of one thread between queries: guesses of the nearest obstacle, and scratch. It does not change a result.
struct MapMemory {
  std::uint32_t nearest = 0;
  std::vector<Found> found;
  std::vector<Contact> contacts;
  std::vector<double> scratch;
  std::vector<MapMemory> parts;  // of a union
};

using Visit = std::function<void(const Contact&)>;
constexpr std::size_t kVisited = 128;  // of a map that finds the nearest only: see `visit`

// By distance; equal ones by kind and index.
bool nearer(const Contact& a, const Contact& b);

// Immutable, shared by threads. Frame and unit (metres) are those of the obstacles. Queries allocate only in their
// outputs and in a memory that is not from `memory()`.
class ObstacleMap {
 public:
  ObstacleMap() = default;
  ObstacleMap(const ObstacleMap&) = delete;
  ObstacleMap& operator=(const ObstacleMap&) = delete;
  virtual ~ObstacleMap() = default;

  // Memory with room for every query.
  virtual MapMemory memory() const = 0;

  // Signed distance of p where it is below `upto`, else some number >= upto.
  virtual double distance(geometry::Vec3 p, double upto, MapMemory& memory) const = 0;

  // Distance of the segment a..b, 0 where it meets an obstacle; exact to 1e-9 of the reach (`upto` and the segment's
  // length) where it is below `upto`, else some number >= upto.
  virtual double segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const = 0;

  // Replaces `found` by the at most `most` obstacles nearer to p than `reach`, by distance, ties by kind and index.
  virtual void near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
                    MapMemory& memory) const = 0;

  // Calls visit(contact) for obstacles nearer to p than `reach`, which `visit` may lower: for all that are nearer
  // than the last value of it, in any order. A map without such a search visits the nearest kVisited.
  virtual void visit(geometry::Vec3 p, const double& reach, const Visit& visit, MapMemory& memory) const;

  // True if the ball of radius d, at least 0, swept from a to b is free. Never wrongly true: rounding counts as
  // contact, which may cost 1e-8 of d and 1e-9 m. False for a value that is not finite.
  virtual bool is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const = 0;
};

// The ungrown ellipsoids of an index: its radius has no influence.
class EllipsoidMap final : public ObstacleMap {
 public:
  // Throws std::invalid_argument without an index.
  explicit EllipsoidMap(std::shared_ptr<const EllipsoidIndex> index);

  const EllipsoidIndex& index() const { return *index_; }

  MapMemory memory() const override;
  double distance(geometry::Vec3 p, double upto, MapMemory& memory) const override;
  double segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const override;
  void near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
            MapMemory& memory) const override;
  bool is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const override;

 private:
  std::shared_ptr<const EllipsoidIndex> index_;
};

// The ellipsoids of a set, by the search tree of its judge: the obstacles of an `EllipsoidMap` without an index,
// which takes five times the memory and answers sooner.
class EllipsoidSetMap final : public ObstacleMap {
 public:
  // Throws std::invalid_argument without a set.
  explicit EllipsoidSetMap(std::shared_ptr<const EllipsoidSet> set);

  MapMemory memory() const override { return {}; }
  double distance(geometry::Vec3 p, double upto, MapMemory& memory) const override;
  double segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const override;
  void near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
            MapMemory& memory) const override;
  void visit(geometry::Vec3 p, const double& reach, const Visit& visit, MapMemory& memory) const override;
  bool is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const override;

 private:
  std::shared_ptr<const EllipsoidSet> set_;
};

// Convex hulls; distances are the lower ends of their brackets, as in clearance.hpp.
class HullMap final : public ObstacleMap {
 public:
  // Throws std::invalid_argument without hulls.
  explicit HullMap(std::shared_ptr<const PolytopeSet> hulls);

  MapMemory memory() const override;
  double distance(geometry::Vec3 p, double upto, MapMemory& memory) const override;
  double segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const override;
  void near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
            MapMemory& memory) const override;
  void visit(geometry::Vec3 p, const double& reach, const Visit& visit, MapMemory& memory) const override;
  bool is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const override;

 private:
  std::shared_ptr<const PolytopeSet> hulls_;
  std::size_t most_planes_ = 0;
  double extent_ = 0;  // bound on all |coordinates| [m]
};

// A convex polytope {x : normal . x <= offset} whose inside is free; each plane is an obstacle. The distance is that
// to the nearest plane: the Euclidean distance to the outside from within, negative outside.
class FenceMap final : public ObstacleMap {
 public:
  // Throws std::invalid_argument for a normal that is not a unit vector, or an offset that is not finite.
  explicit FenceMap(std::vector<geometry::HalfSpace> planes);

  MapMemory memory() const override { return {}; }
  double distance(geometry::Vec3 p, double upto, MapMemory& memory) const override;
  double segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const override;
  void near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
            MapMemory& memory) const override;
  bool is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const override;

 private:
  double distance_of(geometry::Vec3 p) const;

  std::vector<geometry::HalfSpace> planes_;
  double extent_ = 0;
};

// All obstacles of several maps: the distance is the minimum of theirs. Contacts with equal distance, kind and index
// are in the order of the maps.
class MapUnion final : public ObstacleMap {
 public:
  // Throws std::invalid_argument without a map.
  explicit MapUnion(std::vector<std::shared_ptr<const ObstacleMap>> maps);

  MapMemory memory() const override;
  double distance(geometry::Vec3 p, double upto, MapMemory& memory) const override;
  double segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const override;
  void near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
            MapMemory& memory) const override;
  void visit(geometry::Vec3 p, const double& reach, const Visit& visit, MapMemory& memory) const override;
  bool is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const override;

 private:
  std::vector<std::shared_ptr<const ObstacleMap>> maps_;
};

// The obstacles of a map, grown by a length: distances are less by it.
class GrownMap final : public ObstacleMap {
 public:
  // Throws std::invalid_argument without a map, or for a length that is negative or not finite.
  GrownMap(std::shared_ptr<const ObstacleMap> map, double by);

  MapMemory memory() const override { return map_->memory(); }
  double distance(geometry::Vec3 p, double upto, MapMemory& memory) const override;
  double segment_distance(geometry::Vec3 a, geometry::Vec3 b, double upto, MapMemory& memory) const override;
  void near(geometry::Vec3 p, double reach, std::size_t most, std::vector<Contact>& found,
            MapMemory& memory) const override;
  bool is_clear(geometry::Vec3 a, geometry::Vec3 b, double d, MapMemory& memory) const override;

 private:
  std::shared_ptr<const ObstacleMap> map_;
  double by_;
};

}  // namespace alula
