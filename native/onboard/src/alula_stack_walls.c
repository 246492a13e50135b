/* Chooses the planes of hulls and of the fence that limit the speed of a vehicle the most. */
#include "polytope_walk.h"
#include "sorted.h"
#include "stack_walls.h"

#define ROUNDING 1.0e-5F    /* more than the relative rounding of the sums and roots below */
#define DIAGONAL 1.7320509F /* sqrt 3, rounded up: |a| <= sqrt 3 |a|_inf */

/* The most urgent walls so far, sorted by the additional speed from which the vehicle could stop. */
typedef struct {
  alula_wall* wall;
  uint32_t count, room;
  float spare[ALULA_WALLS];
  const float* velocity;
  float speed, keep, brake; /* |velocity|, radius + room, a_w */
  float reach;              /* no wall farther away can bind, or displace one of the list */
} choice;

/* sqrt(2 a_w x), odd in x. */
static float stopping_speed(float brake, float x) {
  return x < 0.0F ? -__builtin_sqrtf(-2.0F * brake * x) : __builtin_sqrtf(2.0F * brake * x);
}

/* A distance from which no row of alula_wall_row binds: its bound is then at least sqrt 3 a_max, towards any wall. */
static float binding_reach(const alula_dr_acbf* filter, float speed) {
  const alula_dr_acbf_config* c = &filter->config;
  const float most = DIAGONAL * c->avoidance.a_max, brake = c->wall_deceleration;
  const float doing = norm(filter->executed), told = norm(filter->avoidance.command);
  const float a = doing > told ? doing : told;
  float lag = c->avoidance.latency_s;
  if (c->j_max > 0.0F) lag += (a + brake) / (2.0F * c->j_max);
  const float then = speed + a * lag;
  const float needed = then + (most + brake) * (c->avoidance.dt_s + lag);
  const float room = needed * needed / (2.0F * brake) + 0.5F * (speed + then) * lag;
  return (room + c->avoidance.radius_m + c->avoidance.wall_room_m) * (1.0F + ROUNDING);
}

/* A wall at a distance d has at least stopping_speed(d - keep) - |v| to spare. */
static void shorten_reach(choice* chosen) {
  const float spare = chosen->spare[chosen->count - 1U] + chosen->speed;
  const float square = spare * absolute(spare) / (2.0F * chosen->brake);
  const float reach = chosen->keep + square + ROUNDING * (chosen->keep + absolute(square));
  if (reach < chosen->reach) chosen->reach = reach;
}

static void remove_wall(choice* chosen, uint32_t at) {
  --chosen->count;
  for (uint32_t i = at; i < chosen->count; ++i) {
    chosen->wall[i] = chosen->wall[i + 1U];
    chosen->spare[i] = chosen->spare[i + 1U];
  }
}

static void consider(choice* chosen, const float normal[3], float distance) {
  if (!(distance <= chosen->reach)) return;
  for (uint32_t i = 0; i < chosen->count; ++i) {
    const alula_wall* other = chosen->wall + i;
    if (other->normal[0] != normal[0] || other->normal[1] != normal[1] || other->normal[2] != normal[2]) continue;
    if (other->distance_m <= distance) return;
    remove_wall(chosen, i);
    break;
  }
  const float spare = stopping_speed(chosen->brake, distance - chosen->keep) + dot(normal, chosen->velocity);
  if (chosen->count == chosen->room) {
    if (chosen->room == 0U || !(spare < chosen->spare[chosen->count - 1U])) return;
    --chosen->count;
  }
  const uint32_t at = insert_sorted(chosen->spare, chosen->count, spare);
  for (uint32_t i = chosen->count++; i > at; --i) chosen->wall[i] = chosen->wall[i - 1U];
  for (int k = 0; k < 3; ++k) chosen->wall[at].normal[k] = normal[k];
  chosen->wall[at].distance_m = distance;
  if (chosen->count == chosen->room) shorten_reach(chosen);
}

static void consider_fence(choice* chosen, const alula_fence* fence, const float x[3]) {
  for (int i = 0; fence->has_box && i < 3; ++i) {
    float normal[3] = {0.0F, 0.0F, 0.0F};
    normal[i] = 1.0F;
    consider(chosen, normal, x[i] - fence->lower[i]);
    normal[i] = -1.0F;
    consider(chosen, normal, fence->upper[i] - x[i]);
  }
  for (uint32_t l = 0; l < fence->face_count; ++l) {
    const float* face = fence->face[l];
    const float normal[3] = {-face[0], -face[1], -face[2]};
    consider(chosen, normal, face[3] - dot(face, x));
  }
}

static void consider_walk(choice* chosen, alula_polytope_cbf* cbf, const float x[3]) {
  alula_walk_rule rule = {chosen->reach, ALULA_NO_HULL, 0.0F, 0.0F, -FLT_MAX};
  alula_walk walk;
  float hard;
  alula_walk_begin(cbf, &walk);
  while (alula_walk_next(cbf, &rule, x, &walk)) {
    if (!alula_walk_planes(cbf, &rule, x, &walk, &hard)) continue;
    const float* const end = walk.plane + 4U * walk.plane_count;
    const float* deciding = walk.plane;
    float most = -FLT_MAX;
    for (const float* plane = walk.plane; plane < end && most < hard; plane += 4) {
      const float value = alula_plane_value(plane, x);
      if (!(value > most)) continue;
      most = value;
      deciding = plane;
    }
    consider(chosen, deciding, hard);
    rule.nearer = chosen->reach;
  }
}

/* The hulls that polytope-cbf listed in this tick come first, if it did: with them the reach is short when all others
 * follow. They are then considered again, which changes nothing. The list is forgotten, as it is of this tick. */
static void consider_hulls(choice* chosen, alula_polytope_cbf* cbf, const float x[3]) {
  for (int k = 0; k < 3; ++k)
    if (!(absolute(x[k]) <= cbf->map.extent_m)) return; /* the call refused it and has no list */
  if (cbf->near_count != ALULA_NO_LIST) consider_walk(chosen, cbf, x);
  alula_walk_forget(cbf);
  consider_walk(chosen, cbf, x);
}

uint32_t alula_stack_walls(alula_stack* stack, const float position[3], const float velocity[3], uint32_t room,
                           alula_wall* wall, int* is_full) {
  const alula_dr_acbf_config* c = &stack->config.dr_acbf;
  choice chosen;
  chosen.wall = wall;
  chosen.count = 0U;
  chosen.room = room;
  chosen.velocity = velocity;
  chosen.speed = norm(velocity);
  chosen.keep = c->avoidance.radius_m + c->avoidance.wall_room_m;
  chosen.brake = c->wall_deceleration;
  chosen.reach = binding_reach(&stack->dr_acbf, chosen.speed);
  const int has_fence = alula_stack_has(stack, ALULA_STACK_GEOFENCE);
  if (has_fence) consider_fence(&chosen, stack->geofence.fence, position);
  if (alula_stack_has(stack, ALULA_STACK_POLYTOPE_CBF) && !stack->polytope_cbf.is_damaged) {
    consider_hulls(&chosen, &stack->polytope_cbf, position);
    if (stack->polytope_cbf.is_damaged) { /* its planes may be anything */
      chosen.count = 0U;
      chosen.reach = binding_reach(&stack->dr_acbf, chosen.speed);
      if (has_fence) consider_fence(&chosen, stack->geofence.fence, position);
    }
  }
  *is_full = chosen.count == room;
  return chosen.count;
}
