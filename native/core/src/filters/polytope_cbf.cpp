#include "alula/filters/polytope_cbf.hpp"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <iomanip>
#include <sstream>
#include <stdexcept>
#include <string>

namespace alula {

namespace {

constexpr float kRadiusRounding = 1e-6F;  // of a radius that leaves exactly the room there is

std::array<float, 3> to_float(const Triple& v) {
  return {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
}

std::string words_of(double metres) {
  std::ostringstream text;
  text << std::setprecision(4) << metres;
  return text.str();
}

void require_ready(alula_status status) {
  switch (status) {
    case ALULA_READY:
      return;
    case ALULA_BAD_PARAMETER:
      throw std::invalid_argument(
          "filter parameters must satisfy 0 <= radius <= extent, 0 < beta <= 1 / dt, 0 < kappa <= 1e5, "
          "0 < v_max <= 1e6 and v_max dt <= extent");
    default:
      throw std::invalid_argument("the map is not valid");
  }
}

}  // namespace

alula_polytope_cbf_config to_onboard(const PolytopeCbfConfig& config) {
  return {.radius_m = round_up(config.radius_m),
          .beta = static_cast<float>(config.beta),
          .kappa = static_cast<float>(config.kappa),
          .dt_s = static_cast<float>(config.dt_s),
          .v_max = static_cast<float>(config.v_max),
          .smoothing = config.smoothing,
          .brute_force = config.brute_force};
}

PolytopeCbf::PolytopeCbf(std::shared_ptr<const PolytopeMap> map, const PolytopeCbfConfig& config)
    : map_(std::move(map)), config_(config) {
  const alula_polytope_map view = map_->view();
  const alula_polytope_cbf_config rounded = to_onboard(config);
  require_ready(alula_polytope_cbf_init(&cbf_, &view, &rounded));
}

PolytopeCbf::PolytopeCbf(std::shared_ptr<const OnboardImage> image, double extent_m, const PolytopeCbfConfig& config)
    : image_(std::move(image)), config_(config) {
  const alula_polytope_cbf_config rounded = to_onboard(config);
  require_ready(alula_polytope_cbf_open(&cbf_, &image_->map(), round_up(extent_m), &rounded));
}

PolytopeCbf::PolytopeCbf(const TileWindow& window, double extent_m, const PolytopeCbfConfig& config)
    : config_(config), window_(window) {
  const Bytes& any = window.set().image(0);
  alula_map first;
  const alula_map_status status = alula_map_open(&first, any.data(), static_cast<std::uint32_t>(any.size()));
  if (status != ALULA_MAP_READY) throw std::invalid_argument(status_text(status));
  const alula_polytope_cbf_config rounded = to_onboard(config);
  require_ready(alula_polytope_cbf_open(&cbf_, &first, round_up(extent_m), &rounded));
  const double needed = reach_m(), reach = static_cast<double>(window.tiles().reach_m);
  if (needed > reach)
    throw std::invalid_argument("the tiles reach " + words_of(reach) + " m, and with these parameters hulls up to " +
                                words_of(needed) + " m away count; export with a larger --reach, or fly slower");
  reset();
}

void PolytopeCbf::reset() {
  if (window_) window_->reset();
  flown_ = nullptr;
}

// Makes the filter read the tile for x; false if none is resident.
bool PolytopeCbf::has_tile(const std::array<float, 3>& x, const std::array<float, 3>& u_nom) {
  if (!window_) return true;
  std::array<float, 3> towards = x;
  const float speed = std::hypot(u_nom[0], u_nom[1]);
  for (std::size_t k = 0; k < 2 && speed > 0; ++k) towards[k] += window_->tiles().edge_m * (u_nom[k] / speed);
  const alula_map* map = window_->at(x, towards);
  if (map == nullptr) return false;
  if (map->data != flown_) require_ready(alula_polytope_cbf_move(&cbf_, map));
  flown_ = map->data;
  return true;
}

FilterOutput PolytopeCbf::filter(const Triple& x, const Triple& u_nom, double more_m) {
  FilterOutput output;
  const auto position = to_float(x), nominal = to_float(u_nom);
  if (!has_tile(position, nominal)) {
    output.u = {};
    output.status = ALULA_FILTER_REFUSED;
    output.detail = {{0, 0, 0}, -FLT_MAX, -FLT_MAX, 0, ALULA_NO_HULL};
    return output;
  }
  const float radius = cbf_.config.radius_m;
  const auto with_radius = [&](float grown) {
    cbf_.config.radius_m = grown;
    output.status = alula_polytope_cbf_filter(&cbf_, position.data(), nominal.data(), &output.detail);
    cbf_.config.radius_m = radius;
    output.detail.margin_m += grown - radius, output.detail.hard_margin_m += grown - radius;
  };
  const float most = std::min(radius + static_cast<float>(more_m), cbf_.map.extent_m);
  with_radius(most > radius ? most : radius);
  const float room = output.detail.margin_m;
  if (most > radius && room < most - radius)
    with_radius(radius + std::max(0.0F, room - kRadiusRounding * (radius + room)));
  const float* u = output.detail.u;
  output.u = output.status == ALULA_FILTER_OK ? u_nom : Triple{u[0], u[1], u[2]};
  return output;
}

alula_polytope_value PolytopeCbf::evaluate(const Triple& x) {
  alula_polytope_value value;
  const auto position = to_float(x);
  value.nearest = ALULA_NO_HULL;
  if (!has_tile(position, {}) || alula_polytope_cbf_evaluate(&cbf_, position.data(), &value) != ALULA_READY)
    value.hard = value.smooth = -FLT_MAX;
  return value;
}

}  // namespace alula
