#include "alula_avoidance.h"

#include "vector.h"

#define NEAREST 1.0e-3F /* [m] at smaller distances the direction is undefined */

/* True if all |x_i| are at most the limit; false for NaN. */
static int are_within(const float* x, uint32_t n, float limit) {
  for (uint32_t i = 0; i < n; ++i)
    if (!(absolute(x[i]) <= limit)) return 0;
  return 1;
}

/* x^T C x of a symmetric matrix given as its rows' entries xx, xy, xz, yy, yz, zz; at least 0. */
static float variance(const float c[6], const float x[3]) {
  const float s = c[0] * x[0] * x[0] + c[3] * x[1] * x[1] + c[5] * x[2] * x[2] +
                  2.0F * (c[1] * x[0] * x[1] + c[2] * x[0] * x[2] + c[4] * x[1] * x[2]);
  return s > 0.0F ? s : 0.0F;
}

alula_avoidance_config alula_avoidance_defaults(void) {
  const alula_avoidance_config config = ALULA_AVOIDANCE_DEFAULTS;
  return config;
}

alula_status alula_avoidance_init(alula_avoidance* avoidance, const alula_avoidance_config* config) {
  if (!avoidance || !config) return ALULA_BAD_POINTER;
  const alula_avoidance_config* c = config;
  const float not_negative[] = {c->radius_m,
                                c->latency_s,
                                c->l1,
                                c->l2,
                                c->settle_s,
                                c->envelope_start,
                                c->envelope_cap,
                                c->envelope_forget,
                                c->wasserstein,
                                c->obstacle_braking,
                                c->simple_quantile,
                                c->clearance_m,
                                c->hold_s,
                                c->kp,
                                c->kd,
                                c->reach_m,
                                c->longest_avoid_s,
                                c->improvement,
                                c->brake,
                                c->stopped_m_s,
                                c->wall_room_m};
  const float positive[] = {c->dt_s, c->a_max, c->range_m, c->h_max_s, c->tail, c->stop_s};
  for (uint32_t i = 0; i < sizeof not_negative / sizeof *not_negative; ++i)
    if (!(not_negative[i] >= 0.0F && not_negative[i] < 1.0e6F)) return ALULA_BAD_PARAMETER;
  for (uint32_t i = 0; i < sizeof positive / sizeof *positive; ++i)
    if (!(positive[i] >= 1.0e-6F && positive[i] < 1.0e6F)) return ALULA_BAD_PARAMETER;
  if (c->tail > 1.0F || c->improvement > 1.0F || c->envelope_cap < c->envelope_start) return ALULA_BAD_PARAMETER;
  avoidance->config = *config;
  alula_early_warning_tails(c->tail, &avoidance->tail_of_normal, &avoidance->tail_of_square);
  alula_avoidance_reset(avoidance);
  return ALULA_READY;
}

void alula_avoidance_reset(alula_avoidance* avoidance) {
  avoidance->mode = ALULA_NOMINAL;
  avoidance->ticks_in_mode = 0U;
  avoidance->envelope_count = 0U;
  avoidance->count = 0U;
  avoidance->has_bypass = 0U;
  avoidance->threat = ALULA_NO_OBSTACLE;
  for (int k = 0; k < 3; ++k) avoidance->bypass[k] = avoidance->direction[k] = avoidance->command[k] = 0.0F;
}

static int is_usable(const alula_vehicle_state* vehicle, const alula_track* track, uint32_t count,
                     const alula_wall* wall, uint32_t wall_count, const float nominal[3]) {
  const float far = ALULA_LARGEST, wide = ALULA_LARGEST * ALULA_LARGEST;
  if (count > ALULA_OBSTACLES || wall_count > ALULA_WALLS) return 0;
  if (!are_within(vehicle->position, 3U, far) || !are_within(vehicle->velocity, 3U, far)) return 0;
  if (!are_within(vehicle->covariance, 6U, wide) || !are_within(nominal, 3U, far)) return 0;
  if (vehicle->covariance[0] < 0.0F || vehicle->covariance[3] < 0.0F || vehicle->covariance[5] < 0.0F) return 0;
  for (uint32_t i = 0; i < count; ++i) {
    const alula_track* t = track + i;
    if (!are_within(t->position, 3U, far) || !are_within(t->velocity, 3U, far)) return 0;
    if (!are_within(t->covariance, 21U, wide) || !are_within(t->acceleration, 3U, far)) return 0;
    if (!(t->radius_m >= 0.0F && t->radius_m <= far)) return 0;
    for (uint32_t j = 0, at = 0; j < 6U; at += ++j + 1U)
      if (t->covariance[at] < 0.0F) return 0;
    for (uint32_t j = 0; j < i; ++j)
      if (track[j].id == t->id) return 0;
  }
  for (uint32_t i = 0; i < wall_count; ++i) {
    const float square = dot(wall[i].normal, wall[i].normal);
    if (!(absolute(square - 1.0F) < 1.0e-3F) || !are_within(&wall[i].distance_m, 1U, far)) return 0;
  }
  return 1;
}

static void meet(alula_avoidance* avoidance, const alula_vehicle_state* vehicle, const alula_track* track,
                 uint32_t count) {
  avoidance->count = count;
  for (uint32_t i = 0; i < count; ++i) {
    alula_encounter* m = avoidance->encounter + i;
    float p[3], v[3];
    for (int k = 0; k < 3; ++k) {
      p[k] = track[i].position[k] - vehicle->position[k];
      v[k] = track[i].velocity[k] - vehicle->velocity[k];
    }
    m->distance_m = norm(p);
    const float length = m->distance_m > NEAREST ? m->distance_m : NEAREST;
    for (int k = 0; k < 3; ++k) m->los[k] = p[k] / length;
    if (!(m->distance_m > NEAREST)) m->los[0] = 1.0F, m->los[1] = m->los[2] = 0.0F;
    const float towards = -dot(m->los, v);
    m->closing_m_s = towards > 0.0F ? towards : 0.0F;
    m->radius_m = avoidance->config.radius_m + track[i].radius_m;
    m->envelope = alula_find_envelope(avoidance, track[i].id)->bound;
    const float* c = track[i].covariance;
    const float cp[6] = {c[0], c[1], c[3], c[2], c[4], c[5]}, cv[6] = {c[9], c[13], c[18], c[14], c[19], c[20]};
    m->sigma2_p = variance(cp, m->los) + variance(vehicle->covariance, m->los);
    m->sigma2_v = variance(cv, m->los);
    m->active = m->distance_m < avoidance->config.range_m && m->closing_m_s > 0.0F ? 1U : 0U;
    m->has_row = m->active;
  }
}

/* The estimate of the differentiator, shortened to the bound, minus the vehicle's own acceleration. */
static void relative_acceleration(const alula_avoidance* avoidance, const alula_envelope* e, float a[3]) {
  const float size = norm(e->z1);
  float scale = size > e->bound ? e->bound / size : 1.0F;
  if ((float)e->age * avoidance->config.dt_s < avoidance->config.settle_s) scale = 0.0F;
  for (int k = 0; k < 3; ++k) a[k] = scale * e->z1[k] - avoidance->command[k];
}

/* |P + V t| - q sigma <= R at one time: the chance constraint without the tail. */
static float simple_warning(const alula_avoidance_config* c, const alula_vehicle_state* vehicle,
                            const alula_track* track, const alula_encounter* m) {
  float at[3];
  for (int k = 0; k < 3; ++k) {
    at[k] = track->position[k] - vehicle->position[k] + (track->velocity[k] - vehicle->velocity[k]) * c->h_max_s;
  }
  const float sigma = __builtin_sqrtf(m->sigma2_p + c->h_max_s * c->h_max_s * m->sigma2_v);
  return m->radius_m + c->simple_quantile * sigma - norm(at);
}

static void warn(alula_avoidance* avoidance, const alula_vehicle_state* vehicle, const alula_track* track,
                 alula_guidance* guidance) {
  float urgency = 0.0F;
  guidance->risk_m = -FLT_MAX;
  guidance->urgent = ALULA_NO_OBSTACLE;
  for (uint32_t i = 0; i < avoidance->count; ++i) {
    const alula_encounter* m = avoidance->encounter + i;
    if (!(m->distance_m < avoidance->config.range_m)) continue;
    float a[3], risk;
    if (avoidance->config.distributional) {
      relative_acceleration(avoidance, alula_find_envelope(avoidance, track[i].id), a);
      risk = alula_early_warning(avoidance, vehicle, track + i, a);
    } else {
      risk = simple_warning(&avoidance->config, vehicle, track + i, m);
    }
    if (!(risk <= guidance->risk_m)) guidance->risk_m = risk;
    const float now = m->closing_m_s / (m->distance_m > NEAREST ? m->distance_m : NEAREST);
    if (now > urgency) urgency = now, guidance->urgent = i;
  }
  guidance->warned = !(guidance->risk_m < 0.0F);
}

static void enter(alula_avoidance* avoidance, alula_avoidance_mode mode) {
  avoidance->mode = mode;
  avoidance->ticks_in_mode = 0U;
}

static int recedes(const alula_avoidance* avoidance, const alula_track* track) {
  for (uint32_t i = 0; i < avoidance->count; ++i)
    if (track[i].id == avoidance->threat) return !(avoidance->encounter[i].closing_m_s > 0.0F);
  return 1;
}

/* Changes the mode when the current part of a manoeuvre ends. */
static void leave(alula_avoidance* avoidance, const alula_vehicle_state* vehicle, const alula_track* track) {
  const alula_avoidance_config* c = &avoidance->config;
  const float time = (float)avoidance->ticks_in_mode * c->dt_s;
  if (avoidance->mode == ALULA_AVOID) {
    float left[3];
    for (int k = 0; k < 3; ++k) left[k] = avoidance->bypass[k] - vehicle->position[k];
    const int done = norm(left) < c->reach_m || recedes(avoidance, track);
    if ((done && time >= c->hold_s) || time >= c->longest_avoid_s) enter(avoidance, ALULA_HOVER);
  } else if (avoidance->mode == ALULA_HOVER) {
    if (norm(vehicle->velocity) < c->stopped_m_s || time >= c->stop_s) enter(avoidance, ALULA_NOMINAL);
  }
}

static void command_before(const alula_avoidance* avoidance, const alula_vehicle_state* vehicle,
                           const float nominal[3], float desired[3]) {
  const alula_avoidance_config* c = &avoidance->config;
  for (int k = 0; k < 3; ++k) {
    const float v = vehicle->velocity[k];
    desired[k] = nominal[k];
    if (avoidance->mode == ALULA_AVOID) {
      desired[k] = clipped(c->kp * (avoidance->bypass[k] - vehicle->position[k]) - c->kd * v, c->a_max);
    } else if (avoidance->mode == ALULA_HOVER) {
      desired[k] = clipped(-c->brake * (2.0F / c->stop_s) * v, c->a_max);
    }
  }
}

alula_status alula_avoidance_step(alula_avoidance* avoidance, const alula_vehicle_state* vehicle,
                                  const alula_track* track, uint32_t count, const alula_wall* wall,
                                  uint32_t wall_count, const float nominal[3], alula_guidance* guidance) {
  if (!avoidance || !vehicle || !nominal || !guidance || (count > 0U && !track) || (wall_count > 0U && !wall))
    return ALULA_BAD_POINTER;
  if (!is_usable(vehicle, track, count, wall, wall_count, nominal)) return ALULA_BAD_INPUT;
  alula_update_envelopes(avoidance, track, count);
  meet(avoidance, vehicle, track, count);
  warn(avoidance, vehicle, track, guidance);
  leave(avoidance, vehicle, track);
  const int has_threat = guidance->urgent != ALULA_NO_OBSTACLE;
  if (guidance->warned && has_threat && avoidance->mode != ALULA_AVOID) {
    enter(avoidance, ALULA_AVOID);
    avoidance->has_bypass = 0U;
    avoidance->threat = track[guidance->urgent].id;
  }
  if (avoidance->mode == ALULA_AVOID && has_threat)
    alula_choose_bypass(avoidance, vehicle, track, wall, wall_count, guidance->urgent);
  command_before(avoidance, vehicle, nominal, guidance->desired);
  ++avoidance->ticks_in_mode;
  guidance->mode = avoidance->mode;
  return ALULA_READY;
}

void alula_avoidance_flown(alula_avoidance* avoidance, const float command[3]) {
  for (int k = 0; k < 3; ++k) avoidance->command[k] = command[k];
}
