/* A fence with or without a map, parameters, and ticks of the geofence with navigation and sticks of any kind. */
#include "fuzz.h"

static alula_geofence filter;

static alula_geofence_config take_config(bytes* in) {
  alula_geofence_config config = alula_geofence_defaults();
  config.steps = 2U * (1U + take(in, 1) % 50U);
  config.step_s = 3.0F / (float)config.steps;
  for (uint32_t changes = take(in, 1) % 4U; changes > 0U; --changes) {
    const uint32_t word = take(in, 1) % (sizeof config / 4U);
    const uint32_t kind = take(in, 1);
    const float value = take_float(in, 2.0F);
    float old;
    memcpy(&old, (uint8_t*)&config + 4U * word, 4);
    const float changed = kind % 2U ? value : old * (1.0F + 0.5F * value);
    memcpy((uint8_t*)&config + 4U * word, &changed, 4);
  }
  return config;
}

static alula_fence take_fence(bytes* in, const alula_map* map) {
  alula_fence fence = {.keep_out = map};
  fence.has_box = take(in, 1) % 8U != 0U;
  for (int i = 0; i < 3; ++i) {
    fence.lower[i] = -20.0F + take_float(in, 20.0F);
    fence.upper[i] = 20.0F + take_float(in, 20.0F);
  }
  fence.face_count = take(in, 1) % 4U;
  for (uint32_t l = 0; l < fence.face_count; ++l) {
    float* n = fence.face[l];
    take_floats(in, 1.0F, n, 3);
    const float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int i = 0; i < 3; ++i) n[i] /= length;
    n[3] = take_float(in, 30.0F);
  }
  return fence;
}

static void take_state(bytes* in, float half, alula_racer_state* x) {
  take_floats(in, half, x->position, 3);
  take_floats(in, 30.0F, x->velocity, 3);
  take_floats(in, 1.0F, x->attitude, 4);
  float square = 0.0F;
  for (int i = 0; i < 4; ++i) square += x->attitude[i] * x->attitude[i];
  if (take(in, 1) >= 8U && square > 0.0F)
    for (int i = 0; i < 4; ++i) x->attitude[i] /= sqrtf(square);
  take_floats(in, 12.0F, x->rates, 3);
}

static void tick(bytes* in, const alula_geofence_config* config, float half) {
  alula_racer_state x;
  alula_racer_command pilot;
  const uint32_t there = take(in, 1);
  take_state(in, half, &x);
  pilot.throttle = take_between(in, 0.0F, 1.0F);
  take_floats(in, 12.0F, pilot.rates, 3);
  alula_geofence_result r;
  const alula_geofence_status status =
      alula_geofence_filter(&filter, there % 8U == 1U ? NULL : &x, there / 8U % 8U == 1U ? NULL : &pilot, &r);
  CHECK(r.lambda >= 0.0F && r.lambda <= 1.0F);
  CHECK(r.command.throttle >= 0.0F && r.command.throttle <= 1.0F);
  for (int i = 0; i < 3; ++i) CHECK(fabsf(r.command.rates[i]) <= config->model.max_rate[i]);
  CHECK(isfinite(r.h_i) && !isnan(r.distance_m));
  if (status == ALULA_GEOFENCE_PASSED) CHECK(same_bits(&r.command, &pilot, sizeof pilot) && r.h_i > 0.0F);
  if (status == ALULA_GEOFENCE_BACKUP) CHECK(r.lambda == 0.0F);
  if (status == ALULA_GEOFENCE_REFUSED) CHECK(r.command.throttle == 0.0F && r.lambda == 0.0F);
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  bytes in = {data, size};
  uint32_t length;
  uint8_t* image = take_image(&in, &length);
  alula_map map;
  const int has_map = length > 0U && open_image(image, length, &map);
  const alula_fence fence = take_fence(&in, has_map ? &map : NULL);
  const alula_geofence_config config = take_config(&in);
  if (alula_geofence_init(&filter, &fence, &config) == ALULA_READY) {
    const float half = has_map && map.extent_m < 1000.0F ? map.extent_m + 2.0F : 25.0F;
    for (int k = 0; k < 5; ++k) tick(&in, &config, half);
    for (int k = 0; has_map && k < 2; ++k) { /* flash that fails */
      image[take(&in, 4) % length] = (uint8_t)take(&in, 1);
      tick(&in, &config, half);
    }
  }
  free(image);
  return 0;
}
