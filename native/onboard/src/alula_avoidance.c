#include "alula_avoidance.h"

#define NEAREST 1.0e-3F /* m: nearer than this there is no direction */
#define CANDIDATES 12U
#define SHORTEST_S 0.05F /* of the time to the closest approach, */
#define LONGEST_S 3.0F   /* and the longest that is looked at */
#define LOOKS 24U        /* at the distance in between, and then thirds of it */
#define THIRDS 12U

static float dot(const float a[3], const float b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static float norm(const float a[3]) { return __builtin_sqrtf(dot(a, a)); }
static float clipped(float x, float limit) { return x > limit ? limit : (x < -limit ? -limit : x); }
static float absolute(float x) { return x < 0.0F ? -x : x; }

/* False for NaN too. */
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
  const alula_avoidance_config config = {.dt_s = 0.01F,
                                         .radius_m = 0.15F,
                                         .a_max = 6.0F,
                                         .range_m = 40.0F,
                                         .latency_s = 0.02F,
                                         .h_max_s = 0.4F,
                                         .l1 = 3.0F,
                                         .l2 = 3.0F,
                                         .settle_s = 0.3F,
                                         .envelope_start = 1.0F,
                                         .envelope_cap = 4.0F,
                                         .envelope_forget = 0.5F,
                                         .distributional = 1,
                                         .tail = 0.05F,
                                         .wasserstein = 0.05F,
                                         .obstacle_braking = 6.0F,
                                         .simple_quantile = 1.645F,
                                         .clearance_m = 1.0F,
                                         .hold_s = 0.2F,
                                         .kp = 60.0F,
                                         .kd = 14.0F,
                                         .reach_m = 0.15F,
                                         .longest_avoid_s = 1.2F,
                                         .improvement = 0.2F,
                                         .accelerated = 0,
                                         .stop_s = 0.5F,
                                         .brake = 1.0F,
                                         .stopped_m_s = 0.3F,
                                         .wall_room_m = 0.1F};
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
  alula_early_warning_samples(avoidance->sample);
  avoidance->worst_sample = 0.0F;
  for (uint32_t n = 0; n < ALULA_SAMPLES / 2U; ++n) {
    float square = 0.0F;
    for (int j = 0; j < 6; ++j) square += avoidance->sample[n][j] * avoidance->sample[n][j];
    const float length = __builtin_sqrtf(square);
    if (length > avoidance->worst_sample) avoidance->worst_sample = length;
  }
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
  }
}

/* The estimate of the differentiator, in its direction but not longer than the bound, less the vehicle's own. */
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

static float offset_at(const float p[3], const float v[3], const float a[3], float t, float at[3]) {
  for (int k = 0; k < 3; ++k) at[k] = p[k] + (v[k] + 0.5F * a[k] * t) * t;
  return dot(at, at);
}

/* When |p + v t + a t^2 / 2| is least, SHORTEST_S to LONGEST_S from now: of evenly spaced times the best, then by
 * thirds between its neighbours, where the distance has one minimum but for accelerations that turn an obstacle
 * round within a step. */
static float closest_time(const float p[3], const float v[3], const float a[3]) {
  const float step = (LONGEST_S - SHORTEST_S) / (float)(LOOKS - 1U);
  float at[3], least = FLT_MAX, from = SHORTEST_S;
  for (uint32_t i = 0; i < LOOKS; ++i) {
    const float t = SHORTEST_S + step * (float)i, square = offset_at(p, v, a, t, at);
    if (square < least) least = square, from = t;
  }
  float to = from + step;
  from -= step;
  for (uint32_t i = 0; i < THIRDS; ++i) {
    const float third = (to - from) / 3.0F;
    if (offset_at(p, v, a, from + third, at) < offset_at(p, v, a, to - third, at)) {
      to -= third;
    } else {
      from += third;
    }
  }
  const float t = 0.5F * (from + to);
  return t < SHORTEST_S ? SHORTEST_S : (t > LONGEST_S ? LONGEST_S : t);
}

/* Where each active obstacle comes closest to a vehicle that hovers here, as it is to do at the bypass point: what
 * is left to shift then is what is left of the way, however fast the vehicle is on it. */
static void predict_misses(alula_avoidance* avoidance, const alula_vehicle_state* vehicle, const alula_track* track) {
  for (uint32_t i = 0; i < avoidance->count; ++i) {
    alula_encounter* m = avoidance->encounter + i;
    if (!m->active) continue;
    float p[3], v[3], a[3] = {0.0F, 0.0F, 0.0F};
    for (int k = 0; k < 3; ++k) {
      p[k] = track[i].position[k] - vehicle->position[k];
      v[k] = track[i].velocity[k];
    }
    if (avoidance->config.accelerated) {
      const float size = norm(track[i].acceleration), most = avoidance->config.envelope_cap;
      const float scale = size > most ? most / size : 1.0F;
      for (int k = 0; k < 3; ++k) a[k] = scale * track[i].acceleration[k];
      m->miss_s = closest_time(p, v, a);
    } else {
      const float square = dot(v, v), t = square > 0.0F ? -dot(p, v) / square : LONGEST_S;
      m->miss_s = t < SHORTEST_S ? SHORTEST_S : (t > LONGEST_S ? LONGEST_S : t);
    }
    (void)offset_at(p, v, a, m->miss_s, m->miss);
  }
}

/* How far along c the closest approach to an obstacle has to move to keep `clearance`, and the acceleration that
 * this takes. */
static float needed_shift(const alula_avoidance_config* config, const alula_encounter* m, const float c[3],
                          float* acceleration) {
  const float clearance = m->radius_m + config->clearance_m, *miss = m->miss;
  const float inside = clearance * clearance - dot(miss, miss);
  *acceleration = 0.0F;
  if (!(inside > 0.0F)) return 0.0F;
  const float along = dot(c, miss);
  const float shift = along + __builtin_sqrtf(along * along + inside);
  const float time = m->miss_s > config->h_max_s ? m->miss_s : config->h_max_s;
  *acceleration = 2.0F * shift / (time * time);
  return shift;
}

/* Score of a direction: the acceleration it takes past all active obstacles; `shift` is how far. Behind a wall:
 * large.*/
static float score_of(const alula_avoidance* avoidance, const alula_wall* wall, uint32_t wall_count, const float c[3],
                      float* shift) {
  float score = 0.0F;
  *shift = 0.0F;
  for (uint32_t i = 0; i < avoidance->count; ++i) {
    const alula_encounter* m = avoidance->encounter + i;
    if (!m->active) continue;
    float takes;
    const float s = needed_shift(&avoidance->config, m, c, &takes);
    if (s > *shift) *shift = s;
    if (takes > score) score = takes;
  }
  const float room = avoidance->config.radius_m + avoidance->config.wall_room_m;
  for (uint32_t i = 0; i < wall_count; ++i) {
    const float left = wall[i].distance_m + *shift * dot(wall[i].normal, c) - room;
    if (left < 0.0F) score += 1.0e6F * (1.0F - left); /* the least deep when all are behind one */
  }
  return score;
}

static void choose_direction(alula_avoidance* avoidance, const alula_vehicle_state* vehicle, const alula_track* track,
                             const alula_wall* wall, uint32_t wall_count, uint32_t urgent) {
  static const float diagonal = 0.70710678F;
  predict_misses(avoidance, vehicle, track);
  const float* n = avoidance->encounter[urgent].los;
  float e1[3] = {-n[1], n[0], 0.0F};
  float length = norm(e1);
  if (!(length > 1.0e-3F)) e1[0] = 1.0F, e1[1] = 0.0F, length = 1.0F;
  for (int k = 0; k < 3; ++k) e1[k] /= length;
  const float e2[3] = {n[1] * e1[2] - n[2] * e1[1], n[2] * e1[0] - n[0] * e1[2], n[0] * e1[1] - n[1] * e1[0]};
  float best = FLT_MAX, best_shift = 0.0F, best_direction[3] = {0.0F, 0.0F, 0.0F};
  for (uint32_t i = 0; i < CANDIDATES; ++i) {
    /* eight across the line of sight, then four of them turned back from the obstacle */
    static const float x[8] = {1.0F, 0.70710678F, 0.0F, -0.70710678F, -1.0F, -0.70710678F, 0.0F, 0.70710678F};
    const uint32_t turn = i < 8U ? i : 2U * (i - 8U);
    const float u = x[turn], w = x[(turn + 6U) % 8U];
    float c[3], shift;
    for (int k = 0; k < 3; ++k) {
      c[k] = u * e1[k] + w * e2[k];
      if (i >= 8U) c[k] = diagonal * (c[k] - n[k]);
    }
    const float score = score_of(avoidance, wall, wall_count, c, &shift);
    if (!(score < best)) continue;
    best = score;
    best_shift = shift;
    for (int k = 0; k < 3; ++k) best_direction[k] = c[k];
  }
  if (avoidance->has_bypass) {
    float shift;
    const float held = score_of(avoidance, wall, wall_count, avoidance->direction, &shift);
    if (!(best < (1.0F - avoidance->config.improvement) * held)) {
      best_shift = shift; /* the direction stays; how far is estimated better now than when it was chosen */
      for (int k = 0; k < 3; ++k) best_direction[k] = avoidance->direction[k];
    }
  }
  for (int k = 0; k < 3; ++k) {
    avoidance->direction[k] = best_direction[k];
    avoidance->bypass[k] = vehicle->position[k] + best_shift * best_direction[k];
  }
  avoidance->has_bypass = 1U;
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

/* At the end of a manoeuvre's part? */
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

static void wish(const alula_avoidance* avoidance, const alula_vehicle_state* vehicle, const float nominal[3],
                 float wished[3]) {
  const alula_avoidance_config* c = &avoidance->config;
  for (int k = 0; k < 3; ++k) {
    const float v = vehicle->velocity[k];
    wished[k] = nominal[k];
    if (avoidance->mode == ALULA_AVOID) {
      wished[k] = clipped(c->kp * (avoidance->bypass[k] - vehicle->position[k]) - c->kd * v, c->a_max);
    } else if (avoidance->mode == ALULA_HOVER) {
      wished[k] = clipped(-c->brake * (2.0F / c->stop_s) * v, c->a_max);
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
    choose_direction(avoidance, vehicle, track, wall, wall_count, guidance->urgent);
  wish(avoidance, vehicle, nominal, guidance->wished);
  ++avoidance->ticks_in_mode;
  guidance->mode = avoidance->mode;
  return ALULA_READY;
}

void alula_avoidance_flown(alula_avoidance* avoidance, const float command[3]) {
  for (int k = 0; k < 3; ++k) avoidance->command[k] = command[k];
}
