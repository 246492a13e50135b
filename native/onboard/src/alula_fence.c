#include "alula_fence.h"

#include "vector.h"

#define PIECE 0.25F /* [m] of a chord near the map */
#define PIECES 64U  /* maximum; the pieces of a chord longer than PIECES * PIECE are longer */

static const alula_fence_look* newest(const alula_fence_tracker* tracker) { return &tracker->look[tracker->newest]; }

/* Evaluates the map, unless a recent evaluation is at this position; a failure counts as the smallest psi. */
static const alula_fence_look* look(alula_fence_tracker* tracker, const float at[3]) {
  for (uint32_t k = 0; k < ALULA_FENCE_LOOKS; ++k) {
    const alula_fence_look* old = &tracker->look[k];
    if (old->at[0] == at[0] && old->at[1] == at[1] && old->at[2] == at[2]) {
      tracker->newest = k;
      return old;
    }
  }
  tracker->newest = tracker->next;
  tracker->next = (tracker->next + 1U) % ALULA_FENCE_LOOKS;
  alula_fence_look* place = &tracker->look[tracker->newest];
  float x[3];
  alula_map_value value;
  for (int i = 0; i < 3; ++i) x[i] = tracker->origin[i] + at[i];
  if (alula_map_near_evaluate(tracker->near, x, &value) != ALULA_MAP_READY) tracker->damaged = 1;
  place->psi = value.psi_m;
  for (int i = 0; i < 3; ++i) {
    place->at[i] = at[i];
    place->normal[i] = value.normal[i];
  }
  return place;
}

/* A lower bound of psi here from the stored evaluations. The factor covers the rounding of the distance. */
static float remembered(const alula_fence_tracker* tracker, const float at[3]) {
  const alula_fence_look* last = newest(tracker);
  const float way[3] = {at[0] - last->at[0], at[1] - last->at[1], at[2] - last->at[2]};
  return last->psi - 1.00001F * norm(way);
}

void alula_fence_begin(alula_fence_tracker* tracker, const alula_fence* fence, alula_map_near* near,
                       const float origin[3], float clearance, float push_distance, float push_gain,
                       float push_speed) {
  static const float HERE[3] = {0.0F, 0.0F, 0.0F};
  tracker->fence = fence;
  tracker->near = near;
  tracker->clearance = clearance;
  tracker->push_distance = push_distance;
  tracker->push_gain = push_gain;
  tracker->push_speed = push_speed;
  tracker->damaged = 0;
  for (int i = 0; i < 3; ++i) {
    tracker->origin[i] = origin[i];
    tracker->map_normal[i] = 0.0F;
    tracker->room[i] = fence->has_box ? (origin[i] - fence->lower[i]) - clearance : FLT_MAX;
    tracker->room[3 + i] = fence->has_box ? (fence->upper[i] - origin[i]) - clearance : FLT_MAX;
  }
  for (uint32_t l = 0; l < fence->face_count; ++l) {
    const float* n = fence->face[l];
    tracker->room[ALULA_FENCE_BOX_FACES + l] = (n[3] - dot(n, origin)) - clearance;
  }
  for (uint32_t k = 0; k < ALULA_FENCE_BOX_FACES + fence->face_count; ++k) tracker->least[k] = tracker->room[k];
  tracker->least[ALULA_FENCE_MAP] = FLT_MAX;
  if (!fence->keep_out) return;
  tracker->newest = tracker->next = 0U;
  for (uint32_t k = 0; k < ALULA_FENCE_LOOKS; ++k) tracker->look[k].at[0] = FLT_MAX; /* nowhere */
  const alula_fence_look* here = look(tracker, HERE);
  tracker->least[ALULA_FENCE_MAP] = here->psi - clearance;
  for (int i = 0; i < 3; ++i) tracker->map_normal[i] = here->normal[i];
}

/* cut(gain (push_distance - distance), 0, speed); 0 for NaN. */
static inline float push_of(const alula_fence_tracker* tracker, float distance) {
  const float wanted = tracker->push_gain * (tracker->push_distance - distance);
  if (!(wanted > 0.0F)) return 0.0F;
  return wanted < tracker->push_speed ? wanted : tracker->push_speed;
}

/* Updates the strongest push to either side of each axis. */
static void add_push(float size, const float along[3], float up[3], float down[3]) {
  for (int i = 0; i < 3; ++i) {
    const float push = size * along[i];
    if (push > up[i]) up[i] = push;
    if (push < down[i]) down[i] = push;
  }
}

void alula_fence_push(alula_fence_tracker* tracker, const float at[3], float v_d[3]) {
  const alula_fence* fence = tracker->fence;
  const float near = tracker->push_distance, here[3] = {at[0], at[1], at[2]}; /* copies that no store can alias */
  float up[3] = {0.0F, 0.0F, 0.0F}, down[3] = {0.0F, 0.0F, 0.0F};
  if (fence->has_box) {
    ALULA_UNROLL
    for (int i = 0; i < 3; ++i) {
      const float below = tracker->room[i] + here[i], above = tracker->room[3 + i] - here[i];
      if (below < near) up[i] = push_of(tracker, below);
      if (above < near) down[i] = -push_of(tracker, above);
    }
  }
  const float* room = tracker->room + ALULA_FENCE_BOX_FACES;
  for (uint32_t l = 0; l < fence->face_count; ++l) {
    const float distance = room[l] - dot(fence->face[l], here);
    if (distance < near) add_push(-push_of(tracker, distance), fence->face[l], up, down);
  }
  if (fence->keep_out) {
    const float reach = tracker->push_distance + tracker->clearance;
    if (remembered(tracker, at) < reach) {
      const alula_fence_look* found = look(tracker, at);
      add_push(push_of(tracker, found->psi - tracker->clearance), found->normal, up, down);
    }
  }
  for (int i = 0; i < 3; ++i) v_d[i] = up[i] + down[i];
}

/* Between two evaluations psi_0 and psi_1, l apart, psi >= (psi_0 + psi_1 - l) / 2. */
static void follow_map(alula_fence_tracker* tracker, const float from[3], const float to[3], float allowance) {
  float* least = &tracker->least[ALULA_FENCE_MAP];
  const float kept = tracker->clearance + allowance;
  const float way[3] = {to[0] - from[0], to[1] - from[1], to[2] - from[2]};
  const float length = 1.00001F * norm(way);
  if (remembered(tracker, from) - length - kept >= *least) return;
  const float wanted = length * (1.0F / PIECE);
  const uint32_t pieces = wanted < (float)PIECES ? 1U + (uint32_t)wanted : PIECES; /* NaN: all of them */
  const float piece = length / (float)pieces;
  float before = look(tracker, from)->psi;
  for (uint32_t k = 1U; k <= pieces; ++k) {
    const float part = (float)k / (float)pieces;
    const float between[3] = {from[0] + part * way[0], from[1] + part * way[1], from[2] + part * way[2]};
    const alula_fence_look* here = look(tracker, k == pieces ? to : between);
    const float after = here->psi;
    float bound = 0.5F * (before + after - piece);
    if (before < bound) bound = before; /* only by rounding */
    if (after < bound) bound = after;
    if (bound - kept < *least) {
      *least = bound - kept;
      for (int i = 0; i < 3; ++i) tracker->map_normal[i] = here->normal[i];
    }
    before = after;
  }
}

void alula_fence_follow(alula_fence_tracker* tracker, const float from[3], const float to[3], float allowance) {
  const alula_fence* fence = tracker->fence;
  const float end[3] = {to[0], to[1], to[2]};
  float* least = tracker->least;
  if (fence->has_box) {
    ALULA_UNROLL
    for (int i = 0; i < 3; ++i) {
      const float below = tracker->room[i] + end[i] - allowance, above = tracker->room[3 + i] - end[i] - allowance;
      if (!(below >= least[i])) least[i] = below;
      if (!(above >= least[3 + i])) least[3 + i] = above;
    }
  }
  const float* room = tracker->room + ALULA_FENCE_BOX_FACES;
  float* least_of_face = least + ALULA_FENCE_BOX_FACES;
  for (uint32_t l = 0; l < fence->face_count; ++l) {
    const float value = room[l] - dot(fence->face[l], end) - allowance;
    if (!(value >= least_of_face[l])) least_of_face[l] = value;
  }
  if (fence->keep_out) follow_map(tracker, from, to, allowance);
}
