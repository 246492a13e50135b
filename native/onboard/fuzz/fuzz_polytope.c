/* An image, parameters, and ticks of polytope-cbf, each compared with a run that evaluates every plane. */
#include "fuzz.h"

static alula_polytope_cbf cbf, brute;

static void tick(const alula_polytope_cbf_config* config, const float x[3], const float u_nom[3]) {
  alula_polytope_result result, other;
  const alula_filter_status status = alula_polytope_cbf_filter(&cbf, x, u_nom, &result);
  CHECK(alula_polytope_cbf_filter(&brute, x, u_nom, &other) == status);
  CHECK(same_bits(&result, &other, sizeof result));
  CHECK(all_finite(result.u, 3) && result.fraction >= 0.0F && result.fraction <= 1.0F);
  const double square =
      (double)result.u[0] * result.u[0] + (double)result.u[1] * result.u[1] + (double)result.u[2] * result.u[2];
  CHECK(square <= 1.0001 * config->v_max * config->v_max);
  if (status == ALULA_FILTER_OK) CHECK(same_bits(result.u, u_nom, sizeof result.u));
  if (status == ALULA_FILTER_REFUSED) {
    CHECK(result.u[0] == 0.0F && result.u[1] == 0.0F && result.u[2] == 0.0F);
  } else {
    CHECK(all_finite(x, 3) && all_finite(u_nom, 3) && !isnan(result.margin_m) && !isnan(result.hard_margin_m));
  }
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  bytes in = {data, size};
  uint32_t length;
  uint8_t* image = take_image(&in, &length);
  alula_map map;
  if (open_image(image, length, &map)) {
    const float extent = take_between(&in, 0.0F, 2.0F * map.extent_m);
    alula_polytope_cbf_config config = {
        .radius_m = take_between(&in, 0.0F, 0.5F),
        .beta = take_between(&in, 0.1F, 20.0F),
        .kappa = take_between(&in, 1.0F, 1000.0F),
        .dt_s = take_between(&in, 0.001F, 0.1F),
        .v_max = take_between(&in, 0.1F, 5.0F),
        .smoothing = take(&in, 1) % 8U == 0U ? ALULA_SMOOTHING_PAPER : ALULA_SMOOTHING_SOUND};
    const alula_status made = alula_polytope_cbf_open(&cbf, &map, extent, &config);
    config.brute_force = 1;
    CHECK(alula_polytope_cbf_open(&brute, &map, extent, &config) == made);
    if (made == ALULA_READY) {
      CHECK(config.v_max > 0.0F && isfinite(config.v_max) && config.beta * config.dt_s <= 1.00001F);
      for (int k = 0; k < 12; ++k) {
        float x[3], u_nom[3];
        take_floats(&in, map.extent_m, x, 3);
        take_floats(&in, 2.0F * config.v_max, u_nom, 3);
        tick(&config, x, u_nom);
      }
      for (int k = 0; k < 4; ++k) { /* flash that fails */
        image[take(&in, 4) % length] = (uint8_t)take(&in, 1);
        float x[3], u_nom[3];
        alula_polytope_result result;
        take_floats(&in, map.extent_m, x, 3);
        take_floats(&in, config.v_max, u_nom, 3);
        (void)alula_polytope_cbf_filter(&cbf, x, u_nom, &result);
        CHECK(all_finite(result.u, 3));
      }
    }
  }
  free(image);
  return 0;
}
