/* Choice of the bypass point to which a manoeuvre of alula_avoidance.h flies. */
#include "alula_avoidance.h"
#include "vector.h"

#define CANDIDATES 12U
#define SHORTEST_S 0.05F /* shortest time to the closest approach, */
#define LONGEST_S 3.0F   /* and the longest that is considered */
#define LOOKS 24U        /* evaluations of the distance in between, before the ternary search */
#define THIRDS 12U

static float offset_at(const float p[3], const float v[3], const float a[3], float t, float at[3]) {
  for (int k = 0; k < 3; ++k) at[k] = p[k] + (v[k] + 0.5F * a[k] * t) * t;
  return dot(at, at);
}

/* The time at which |p + v t + a t^2 / 2| is smallest, SHORTEST_S to LONGEST_S from now: the best of evenly spaced
 * times, then a ternary search between its neighbours. There the distance has one minimum, unless the acceleration
 * reverses an obstacle within a step. */
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

/* The closest approach of each active obstacle to a vehicle that hovers here, as it will at the bypass point. So the
 * remaining shift is the remaining distance, at any speed of the vehicle. */
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

/* The shift along c of the closest approach to an obstacle that keeps `clearance`, and the acceleration that it
 * needs. */
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

/* Score of a direction: the acceleration needed to pass all active obstacles; `shift` is the distance. Large behind a
 * wall. */
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
    if (left < 0.0F) score += 1.0e6F * (1.0F - left); /* selects the smallest depth when all are behind a wall */
  }
  return score;
}

void alula_choose_bypass(alula_avoidance* avoidance, const alula_vehicle_state* vehicle, const alula_track* track,
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
      best_shift = shift; /* the direction stays; the distance is estimated better than when it was chosen */
      for (int k = 0; k < 3; ++k) best_direction[k] = avoidance->direction[k];
    }
  }
  for (int k = 0; k < 3; ++k) {
    avoidance->direction[k] = best_direction[k];
    avoidance->bypass[k] = vehicle->position[k] + best_shift * best_direction[k];
  }
  avoidance->has_bypass = 1U;
}
