#include "alula_stack.h"

#include "chord_rows.h"
#include "dr_acbf_steps.h"
#include "vector.h"

#define LENGTHENED 1.00001F /* more than the relative rounding of a length or a product */
#define RELAXED 4.0F        /* margins by which soft rows are relaxed beyond the minimum, to leave room */

static const alula_stack_result NOTHING = {.status = ALULA_FILTER_REFUSED, .violation_m_s = -FLT_MAX};

alula_stack_config alula_stack_defaults(void) {
  alula_stack_config config = {.polytope_cbf = ALULA_POLYTOPE_CBF_DEFAULTS,
                               .extent_m = 30.0F,
                               .lag_s = 0.35F,
                               .dr_acbf = ALULA_DR_ACBF_DEFAULTS};
  config.polytope_cbf.radius_m = 0.15F;
  config.dr_acbf.v_max = config.polytope_cbf.v_max;
  config.dr_acbf.j_max = 0.0F; /* the lag is the vehicle's only delay */
  config.dr_acbf.avoidance.clearance_m = 0.3F;
  config.dr_acbf.avoidance.obstacle_braking = 0.0F; /* a ball does not brake */
  return config;
}

alula_status alula_stack_init(alula_stack* stack, const alula_map* hulls, const alula_fence* fence,
                              const alula_stack_config* config) {
  if (!stack) return ALULA_BAD_POINTER;
  stack->is_ready = 0;
  if (!config) return ALULA_BAD_POINTER;
  alula_status status =
      alula_chord_open(&stack->chord, hulls, config->extent_m, &config->polytope_cbf, config->lag_s);
  if (status == ALULA_READY) status = alula_dr_acbf_init(&stack->dr_acbf, &config->dr_acbf);
  if (status == ALULA_READY && fence) status = alula_fence_check(fence);
  if (status != ALULA_READY) return status;
  const float dt = config->polytope_cbf.dt_s, lag = config->lag_s;
  if (fence && fence->keep_out) return ALULA_BAD_PARAMETER;
  if (config->dr_acbf.avoidance.dt_s != dt || !(lag >= dt)) return ALULA_BAD_PARAMETER;
  if (!(2.0F * config->polytope_cbf.v_max <= LENGTHENED * lag * config->dr_acbf.avoidance.a_max))
    return ALULA_BAD_PARAMETER;
  stack->fence = fence;
  stack->braking_lag_s = LENGTHENED * dt / (1.0F - alula_expf(-dt / lag));
  stack->is_ready = 1;
  return ALULA_READY;
}

alula_status alula_stack_move(alula_stack* stack, const alula_map* hulls) {
  if (!stack || !stack->is_ready || !hulls) return ALULA_BAD_POINTER;
  return alula_polytope_cbf_move(&stack->chord.hulls, hulls);
}

void alula_stack_reset(alula_stack* stack) {
  if (stack && stack->is_ready) alula_dr_acbf_reset(&stack->dr_acbf);
}

/* Also not for NaN. */
static int is_finite(const float x[3]) {
  return alula_is_finite(x[0]) && alula_is_finite(x[1]) && alula_is_finite(x[2]);
}

/* Puts the rows of hulls and fence behind those of the obstacles, with the soft ones relaxed by the minimum that
 * gives them a common point, `found`; returns the number of all rows. */
static uint32_t gather(alula_stack* stack, uint32_t obstacles, const float wanted[3], float speed,
                       alula_projection* found) {
  const alula_chord* chord = &stack->chord;
  float more = 0.0F;
  if (chord->soft > 0U) {
    alula_project_least_violation(chord->row, chord->count, chord->soft, speed, wanted, found);
    more = (found->violation > 0.0F ? found->violation : 0.0F) + RELAXED * ALULA_HALF_SPACE_MARGIN * speed;
  }
  for (uint32_t i = 0; i < chord->count; ++i) {
    alula_half_space* row = stack->row + obstacles + i;
    *row = chord->row[i];
    if (i < chord->soft) row->bound += more;
  }
  return obstacles + chord->count;
}

/* The obstacles' rows for velocities, from those for accelerations; 0 if one of them is beyond the speed. */
static int set_obstacle_rows(alula_stack* stack, const float velocity[3], uint32_t count, float speed) {
  int can_hold = 1;
  for (uint32_t i = 0; i < count; ++i) {
    const alula_half_space* of = stack->dr_acbf.row + i;
    alula_half_space* row = stack->row + i;
    *row = *of;
    row->bound =
        dot(of->normal, velocity) + of->bound * (of->bound < 0.0F ? stack->braking_lag_s : stack->chord.lag_s);
    if (row->bound < -speed) can_hold = 0;
  }
  return can_hold;
}

/* The point nearest to `wanted` with all rows and the speed; 0 if there is none. Planes that touch the sphere of the
 * speed come behind the rows. */
static int project(alula_stack* stack, uint32_t count, const float wanted[3], float speed, alula_projection* found) {
  for (uint32_t cut = 0;; ++cut) {
    alula_project_exact(stack->row, count, speed, wanted, found);
    if (!found->feasible) return 0;
    const float length = norm(found->a);
    if (length <= LENGTHENED * speed || cut == ALULA_STACK_CUTS) return 1;
    for (int k = 0; k < 3; ++k) stack->row[count].normal[k] = found->a[k] / length;
    stack->row[count++].bound = speed;
  }
}

/* The velocity among all rows; `count` of the obstacles. Returns whether these hold. */
static int avoid(alula_stack* stack, const alula_stack_input* in, uint32_t count, int longest_only,
                 const float desired[3], float speed, alula_stack_result* out) {
  float wanted[3] = {desired[0], desired[1], desired[2]}, horizon;
  alula_horizons horizons;
  alula_projection found, out_of_margin;
  int holds = 0;
  alula_chord_limit(wanted, speed);
  const uint32_t rows = gather(stack, count, wanted, speed, &out_of_margin);
  alula_dr_acbf_horizons(&stack->dr_acbf, longest_only, &horizons);
  while (!holds && alula_dr_acbf_next(&stack->dr_acbf, &horizons, &horizon)) {
    if (horizons.tried == 1U) out->horizon_s = horizon;
    holds = set_obstacle_rows(stack, in->velocity, count, speed) && project(stack, rows, wanted, speed, &found);
    if (holds) out->horizon_s = horizon;
  }
  if (!holds) {
    (void)alula_dr_acbf_set_bounds(&stack->dr_acbf, out->horizon_s);
    (void)set_obstacle_rows(stack, in->velocity, count, speed);
    if (stack->chord.soft == 0U) {
      alula_project_least_violation(stack->row, rows, count, speed, wanted, &found);
    } else {
      found = out_of_margin;
    }
  }
  alula_chord_put(&stack->chord, found.a, speed, &out->chord);
  for (uint32_t i = 0; i < count; ++i) {
    const float excess = dot(stack->row[i].normal, out->chord.u) - stack->row[i].bound;
    if (!(excess <= out->violation_m_s)) out->violation_m_s = excess;
  }
  return out->violation_m_s <= stack->dr_acbf.config.tolerance * stack->chord.lag_s;
}

/* The wanted velocity of this tick, and the obstacles' rows without bounds; 0 if the obstacles are unknown. */
static int look_around(alula_stack* stack, const alula_stack_input* in, const float nominal[3], float speed,
                       float wanted[3], int* longest_only, alula_stack_result* out) {
  const alula_chord* chord = &stack->chord;
  const uint32_t count = chord->count < ALULA_WALLS ? chord->count : ALULA_WALLS;
  const float keeps = chord->hulls.config.radius_m;
  alula_vehicle_state vehicle;
  alula_wall wall[ALULA_WALLS];
  float acceleration[3], within[3] = {nominal[0], nominal[1], nominal[2]};
  alula_chord_limit(within, speed);
  for (int k = 0; k < 3; ++k) {
    vehicle.position[k] = in->position[k];
    vehicle.velocity[k] = in->velocity[k];
    acceleration[k] = (within[k] - in->velocity[k]) / chord->lag_s;
  }
  for (int k = 0; k < 6; ++k) vehicle.covariance[k] = in->covariance[k];
  for (uint32_t i = 0; i < count; ++i) {
    for (int k = 0; k < 3; ++k) wall[i].normal[k] = -chord->row[i].normal[k];
    wall[i].distance_m = chord->spare[i] + keeps;
  }
  if (alula_dr_acbf_meet(&stack->dr_acbf, &vehicle, in->track, in->track_count, wall, count, acceleration,
                         &out->guidance, longest_only) != ALULA_READY) {
    out->guidance = NOTHING.guidance;
    return 0;
  }
  for (int k = 0; k < 3; ++k) {
    const int manoeuvres = out->guidance.mode != ALULA_NOMINAL;
    wanted[k] = manoeuvres ? in->velocity[k] + chord->lag_s * out->guidance.desired[k] : nominal[k];
  }
  return 1;
}

static void report_flown(alula_stack* stack, const alula_stack_input* in, const float u[3]) {
  float a[3];
  for (int k = 0; k < 3; ++k) a[k] = (u[k] - in->velocity[k]) / stack->chord.lag_s;
  alula_dr_acbf_flown(&stack->dr_acbf, a);
}

static alula_filter_status filter(alula_stack* stack, const alula_stack_input* in, alula_stack_result* out) {
  static const float AT_REST[3] = {0.0F, 0.0F, 0.0F};
  alula_chord* chord = &stack->chord;
  const int has_nominal = is_finite(in->nominal);
  float speed, nominal[3] = {0.0F, 0.0F, 0.0F}, wanted[3] = {0.0F, 0.0F, 0.0F};
  int longest_only = 0, holds = 1;
  if (!is_finite(in->position) || !is_finite(in->velocity) ||
      !alula_chord_find_rows(chord, stack->fence, in->position, in->velocity, in->is_taking_off, &speed, &out->chord))
    return ALULA_FILTER_REFUSED;
  for (int k = 0; k < 3 && has_nominal; ++k) nominal[k] = in->nominal[k];
  const int is_known = look_around(stack, in, nominal, speed, wanted, &longest_only, out);
  const uint32_t count = is_known ? stack->dr_acbf.row_count : 0U;
  out->obstacle_rows = count;
  out->rows = count + chord->count;
  if (count > 0U) {
    holds = avoid(stack, in, count, longest_only, wanted, speed, out);
  } else {
    alula_chord_project(chord, wanted, speed, &out->chord);
  }
  if (is_known) alula_dr_acbf_count(&stack->dr_acbf, holds);
  out->failing = stack->dr_acbf.failing;
  if (!holds && out->failing > stack->dr_acbf.config.failing_ticks && out->guidance.mode != ALULA_AVOID) {
    const float sinking[3] = {0.0F, 0.0F, -stack->dr_acbf.config.descent_m_s};
    alula_chord_project(chord, sinking, speed, &out->chord);
  }
  const alula_filter_status status = alula_chord_status(chord, has_nominal ? in->nominal : AT_REST, &out->chord);
  report_flown(stack, in, out->chord.u);
  if (!has_nominal || !is_known || status == ALULA_FILTER_REFUSED) return ALULA_FILTER_REFUSED;
  return holds ? status : ALULA_FILTER_RECOVERING;
}

alula_filter_status alula_stack_filter(alula_stack* stack, const alula_stack_input* input,
                                       alula_stack_result* result) {
  if (!result) return ALULA_FILTER_REFUSED;
  *result = NOTHING;
  alula_chord_clear(&result->chord);
  if (!stack || !input || !stack->is_ready) return ALULA_FILTER_REFUSED;
  result->status = filter(stack, input, result);
  for (int k = 0; k < 3; ++k) result->velocity[k] = result->chord.u[k];
  return result->status;
}
