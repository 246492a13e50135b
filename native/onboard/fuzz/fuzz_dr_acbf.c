/* Parameters, and ticks of dr-acbf with tracks and walls of any kind. */
#include "fuzz.h"

#define TRACKS 6U
#define FENCES 3U

static alula_dr_acbf filter;

/* The defaults, with a few numbers replaced. */
static alula_dr_acbf_config take_config(bytes* in) {
  alula_dr_acbf_config config = alula_dr_acbf_defaults();
  for (uint32_t changes = take(in, 1) % 4U; changes > 0U; --changes) {
    const uint32_t word = take(in, 1) % (sizeof config / 4U);
    const uint32_t kind = take(in, 1);
    float value = take_float(in, 10.0F);
    uint32_t whole = take(in, 1) % 20U;
    memcpy((uint8_t*)&config + 4U * word, kind % 2U ? (void*)&whole : (void*)&value, 4);
  }
  config.solver = config.solver == ALULA_SOLVER_GAUSS_SOUTHWELL; /* an enum must hold one of its values */
  return config;
}

static void take_wall(bytes* in, alula_wall* wall) {
  take_floats(in, 1.0F, wall->normal, 3);
  const float length = sqrtf(wall->normal[0] * wall->normal[0] + wall->normal[1] * wall->normal[1] +
                             wall->normal[2] * wall->normal[2]);
  if (length > 0.0F && take(in, 1) >= 8U)
    for (int i = 0; i < 3; ++i) wall->normal[i] /= length;
  wall->distance_m = take_float(in, 10.0F);
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  bytes in = {data, size};
  const alula_dr_acbf_config config = take_config(&in);
  if (alula_dr_acbf_init(&filter, &config) != ALULA_READY) return 0;
  const float limit = config.avoidance.a_max;
  CHECK(limit > 0.0F && isfinite(limit));
  for (int k = 0; k < 6; ++k) {
    alula_vehicle_state vehicle = {.covariance = {0.01F, 0.0F, 0.0F, 0.01F, 0.0F, 0.01F}};
    alula_track track[TRACKS];
    alula_wall wall[FENCES];
    float nominal[3];
    take_floats(&in, 10.0F, vehicle.position, 3);
    take_floats(&in, 5.0F, vehicle.velocity, 3);
    take_floats(&in, 5.0F, nominal, 3);
    const uint32_t count = take(&in, 1) % (TRACKS + 1U), walls = take(&in, 1) % (FENCES + 1U);
    for (uint32_t i = 0; i < count; ++i) take_track(&in, i, track + i);
    for (uint32_t i = 0; i < walls; ++i) take_wall(&in, wall + i);
    alula_dr_acbf_result result;
    const alula_filter_status status =
        alula_dr_acbf_filter(&filter, &vehicle, track, count, wall, walls, nominal, &result);
    if (status == ALULA_FILTER_REFUSED) {
      CHECK(result.a[0] == 0.0F && result.a[1] == 0.0F && result.a[2] == 0.0F);
      continue;
    }
    CHECK(all_finite(nominal, 3) && all_finite(vehicle.position, 3) && all_finite(vehicle.velocity, 3));
    for (int i = 0; i < 3; ++i) CHECK(fabsf(result.a[i]) <= limit); /* not for NaN */
    if (status == ALULA_FILTER_OK) CHECK(same_bits(result.a, nominal, sizeof result.a));
    CHECK(!isnan(result.violation) && isfinite(result.horizon_s));
    if (take(&in, 1) < 32U) {
      float flown[3];
      take_floats(&in, 5.0F, flown, 3);
      alula_dr_acbf_flown(&filter, flown);
    }
  }
  return 0;
}
