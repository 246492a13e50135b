#include "alula/filters/cone_escape.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace alula::flight {
namespace {

using geometry::cross;
using geometry::dot;
using geometry::norm;

constexpr int kMostPasses = 32;
constexpr std::size_t kMostCones = 64;

// h = u^T M u with M = gamma A - A r r^T A, and A r, in the basis (v, left, up) of unit vectors.
struct Form {
  double vv, vl, vu, ll, lu, uu;
  double rv, rl, ru;
};

// The smallest angle beyond `angle` at which (cos, sin) leaves {a cos^2 + 2 b cos sin + c sin^2 < 0}; pi if no such
// angle exists.
double leave(double a, double b, double c, double angle) {
  const double discriminant = b * b - a * c;
  if (discriminant < 0) return std::numbers::pi;
  const double root = std::sqrt(discriminant);
  // Roots of c t^2 + 2 b t + a in t = tan, without cancellation.
  const double q = b >= 0 ? -b - root : -b + root;
  double best = std::numbers::pi;
  for (const double t : {q / c, a / q})
    if (std::isfinite(t) && t > 0 && std::atan(t) > angle) best = std::min(best, std::atan(t));
  return best;
}

}  // namespace

Escapes escape_velocities(const EllipsoidIndex& index, std::span<const Found> near, Vec3 p, Vec3 v,
                          const EscapeOptions& options) {
  Escapes result;
  const double speed = norm(v);
  if (!(speed >= options.least_speed_m_s)) return result;
  const Vec3 ahead = 1 / speed * v;
  const double flat = std::hypot(ahead.x, ahead.y);
  const Vec3 left = flat > 1e-3 ? Vec3{-ahead.y / flat, ahead.x / flat, 0} : Vec3{0, 1, 0};
  Vec3 up = cross(ahead, left);
  up = 1 / norm(up) * up;

  std::array<Form, kMostCones> form;
  std::size_t cones = 0;
  for (const Found& found : near) {
    if (cones == kMostCones) break;
    if (found.item >= index.size()) continue;
    const GrownEllipsoid& e = index.grown(found.item);
    const Cone c = collision_cone(e, p, ahead);
    if (c.is_inside()) continue;
    const Vec3 al = e.a * left, au = e.a * up;
    const double rv = c.delta, rl = dot(c.ar, left), ru = dot(c.ar, up);
    form[cones++] = {c.h,
                     c.gamma * dot(left, c.av) - rv * rl,
                     c.gamma * dot(up, c.av) - rv * ru,
                     c.gamma * dot(left, al) - rl * rl,
                     c.gamma * dot(left, au) - rl * ru,
                     c.gamma * dot(up, au) - ru * ru,
                     rv,
                     rl,
                     ru};
  }

  for (std::size_t i = 0; i < kEscapes; ++i) {
    const double about = std::numbers::pi / 4 * static_cast<double>(i);
    const double l = std::cos(about), u = std::sin(about);
    double angle = 0;
    bool met = true;
    for (int pass = 0; met && pass < kMostPasses && angle <= options.most_rad; ++pass) {
      met = false;
      for (std::size_t k = 0; k < cones; ++k) {
        const Form& f = form[k];
        const double cosine = std::cos(angle), sine = std::sin(angle);
        const double b = f.vl * l + f.vu * u, c = f.ll * l * l + 2 * f.lu * l * u + f.uu * u * u;
        const bool approaching = f.rv * cosine + (f.rl * l + f.ru * u) * sine > 0;
        if (!approaching || f.vv * cosine * cosine + 2 * b * cosine * sine + c * sine * sine > 0) continue;
        met = true;
        angle = leave(f.vv, b, c, angle) + options.slack_rad;
        if (angle > options.most_rad) break;
      }
    }
    if (met || angle > options.most_rad) continue;
    result.velocity[result.count] = speed * (std::cos(angle) * ahead + std::sin(angle) * (l * left + u * up));
    result.turn[result.count++] = angle;
  }
  for (std::size_t i = 1; i < result.count; ++i)  // stable sort by the angle
    for (std::size_t j = i; j > 0 && result.turn[j] < result.turn[j - 1]; --j)
      std::swap(result.turn[j], result.turn[j - 1]), std::swap(result.velocity[j], result.velocity[j - 1]);
  return result;
}

}  // namespace alula::flight
