#include "alula_stack.h"

#include "polytope_walk.h"
#include "racer_steps.h"
#include "stack_walls.h"

#define LEAST_GAIN_RATIO 4.0F /* d'' + k d' + k beta d = 0 does not oscillate for k >= 4 beta */
#define MOST_FALL 0.95F       /* a_max / g: the thrust of a fall stays well defined */

static const alula_stack_result NOTHING = {.status = ALULA_FILTER_REFUSED};

alula_stack_config alula_stack_defaults(void) {
  alula_stack_config config = {.parts = 7U,
                               .takes = ALULA_STACK_VELOCITY,
                               .gives = ALULA_STACK_STICKS,
                               .polytope_cbf = ALULA_POLYTOPE_CBF_DEFAULTS,
                               .extent_m = 0.0F,
                               .dr_acbf = ALULA_DR_ACBF_DEFAULTS,
                               .geofence = ALULA_GEOFENCE_DEFAULTS,
                               .velocity_gain = 2.5F,
                               .most_walls = 8U};
  config.polytope_cbf.beta = 0.6F;
  config.geofence.tick_s = config.dr_acbf.avoidance.dt_s;
  return config;
}

static int parts_are_in_order(const alula_stack_config* c) {
  const uint32_t all = (1U << ALULA_STACK_PARTS) - 1U;
  const uint32_t takes = (uint32_t)c->takes, gives = (uint32_t)c->gives;
  if (c->parts == 0U || c->parts > all || takes > gives || gives > (uint32_t)ALULA_STACK_STICKS) return 0;
  if ((c->parts >> ALULA_STACK_POLYTOPE_CBF & 1U) != 0U && c->takes != ALULA_STACK_VELOCITY) return 0;
  if ((c->parts >> ALULA_STACK_GEOFENCE & 1U) != 0U && c->gives != ALULA_STACK_STICKS) return 0;
  if ((c->parts >> ALULA_STACK_DR_ACBF & 1U) == 0U) return 1;
  return c->takes != ALULA_STACK_STICKS && c->gives != ALULA_STACK_VELOCITY;
}

/* It also brakes for a nominal acceleration that is refused. */
static int has_velocity_loop(const alula_stack_config* c) {
  return c->takes != ALULA_STACK_STICKS && c->gives != ALULA_STACK_VELOCITY;
}

static int steps_are_equal(const alula_stack_config* c) {
  const float step[ALULA_STACK_PARTS] = {c->polytope_cbf.dt_s, c->dr_acbf.avoidance.dt_s, c->geofence.tick_s};
  float first = 0.0F;
  for (uint32_t k = 0; k < ALULA_STACK_PARTS; ++k) {
    if ((c->parts >> k & 1U) == 0U) continue;
    if (first == 0.0F) first = step[k];
    if (!(step[k] == first && step[k] > 0.0F)) return 0;
  }
  return !has_velocity_loop(c) || c->velocity_gain * first <= 1.0F;
}

/* Checks the loops between the parts; the model is valid. */
static int loops_are_good(const alula_stack_config* c) {
  const float a = c->dr_acbf.avoidance.a_max, g = c->geofence.model.gravity;
  if (!has_velocity_loop(c)) return 1;
  if (!(c->velocity_gain > 0.0F && c->velocity_gain <= ALULA_LARGEST)) return 0;
  if ((c->parts >> ALULA_STACK_POLYTOPE_CBF & 1U) != 0U &&
      !(c->velocity_gain >= LEAST_GAIN_RATIO * c->polytope_cbf.beta))
    return 0;
  if (!(a > 0.0F && a <= ALULA_LARGEST)) return 0;
  if (c->gives != ALULA_STACK_STICKS) return 1;
  const float force[3] = {a, a, g + a};
  return a <= MOST_FALL * g && alula_racer_thrust(&c->geofence.model, 1.0F) >= norm(force);
}

/* polytope-cbf constrains the velocity towards the nearest hulls only: a vehicle that lags cannot stop before the
 * next.
 */
static int hulls_are_kept_by_another(const alula_stack* stack, const alula_fence* fence) {
  if (!alula_stack_has(stack, ALULA_STACK_POLYTOPE_CBF) || stack->config.gives == ALULA_STACK_VELOCITY) return 1;
  if (alula_stack_has(stack, ALULA_STACK_DR_ACBF)) return 1;
  return alula_stack_has(stack, ALULA_STACK_GEOFENCE) && fence->keep_out;
}

static alula_status set_up_parts(alula_stack* stack, const alula_map* hulls, const alula_fence* fence) {
  const alula_stack_config* c = &stack->config;
  alula_status status = ALULA_READY;
  if (alula_stack_has(stack, ALULA_STACK_POLYTOPE_CBF))
    status = alula_polytope_cbf_open(&stack->polytope_cbf, hulls, c->extent_m, &c->polytope_cbf);
  if (status == ALULA_READY && alula_stack_has(stack, ALULA_STACK_DR_ACBF))
    status = alula_dr_acbf_init(&stack->dr_acbf, &c->dr_acbf);
  if (status != ALULA_READY || c->gives != ALULA_STACK_STICKS) return status;
  if (alula_stack_has(stack, ALULA_STACK_GEOFENCE)) return alula_geofence_init(&stack->geofence, fence, &c->geofence);
  alula_geofence_conditions unused;
  status = alula_geofence_examine(&c->geofence, &unused);
  return status == ALULA_BAD_PARAMETER ? status : ALULA_READY; /* without a geofence only its ranges matter */
}

alula_status alula_stack_init(alula_stack* stack, const alula_map* hulls, const alula_fence* fence,
                              const alula_stack_config* config) {
  if (!stack) return ALULA_BAD_POINTER;
  stack->is_ready = 0;
  if (!config) return ALULA_BAD_POINTER;
  if (!parts_are_in_order(config) || !steps_are_equal(config) || config->most_walls > ALULA_WALLS)
    return ALULA_BAD_PARAMETER;
  stack->config = *config;
  if (alula_stack_has(stack, ALULA_STACK_POLYTOPE_CBF) && !hulls) return ALULA_BAD_POINTER;
  if (alula_stack_has(stack, ALULA_STACK_GEOFENCE) && !fence) return ALULA_BAD_POINTER;
  if (!hulls_are_kept_by_another(stack, fence)) return ALULA_BAD_PARAMETER;
  const alula_status status = set_up_parts(stack, hulls, fence);
  if (status != ALULA_READY) return status;
  if (!loops_are_good(config)) return ALULA_BAD_PARAMETER;
  stack->hover = config->gives == ALULA_STACK_STICKS ? alula_racer_hover_throttle(&config->geofence.model) : 0.0F;
  if (alula_stack_has(stack, ALULA_STACK_POLYTOPE_CBF)) alula_walk_forget(&stack->polytope_cbf);
  stack->is_ready = 1;
  return ALULA_READY;
}

alula_status alula_stack_move(alula_stack* stack, const alula_map* hulls) {
  if (!stack || !stack->is_ready || !hulls) return ALULA_BAD_POINTER;
  if (!alula_stack_has(stack, ALULA_STACK_POLYTOPE_CBF)) return ALULA_READY;
  return alula_polytope_cbf_move(&stack->polytope_cbf, hulls);
}

void alula_stack_reset(alula_stack* stack) {
  if (!stack || !stack->is_ready) return;
  if (alula_stack_has(stack, ALULA_STACK_DR_ACBF)) alula_dr_acbf_reset(&stack->dr_acbf);
  if (alula_stack_has(stack, ALULA_STACK_GEOFENCE)) alula_geofence_reset(&stack->geofence);
}

static int are_within(const float v[3], float limit) {
  return absolute(v[0]) <= limit && absolute(v[1]) <= limit && absolute(v[2]) <= limit; /* not for NaN */
}

/* gain (v_d - v), shortened to |a|_inf <= a_max; both velocities are within ALULA_LARGEST. */
static void follow(const alula_stack_config* c, const float v_d[3], const float v[3], float a[3]) {
  const float limit = c->dr_acbf.avoidance.a_max;
  float largest = 0.0F;
  for (int k = 0; k < 3; ++k) {
    a[k] = c->velocity_gain * (v_d[k] - v[k]);
    if (absolute(a[k]) > largest) largest = absolute(a[k]);
  }
  if (!(largest > limit)) return;
  const float scale = limit / largest;
  for (int k = 0; k < 3; ++k) a[k] = clipped(scale * a[k], limit);
}

static void brake(const alula_stack_config* c, const float velocity[3], float a[3]) {
  static const float AT_REST[3] = {0.0F, 0.0F, 0.0F};
  a[0] = a[1] = a[2] = 0.0F;
  if (are_within(velocity, ALULA_LARGEST)) follow(c, AT_REST, velocity, a);
}

static alula_filter_status filter_velocity(alula_stack* stack, const alula_stack_input* in, int has_nominal,
                                           alula_stack_result* out) {
  if (!has_nominal) return ALULA_FILTER_REFUSED;
  if (!alula_stack_has(stack, ALULA_STACK_POLYTOPE_CBF)) {
    for (int k = 0; k < 3; ++k) out->velocity[k] = in->nominal[k];
    return ALULA_FILTER_OK;
  }
  const alula_filter_status status =
      alula_polytope_cbf_filter(&stack->polytope_cbf, in->state.position, in->nominal, &out->polytope_cbf);
  for (int k = 0; k < 3; ++k) out->velocity[k] = out->polytope_cbf.u[k];
  out->part[ALULA_STACK_POLYTOPE_CBF] = status;
  return status;
}

/* Brakes as far as the stack's own walls allow. */
static void brake_between_walls(alula_stack* stack, const alula_stack_input* in, uint32_t first, uint32_t count,
                                float a[3]) {
  const alula_stack_config* c = &stack->config;
  alula_dr_acbf* filter = &stack->dr_acbf;
  brake(c, in->state.velocity, a);
  if (count > 0U) {
    alula_projection found;
    for (uint32_t i = 0; i < count; ++i) {
      filter->row[i] = alula_wall_row(&filter->config, stack->wall + first + i, in->state.velocity, filter->executed,
                                      filter->avoidance.command);
    }
    alula_project_least_violation(filter->row, count, count, c->dr_acbf.avoidance.a_max, a, &found);
    for (int k = 0; k < 3; ++k) a[k] = found.a[k];
  }
  alula_dr_acbf_flown(filter, a);
}

static alula_filter_status filter_acceleration(alula_stack* stack, const alula_stack_input* in, float a[3],
                                               alula_stack_result* out) {
  alula_vehicle_state vehicle;
  for (int k = 0; k < 3; ++k) {
    vehicle.position[k] = in->state.position[k];
    vehicle.velocity[k] = in->state.velocity[k];
  }
  for (int k = 0; k < 6; ++k) vehicle.covariance[k] = in->covariance[k];
  const int has_walls = in->wall_count <= ALULA_WALLS && (in->wall_count == 0U || in->wall);
  const uint32_t given = has_walls ? in->wall_count : 0U, left = ALULA_WALLS - given;
  const uint32_t room = stack->config.most_walls < left ? stack->config.most_walls : left;
  uint32_t found = 0U;
  for (uint32_t i = 0; i < given; ++i) stack->wall[i] = in->wall[i];
  if (are_within(vehicle.position, ALULA_LARGEST) && are_within(vehicle.velocity, ALULA_LARGEST))
    found =
        alula_stack_walls(stack, vehicle.position, vehicle.velocity, room, stack->wall + given, &out->walls_are_full);
  out->walls = given + found;
  alula_filter_status status = ALULA_FILTER_REFUSED;
  if (has_walls)
    status = alula_dr_acbf_filter(&stack->dr_acbf, &vehicle, in->track, in->track_count, stack->wall, given + found,
                                  a, &out->dr_acbf);
  if (status == ALULA_FILTER_REFUSED) {
    brake_between_walls(stack, in, given, found, a);
  } else {
    for (int k = 0; k < 3; ++k) a[k] = out->dr_acbf.a[k];
  }
  out->part[ALULA_STACK_DR_ACBF] = status;
  return status;
}

/* Thrust and attitude for an acceleration in the box, at the current yaw. */
static void fly_acceleration(const alula_stack_config* c, const alula_racer_state* measured, const float a[3],
                             float yaw_rate, alula_racer_command* command) {
  alula_racer_state state = *measured;
  float axis[3], force[3] = {a[0], a[1], a[2] + c->geofence.model.gravity};
  alula_racer_normalise(&state);
  axis_of(state.attitude, axis);
  command->throttle = alula_racer_throttle_for(&c->geofence.model, dot(force, axis));
  const alula_backup_hold hold = alula_backup_hold_at(&state, 0.0F);
  const float inverse = 1.0F / norm(force); /* the box leaves force[2] above 0 */
  const float bx = inverse * (hold.cosine * force[0] + hold.sine * force[1]);
  const float by = inverse * (hold.cosine * force[1] - hold.sine * force[0]);
  const float w = __builtin_sqrtf(0.5F + 0.5F * inverse * force[2]), half = 0.5F / w;
  /* q_d = (half_c, 0, 0, half_s) (w, -b_y / 2w, b_x / 2w, 0) */
  const float x = -half * by, y = half * bx;
  attitude_rates(c->geofence.backup.attitude_gain, hold.half_c * w, hold.half_c * x - hold.half_s * y,
                 hold.half_c * y + hold.half_s * x, hold.half_s * w, state.attitude, command->rates);
  command->rates[2] += yaw_rate;
  limit_command(&c->geofence.model, command);
}

/* Reports to dr-acbf the acceleration that the geofence's command gives at this attitude, instead of its own. */
static void report_flown(alula_stack* stack, const alula_racer_state* measured, const float executed[3],
                         const alula_racer_command* command) {
  alula_racer_state state = *measured;
  float axis[3], flown[3];
  alula_racer_normalise(&state);
  axis_of(state.attitude, axis);
  const float thrust = thrust_of(&stack->config.geofence.model, command->throttle);
  for (int k = 0; k < 3; ++k) {
    stack->dr_acbf.executed[k] = executed[k];
    flown[k] = thrust * axis[k] - (k == 2 ? stack->config.geofence.model.gravity : 0.0F);
  }
  alula_dr_acbf_flown(&stack->dr_acbf, flown);
}

static alula_filter_status status_of(alula_geofence_status outcome) {
  switch (outcome) {
    case ALULA_GEOFENCE_PASSED:
      return ALULA_FILTER_OK;
    case ALULA_GEOFENCE_BLENDED:
      return ALULA_FILTER_FILTERED;
    case ALULA_GEOFENCE_BACKUP:
    case ALULA_GEOFENCE_NO_PILOT:
      return ALULA_FILTER_RECOVERING;
    case ALULA_GEOFENCE_HAND_OVER:
    case ALULA_GEOFENCE_REFUSED:
    default:
      return ALULA_FILTER_REFUSED;
  }
}

static void raise_to(alula_filter_status* worst, alula_filter_status status) {
  if (status > *worst) *worst = status;
}

/* Throttle and rates; `pilot` is null without a usable command. */
static alula_filter_status filter_sticks(alula_stack* stack, const alula_stack_input* in, int is_valid,
                                         const alula_racer_command* pilot, alula_stack_result* out) {
  if (!alula_stack_has(stack, ALULA_STACK_GEOFENCE)) {
    if (pilot) {
      out->sticks = *pilot;
      alula_racer_limit(&stack->config.geofence.model, &out->sticks);
      return ALULA_FILTER_OK;
    }
    out->sticks.throttle = stack->hover;
    out->sticks.rates[0] = out->sticks.rates[1] = out->sticks.rates[2] = 0.0F;
    return ALULA_FILTER_REFUSED;
  }
  out->outcome = alula_geofence_filter(&stack->geofence, is_valid ? &in->state : 0, pilot, &out->geofence);
  out->sticks = out->geofence.command;
  out->part[ALULA_STACK_GEOFENCE] = status_of(out->outcome);
  return out->part[ALULA_STACK_GEOFENCE];
}

static alula_filter_status filter(alula_stack* stack, const alula_stack_input* in, alula_stack_result* out) {
  const alula_stack_config* c = &stack->config;
  alula_filter_status worst = ALULA_FILTER_OK;
  const int is_kind = in->kind == c->takes;
  const int has_yaw = c->gives != ALULA_STACK_STICKS || alula_is_finite(in->yaw_rate_rad_s);
  const int has_nominal = is_kind && has_yaw && are_within(in->nominal, FLT_MAX); /* of kinds but sticks */
  if (c->takes == ALULA_STACK_VELOCITY) raise_to(&worst, filter_velocity(stack, in, has_nominal, out));
  if (c->gives == ALULA_STACK_VELOCITY) return worst;

  float a[3] = {0.0F, 0.0F, 0.0F}, executed[3] = {0.0F, 0.0F, 0.0F};
  const int has_dr_acbf = alula_stack_has(stack, ALULA_STACK_DR_ACBF);
  if (c->takes != ALULA_STACK_STICKS) {
    const int can_follow = are_within(in->state.velocity, ALULA_LARGEST) && are_within(out->velocity, ALULA_LARGEST);
    if (c->takes == ALULA_STACK_VELOCITY && can_follow) {
      follow(c, out->velocity, in->state.velocity, a);
    } else if (c->takes == ALULA_STACK_ACCELERATION && has_nominal) {
      for (int k = 0; k < 3; ++k) a[k] = in->nominal[k];
    } else {
      brake(c, in->state.velocity, a);
      raise_to(&worst, ALULA_FILTER_REFUSED);
    }
    if (has_dr_acbf) {
      for (int k = 0; k < 3; ++k) executed[k] = stack->dr_acbf.executed[k];
      raise_to(&worst, filter_acceleration(stack, in, a, out));
    }
    for (int k = 0; k < 3; ++k) out->acceleration[k] = a[k] = clipped(a[k], c->dr_acbf.avoidance.a_max);
  }
  if (c->gives == ALULA_STACK_ACCELERATION) return worst;

  const int is_valid = alula_racer_state_is_valid(&in->state);
  alula_racer_command made;
  const alula_racer_command* pilot = 0;
  if (c->takes == ALULA_STACK_STICKS) {
    if (is_kind && alula_racer_command_is_finite(&in->sticks)) pilot = &in->sticks;
  } else if (is_valid) {
    fly_acceleration(c, &in->state, a, has_nominal ? in->yaw_rate_rad_s : 0.0F, &made);
    pilot = &made;
  }
  if (!pilot) raise_to(&worst, ALULA_FILTER_REFUSED);
  raise_to(&worst, filter_sticks(stack, in, is_valid, pilot, out));
  if (has_dr_acbf && is_valid && alula_stack_has(stack, ALULA_STACK_GEOFENCE) &&
      out->outcome != ALULA_GEOFENCE_PASSED)
    report_flown(stack, &in->state, executed, &out->sticks);
  return worst;
}

alula_filter_status alula_stack_filter(alula_stack* stack, const alula_stack_input* input,
                                       alula_stack_result* result) {
  if (!result) return ALULA_FILTER_REFUSED;
  *result = NOTHING;
  if (!stack || !input || !stack->is_ready) return ALULA_FILTER_REFUSED;
  result->status = filter(stack, input, result);
  return result->status;
}
