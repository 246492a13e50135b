/* An image, parameters, and ticks of the chord filter; after a tick with positive margins a vehicle keeps them. */
#include "fuzz.h"

static alula_chord chord;

/* The margin of the state that follows when u is flown for dt; the same state, asked twice, gives the same. */
static float margin_after(const alula_polytope_cbf_config* config, float lag, const float x[3], const float v[3],
                          const float u[3]) {
  const double share = lag > 0.0F ? exp(-(double)config->dt_s / lag) : 0.0;
  float next_x[3], next_v[3];
  for (int i = 0; i < 3; ++i) {
    next_x[i] = (float)(x[i] + u[i] * (double)config->dt_s + lag * (1.0 - share) * ((double)v[i] - u[i]));
    next_v[i] = (float)(u[i] + share * ((double)v[i] - u[i]));
  }
  const float none[3] = {0.0F, 0.0F, 0.0F};
  alula_polytope_result result, again;
  const alula_filter_status status = alula_chord_filter(&chord, next_x, next_v, none, 0, &result);
  CHECK(alula_chord_filter(&chord, next_x, next_v, none, 0, &again) == status);
  CHECK(same_bits(&result, &again, sizeof result));
  return status == ALULA_FILTER_REFUSED ? 0.0F : result.margin_m;
}

static void tick(const alula_map* map, const alula_polytope_cbf_config* config, float lag, bytes* in) {
  float x[3], v[3], u_nom[3];
  alula_polytope_result result;
  take_floats(in, map->extent_m, x, 3);
  take_floats(in, 2.0F * config->v_max, v, 3);
  take_floats(in, 2.0F * config->v_max, u_nom, 3);
  const alula_filter_status status = alula_chord_filter(&chord, x, v, u_nom, take(in, 1) % 4U == 0U, &result);
  CHECK(all_finite(result.u, 3) && result.fraction >= 0.0F && result.fraction <= 1.0F);
  double square = 0.0;
  for (int i = 0; i < 3; ++i) square += (double)result.u[i] * result.u[i];
  CHECK(square <= 1.0003 * config->v_max * config->v_max);
  if (status == ALULA_FILTER_OK) CHECK(same_bits(result.u, u_nom, sizeof result.u));
  if (status == ALULA_FILTER_REFUSED) {
    CHECK(square == 0.0);
    return;
  }
  CHECK(all_finite(x, 3) && all_finite(v, 3) && all_finite(u_nom, 3));
  CHECK(!isnan(result.margin_m) && !isnan(result.hard_margin_m) && chord.count <= ALULA_CHORD_ROWS);
  if (status == ALULA_FILTER_RECOVERING || !(result.margin_m >= 0.0F)) return;
  const float rounding = 1.0e-5F * (1.0F + map->extent_m); /* of the state that follows, not of the filter */
  CHECK(margin_after(config, lag, x, v, result.u) >= -rounding - 4.0F * chord.hulls.map.slack_m);
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  bytes in = {data, size};
  uint32_t length;
  uint8_t* image = take_image(&in, &length);
  alula_map map;
  if (open_image(image, length, &map)) {
    const alula_polytope_cbf_config config = {.radius_m = take_between(&in, 0.0F, 0.5F),
                                              .beta = take_between(&in, 0.1F, 20.0F),
                                              .kappa = 100.0F,
                                              .dt_s = take_between(&in, 0.001F, 0.1F),
                                              .v_max = take_between(&in, 0.1F, 5.0F),
                                              .smoothing = ALULA_SMOOTHING_SOUND};
    const float extent = take_between(&in, 0.0F, 2.0F * map.extent_m), lag = take_between(&in, 0.0F, 1.0F);
    if (alula_chord_open(&chord, &map, extent, &config, lag) == ALULA_READY) {
      CHECK(config.v_max > 0.0F && isfinite(config.v_max) && lag >= 0.0F && config.beta * config.dt_s <= 1.00001F);
      for (int k = 0; k < 12; ++k) tick(&map, &config, lag, &in);
      for (int k = 0; k < 4; ++k) { /* flash that fails */
        image[take(&in, 4) % length] = (uint8_t)take(&in, 1);
        float x[3], v[3], u_nom[3];
        alula_polytope_result result;
        take_floats(&in, map.extent_m, x, 3);
        take_floats(&in, config.v_max, v, 3);
        take_floats(&in, config.v_max, u_nom, 3);
        (void)alula_chord_filter(&chord, x, v, u_nom, 0, &result);
        CHECK(all_finite(result.u, 3));
      }
    }
  }
  free(image);
  return 0;
}
