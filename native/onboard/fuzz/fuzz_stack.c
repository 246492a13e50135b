/* An image, parameters, and ticks of the stack in a fence with tracks of any kind; after a tick with positive margins
 * a vehicle keeps them, whatever flies around. */
#include "fuzz.h"

#define TRACKS 3U

static alula_stack stack, copy;

/* The margin of the state that follows when u is flown for dt. */
static float margin_after(const alula_stack_config* config, const alula_stack_input* in, const float u[3]) {
  const double dt = config->polytope_cbf.dt_s, lag = config->lag_s, share = exp(-dt / lag);
  alula_stack_input next = *in;
  for (int i = 0; i < 3; ++i) {
    const double off = (double)in->velocity[i] - u[i];
    next.position[i] = (float)(in->position[i] + u[i] * dt + lag * (1.0 - share) * off);
    next.velocity[i] = (float)(u[i] + share * off);
    next.nominal[i] = 0.0F;
  }
  next.track_count = 0U;
  alula_stack_result result;
  copy = stack;
  return alula_stack_filter(&copy, &next, &result) == ALULA_FILTER_REFUSED ? 0.0F : result.chord.margin_m;
}

static void tick(const alula_map* map, const alula_stack_config* config, bytes* in) {
  const float v_max = config->polytope_cbf.v_max;
  alula_stack_input input = {.covariance = {0.01F, 0.0F, 0.0F, 0.01F, 0.0F, 0.01F}};
  alula_track track[TRACKS];
  alula_stack_result result, again;
  take_floats(in, map->extent_m, input.position, 3);
  take_floats(in, 2.0F * v_max, input.velocity, 3);
  take_floats(in, 2.0F * v_max, input.nominal, 3);
  input.is_taking_off = take(in, 1) % 4U == 0U;
  input.track = track;
  input.track_count = take(in, 1) % (TRACKS + 1U);
  for (uint32_t i = 0; i < input.track_count; ++i) take_track(in, i, track + i);
  copy = stack;
  const alula_filter_status status = alula_stack_filter(&stack, &input, &result);
  CHECK(status == result.status && alula_stack_filter(&copy, &input, &again) == status);
  CHECK(same_bits(result.velocity, again.velocity, sizeof result.velocity));
  double square = 0.0;
  for (int i = 0; i < 3; ++i) square += (double)result.velocity[i] * result.velocity[i];
  CHECK(square <= 1.0003 * v_max * v_max); /* not for NaN */
  if (status == ALULA_FILTER_OK) CHECK(same_bits(result.velocity, input.nominal, sizeof result.velocity));
  CHECK(stack.chord.count <= ALULA_CHORD_ROWS && stack.chord.soft <= stack.chord.count);
  if (status == ALULA_FILTER_REFUSED) return;
  CHECK(all_finite(input.position, 3) && all_finite(input.velocity, 3) && all_finite(input.nominal, 3));
  CHECK(!isnan(result.chord.margin_m) && !isnan(result.violation_m_s));
  CHECK(result.obstacle_rows <= input.track_count);
  if (stack.chord.soft > 0U || !(result.chord.margin_m >= 0.0F)) return;
  const float rounding = 1.0e-5F * (1.0F + map->extent_m); /* of the state that follows, not of the filter */
  CHECK(margin_after(config, &input, result.velocity) >= -rounding - 4.0F * stack.chord.hulls.map.slack_m);
}

static void take_fence(bytes* in, float extent, alula_fence* fence) {
  const alula_fence NONE = {.has_box = 0};
  *fence = NONE;
  fence->has_box = take(in, 1) % 2U == 0U;
  for (int i = 0; i < 3; ++i) {
    fence->lower[i] = -take_between(in, 0.0F, extent);
    fence->upper[i] = take_between(in, 0.0F, extent);
  }
  fence->face_count = take(in, 1) % 3U;
  for (uint32_t l = 0; l < fence->face_count; ++l) {
    take_floats(in, 1.0F, fence->face[l], 3);
    const float* n = fence->face[l];
    const float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int i = 0; i < 3 && length > 0.0F; ++i) fence->face[l][i] /= length;
    fence->face[l][3] = take_float(in, extent);
  }
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  bytes in = {data, size};
  uint32_t length;
  uint8_t* image = take_image(&in, &length);
  alula_map map;
  if (open_image(image, length, &map)) {
    alula_stack_config config = alula_stack_defaults();
    config.polytope_cbf.radius_m = take_between(&in, 0.0F, 0.5F);
    config.polytope_cbf.beta = take_between(&in, 0.1F, 20.0F);
    config.polytope_cbf.v_max = take_between(&in, 0.1F, 3.0F);
    config.polytope_cbf.dt_s = config.dr_acbf.avoidance.dt_s = take_between(&in, 0.001F, 0.1F);
    config.extent_m = take_between(&in, 0.0F, 2.0F * map.extent_m);
    config.lag_s = take_between(&in, 0.0F, 1.0F);
    config.dr_acbf.avoidance.a_max = take_between(&in, 3.0F, 100.0F);
    alula_fence fence;
    take_fence(&in, map.extent_m, &fence);
    const int has_fence = take(&in, 1) % 4U != 0U;
    if (alula_stack_init(&stack, &map, has_fence ? &fence : 0, &config) == ALULA_READY) {
      CHECK(config.lag_s > 0.0F && isfinite(config.lag_s));
      for (int k = 0; k < 8; ++k) tick(&map, &config, &in);
      for (int k = 0; k < 3; ++k) { /* flash that fails */
        image[take(&in, 4) % length] = (uint8_t)take(&in, 1);
        alula_stack_input input = {.track_count = 0U};
        alula_stack_result result;
        take_floats(&in, map.extent_m, input.position, 3);
        take_floats(&in, config.polytope_cbf.v_max, input.velocity, 3);
        (void)!alula_stack_filter(&stack, &input, &result);
        CHECK(all_finite(result.velocity, 3));
      }
    }
  }
  free(image);
  return 0;
}
