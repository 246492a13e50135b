#include "alula/filters/geofence.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <stdexcept>

#include "alula/base/constants.hpp"
#include "alula/filters/polytope_map.hpp"

namespace alula::flight {

namespace {

// u = 2^-24. For positions up to a kilometre, rounding the normal costs sqrt 3 u 1 km, n . p four times as much,
// and the offset its own rounding.
double lost_by_face(double d) { return 0x1p-24 * (16e3 + 4 * std::abs(d)); }

}  // namespace

alula_fence to_onboard(const Fence& fence) {
  alula_fence onboard{};
  onboard.has_box = fence.box ? 1 : 0;
  for (int i = 0; fence.box && i < 3; ++i) {
    onboard.lower[i] = round_up(fence.box->lower[i]);
    onboard.upper[i] = round_down(fence.box->upper[i]);
  }
  if (fence.faces.size() > ALULA_FENCE_FACES) throw std::invalid_argument("a fence has too many faces");
  onboard.face_count = static_cast<std::uint32_t>(fence.faces.size());
  for (std::size_t l = 0; l < fence.faces.size(); ++l) {
    for (std::size_t i = 0; i < 3; ++i) onboard.face[l][i] = static_cast<float>(fence.faces[l][i]);
    onboard.face[l][3] = round_down(fence.faces[l][3] - lost_by_face(fence.faces[l][3]));
  }
  return onboard;
}

double Fence::clearance(Vec3 a, Vec3 b) const {
  double least = kInfinity;
  for (const Vec3& p : {a, b}) {
    for (int i = 0; box && i < 3; ++i) least = std::min({least, p[i] - box->lower[i], box->upper[i] - p[i]});
    for (const auto& n : faces) least = std::min(least, n[3] - (n[0] * p.x + n[1] * p.y + n[2] * p.z));
  }
  if (keep_out == nullptr || keep_out->size() == 0) return least;
  std::uint32_t nearest = 0;
  std::vector<double> scratch;
  return std::min(least, keep_out->clearance(a, b, std::max(least, 1.0), nearest, scratch));
}

double Fence::distance_to(std::uint32_t constraint, Vec3 p) const {
  const std::uint32_t c = constraint;
  if (c < 3 && box) return p[static_cast<int>(c)] - box->lower[static_cast<int>(c)];
  if (c < ALULA_FENCE_BOX_FACES && box) return box->upper[static_cast<int>(c) - 3] - p[static_cast<int>(c) - 3];
  if (c >= ALULA_FENCE_BOX_FACES && c - ALULA_FENCE_BOX_FACES < faces.size()) {
    const auto& n = faces[c - ALULA_FENCE_BOX_FACES];
    return n[3] - (n[0] * p.x + n[1] * p.y + n[2] * p.z);
  }
  if (c == ALULA_FENCE_MAP && keep_out != nullptr && keep_out->size() > 0) {
    std::uint32_t nearest = 0;
    std::vector<double> scratch;
    return keep_out->clearance(p, p, kInfinity, nearest, scratch);
  }
  return clearance(p, p);
}

std::uint32_t Fence::braked_for(std::uint32_t deciding, Vec3 p, Vec3 v) const {
  if (deciding <= ALULA_FENCE_MAP) return deciding;
  double soonest = kInfinity;
  std::uint32_t found = ALULA_GEOFENCE_NONE;
  const auto look = [&](std::uint32_t c, double speed) {
    const double time = distance_to(c, p) / speed;
    if (speed > 0 && time < soonest) soonest = time, found = c;
  };
  for (int i = 0; box && i < 3; ++i) {
    look(static_cast<std::uint32_t>(i), -v[i]);
    look(static_cast<std::uint32_t>(i) + 3, v[i]);
  }
  for (std::size_t l = 0; l < faces.size(); ++l) {
    const auto& n = faces[l];
    look(ALULA_FENCE_BOX_FACES + static_cast<std::uint32_t>(l), n[0] * v.x + n[1] * v.y + n[2] * v.z);
  }
  return found;
}

alula_racer_model to_onboard(const RacerModel& model) {
  alula_racer_model m = ALULA_RACER_MODEL_DEFAULTS;
  m.gravity = static_cast<float>(model.gravity);
  m.rate_gain = static_cast<float>(model.rate_gain);
  for (std::size_t i = 0; i < 3; ++i) m.thrust[i] = static_cast<float>(model.thrust[i]);
  for (int i = 0; i < 3; ++i) m.max_rate[i] = static_cast<float>(model.max_rate[i]);
  return m;
}

alula_racer_state to_onboard(const RacerState& x) {
  alula_racer_state s;
  for (int i = 0; i < 3; ++i) {
    s.position[i] = static_cast<float>(x.p[i]);
    s.velocity[i] = static_cast<float>(x.v[i]);
    s.rates[i] = static_cast<float>(x.omega[i]);
  }
  for (std::size_t i = 0; i < 4; ++i) s.attitude[i] = static_cast<float>(x.q[i]);
  return s;
}

alula_racer_command to_onboard(const RacerCommand& u) {
  return {static_cast<float>(u.throttle),
          {static_cast<float>(u.rates.x), static_cast<float>(u.rates.y), static_cast<float>(u.rates.z)}};
}

RacerCommand from_onboard(const alula_racer_command& u) { return {u.throttle, {u.rates[0], u.rates[1], u.rates[2]}}; }

std::string refusal(const alula_geofence_config& config) {
  alula_geofence_conditions found;
  char words[256];
  switch (alula_geofence_examine(&config, &found)) {
    case ALULA_READY:
      return {};
    case ALULA_NO_REST:
      if (found.rest_m_s < found.most_rest_m_s) {
        std::snprintf(words, sizeof words,
                      "the horizon of %g s ends before the backup controller has turned the vehicle upright; raise "
                      "steps, step_s or attitude_gain",
                      static_cast<double>(config.step_s) * config.steps);
        return words;
      }
      std::snprintf(
          words, sizeof words,
          "the horizon of %g s ends before the backup controller has stopped the vehicle: %.2g m/s are left, "
          "less than %.2g must be; raise steps or step_s, or change the gains of the backup controller",
          static_cast<double>(config.step_s) * config.steps, static_cast<double>(found.rest_m_s),
          static_cast<double>(found.most_rest_m_s));
      return words;
    case ALULA_TOO_LATE:
      std::snprintf(words, sizeof words,
                    "beta = %g takes over too late: at most %.3g with ticks of %g s, these speeds and this vehicle",
                    static_cast<double>(config.beta), static_cast<double>(found.most_beta),
                    static_cast<double>(config.tick_s));
      return words;
    default:
      return "the parameters of a geofence are out of range";
  }
}

Geofence::Geofence(const Fence& fence, const alula_geofence_config& config) : fence_(fence) {
  onboard_ = to_onboard(fence);
  if (fence.image) {
    if (fence.image->size() > UINT32_MAX ||
        alula_map_open(&map_, fence.image->data(), static_cast<std::uint32_t>(fence.image->size())) !=
            ALULA_MAP_READY) {
      throw std::invalid_argument("a fence's map is not an onboard map");
    }
    onboard_.keep_out = &map_;
  }
  if (alula_fence_check(&onboard_) != ALULA_READY) {
    throw std::invalid_argument("a fence needs a box, faces with unit normals or a map, within 10 km");
  }
  const alula_status status = alula_geofence_init(&filter_, &onboard_, &config);
  if (status == ALULA_READY) return;
  const std::string why = refusal(config);
  throw std::invalid_argument(why.empty() ? "the latency of a geofence is above 32 ticks" : why);
}

GeofenceReport Geofence::filter(const RacerState* navigation, const RacerCommand* pilot) {
  alula_racer_state state;
  alula_racer_command command;
  if (navigation != nullptr) state = to_onboard(*navigation);
  if (pilot != nullptr) command = to_onboard(*pilot);
  GeofenceReport report;
  report.status = alula_geofence_filter(&filter_, navigation != nullptr ? &state : nullptr,
                                        pilot != nullptr ? &command : nullptr, &report.detail);
  report.command = report.status == ALULA_GEOFENCE_PASSED ? *pilot : from_onboard(report.detail.command);
  return report;
}

alula_geofence_value Geofence::evaluate(const RacerState& x) const {
  alula_racer_state state = to_onboard(x);
  if (!alula_racer_state_is_valid(&state)) throw std::invalid_argument("not a state of a racer");
  alula_racer_normalise(&state);
  const alula_backup_hold hold = alula_geofence_hold(&filter_, &state);
  alula_geofence_value value;
  alula_geofence_evaluate(&filter_, &state, &hold, 0, &value);
  return value;
}

}  // namespace alula::flight
