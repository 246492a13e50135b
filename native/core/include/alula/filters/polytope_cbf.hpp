// Onboard polytope filter with its map, for host programs.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "alula/cover/onboard_image.hpp"
#include "alula/cover/tile_window.hpp"
#include "alula/filters/options.hpp"
#include "alula/filters/polytope_map.hpp"

namespace alula {

using Triple = std::array<double, 3>;

// In single precision, the radius rounded up.
alula_polytope_cbf_config to_onboard(const PolytopeCbfConfig& config);

struct FilterOutput {
  Triple u;  // equals the nominal input, bit by bit, when the status is OK
  alula_filter_status status;
  alula_polytope_result detail;
};

// Calls the onboard code with a map made from arrays, an image or tiles. Copies share the map: one copy per thread.
// Throws std::invalid_argument for parameters that the onboard code does not accept.
class PolytopeCbf {
 public:
  PolytopeCbf(std::shared_ptr<const PolytopeMap> map, const PolytopeCbfConfig& config);
  PolytopeCbf(std::shared_ptr<const OnboardImage> image, double extent_m, const PolytopeCbfConfig& config);
  // In the region of a resident tile commands are those of the whole image, bit by bit. Also throws when the tiles do
  // not reach far enough for that.
  PolytopeCbf(const TileWindow& window, double extent_m, const PolytopeCbfConfig& config);

  // With `more_m` the radius is larger by up to that, as far as there is room: where s - r is less, x may not come
  // nearer. `detail.margin_m` and `hard_margin_m` are for the radius itself. The next tile is that in the direction
  // of the nominal input; without a resident tile the input is refused.
  FilterOutput filter(const Triple& x, const Triple& u_nom, double more_m = 0);

  // Hard and smooth psi and the gradient of the smooth one; hard is -FLT_MAX where x is refused. In tiles psi is that
  // of the resident tile.
  alula_polytope_value evaluate(const Triple& x);

  const PolytopeCbfConfig& config() const { return config_; }
  const PolytopeMap* map() const { return map_.get(); }  // null if the filter uses an image
  const alula_polytope_work& work() const { return cbf_.work; }
  const std::optional<TileWindow>& window() const { return window_; }
  double reach_m() const { return static_cast<double>(alula_polytope_cbf_reach(&cbf_)); }
  void reset();  // before another flight: no tile is resident

 private:
  bool has_tile(const std::array<float, 3>& x, const std::array<float, 3>& u_nom);

  std::shared_ptr<const PolytopeMap> map_;
  std::shared_ptr<const OnboardImage> image_;
  PolytopeCbfConfig config_;
  std::optional<TileWindow> window_;
  const std::uint8_t* flown_ = nullptr;  // image of the resident tile that cbf_ reads
  alula_polytope_cbf cbf_;
};

}  // namespace alula
