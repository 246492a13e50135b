#include "dr_acbf_steps.h"
#include "vector.h"

#define PEAK 0.64479396F /* sqrt(2) e^(-pi / 4): peak deceleration over v_0 / H along an active row */
#define NEAREST 1.0e-3F

alula_dr_acbf_config alula_dr_acbf_defaults(void) {
  const alula_dr_acbf_config config = ALULA_DR_ACBF_DEFAULTS;
  return config;
}

alula_status alula_dr_acbf_init(alula_dr_acbf* filter, const alula_dr_acbf_config* config) {
  if (!filter || !config) return ALULA_BAD_POINTER;
  const alula_dr_acbf_config* c = config;
  const alula_avoidance_config* a = &c->avoidance;
  const int good =
      c->v_max > 0.0F && c->v_max < 1.0e4F && (c->j_max == 0.0F || c->j_max >= 1.0e-3F) && c->j_max < 1.0e6F &&
      c->h_min_s >= a->dt_s && c->h_min_s <= a->h_max_s && c->horizons >= 1U && c->horizons <= ALULA_HORIZONS &&
      c->risk > 1.0e-6F && c->risk < 1.0F && c->warned_risk > 0.0F && c->risk * c->warned_risk > 1.0e-6F &&
      c->warned_risk <= 1.0F && c->relaxation > 0.0F && c->relaxation <= 1.0F && c->iterations <= 1000U &&
      c->tolerance >= ALULA_HALF_SPACE_MARGIN * a->a_max && c->tolerance < 1.0F && c->descent_m_s >= 0.0F &&
      c->descent_m_s <= c->v_max && c->wall_deceleration > 0.0F && c->wall_deceleration <= a->a_max &&
      (c->solver == ALULA_SOLVER_EXACT || c->solver == ALULA_SOLVER_GAUSS_SOUTHWELL);
  if (!good) return ALULA_BAD_PARAMETER;
  filter->config = *config;
  filter->projector = 0;
  filter->projector_context = 0;
  const alula_status status = alula_avoidance_init(&filter->avoidance, a);
  if (status == ALULA_READY) alula_dr_acbf_reset(filter);
  return status;
}

void alula_dr_acbf_reset(alula_dr_acbf* filter) {
  filter->failing = 0U;
  filter->row_count = 0U;
  for (int k = 0; k < 3; ++k) filter->executed[k] = 0.0F;
  alula_avoidance_reset(&filter->avoidance);
}

float alula_effective_clearance(const alula_dr_acbf_config* config, const alula_encounter* encounter,
                                float horizon_s) {
  const float latency = config->avoidance.latency_s, h2 = horizon_s * horizon_s;
  return encounter->radius_m + config->v_max * latency + 0.5F * config->avoidance.a_max * latency * latency +
         config->j_max * h2 * horizon_s / 6.0F + 0.5F * encounter->envelope * h2;
}

float alula_row_bound(const alula_dr_acbf_config* config, const alula_encounter* encounter, float horizon_s,
                      float lambda) {
  const float h2 = horizon_s * horizon_s;
  const float sigma = __builtin_sqrtf(encounter->sigma2_p + h2 * encounter->sigma2_v);
  return 2.0F / h2 *
         (encounter->distance_m - alula_effective_clearance(config, encounter, horizon_s) -
          encounter->closing_m_s * horizon_s - lambda * sigma);
}

float alula_cantelli(float alpha) { return __builtin_sqrtf((1.0F - alpha) / alpha); }

void alula_allocate_risk(const alula_encounter* encounter, uint32_t count, float total, float* alpha) {
  float fastest = 0.0F, sum = 0.0F;
  for (uint32_t i = 0; i < count; ++i)
    if (encounter[i].has_row && encounter[i].closing_m_s > fastest) fastest = encounter[i].closing_m_s;
  for (uint32_t i = 0; i < count; ++i) {
    const alula_encounter* m = encounter + i;
    const float d = m->distance_m > NEAREST ? m->distance_m : NEAREST;
    alpha[i] = m->has_row ? (1.0F + m->closing_m_s / (fastest + 1.0e-6F)) / d : 0.0F;
    sum += alpha[i];
  }
  for (uint32_t i = 0; i < count; ++i)
    if (encounter[i].has_row) alpha[i] = alpha[i] / sum * total;
}

float alula_dr_acbf_recursive_speed(float a_max, float horizon_s) { return a_max * horizon_s / PEAK; }

void alula_execute(const alula_dr_acbf_config* config, const float command[3], float executed[3]) {
  const float step = config->j_max * config->avoidance.dt_s;
  for (int k = 0; k < 3; ++k) {
    const float change = command[k] - executed[k];
    executed[k] = step > 0.0F ? executed[k] + clipped(change, step) : command[k];
  }
}

alula_half_space alula_wall_row(const alula_dr_acbf_config* config, const alula_wall* wall, const float velocity[3],
                                const float executed[3], const float commanded[3]) {
  const float brake = config->wall_deceleration;
  alula_half_space row;
  for (int k = 0; k < 3; ++k) row.normal[k] = -wall->normal[k];
  const float doing = dot(row.normal, executed), told = dot(row.normal, commanded);
  const float a = doing > told ? doing : told;
  float lag = config->avoidance.latency_s;
  if (config->j_max > 0.0F && a > -brake) lag += (a + brake) / (2.0F * config->j_max);
  const float v = dot(row.normal, velocity), v_then = v + a * lag;
  const float room = wall->distance_m - config->avoidance.radius_m - config->avoidance.wall_room_m;
  const float x_then = room - 0.5F * (v + v_then) * lag;
  const float s = x_then > 0.0F ? __builtin_sqrtf(2.0F * brake * x_then) : 0.0F;
  row.bound = (s - v_then) / (config->avoidance.dt_s + lag) - brake;
  return row;
}

void alula_dr_acbf_flown(alula_dr_acbf* filter, const float command[3]) {
  for (int k = 0; k < 3; ++k)
    if (!(absolute(command[k]) <= ALULA_LARGEST)) return;
  alula_avoidance_flown(&filter->avoidance, command);
  alula_execute(&filter->config, command, filter->executed);
}

float alula_dr_acbf_set_bounds(alula_dr_acbf* filter, float horizon) {
  float least = FLT_MAX;
  uint32_t row = 0U;
  for (uint32_t i = 0; i < filter->avoidance.count; ++i) {
    const alula_encounter* m = filter->avoidance.encounter + i;
    if (!m->has_row) continue;
    const float bound = alula_row_bound(&filter->config, m, horizon, filter->lambda[i]);
    filter->row[row++].bound = bound;
    if (bound < least) least = bound;
  }
  return least;
}

/* Nonzero if the rows and the box have a common point; `found` is then the nearest to `desired`. */
static int is_feasible(const alula_dr_acbf* filter, const float desired[3], alula_projection* found) {
  const float limit = filter->config.avoidance.a_max;
  for (uint32_t i = 0; i < filter->row_count; ++i) {
    const float* n = filter->row[i].normal;
    float reach = 0.0F;
    for (int k = 0; k < 3; ++k) reach += limit * (n[k] < 0.0F ? -n[k] : n[k]);
    if (filter->row[i].bound < -reach) return 0;
  }
  if (filter->projector) {
    filter->projector(filter->projector_context, filter->row, filter->row_count, limit, desired, found);
  } else {
    alula_project_exact(filter->row, filter->row_count, limit, desired, found);
  }
  return found->feasible;
}

void alula_dr_acbf_horizons(alula_dr_acbf* filter, int longest_only, alula_horizons* horizons) {
  const alula_dr_acbf_config* c = &filter->config;
  const float longest = c->avoidance.h_max_s;
  const uint32_t count = longest_only ? 1U : c->horizons;
  horizons->count = count;
  horizons->tried = 0U;
  for (uint32_t k = 0; k < count; ++k) {
    horizons->at[k] = count == 1U ? longest : c->h_min_s + (longest - c->h_min_s) * (float)k / (float)(count - 1U);
    horizons->least[k] = alula_dr_acbf_set_bounds(filter, horizons->at[k]);
  }
}

int alula_dr_acbf_next(alula_dr_acbf* filter, alula_horizons* horizons, float* horizon_s) {
  uint32_t best = 0U;
  if (horizons->tried == horizons->count) return 0;
  for (uint32_t k = 1U; k < horizons->count; ++k)
    if (horizons->least[k] > horizons->least[best]) best = k;
  ++horizons->tried;
  horizons->least[best] = -FLT_MAX;
  *horizon_s = horizons->at[best];
  (void)alula_dr_acbf_set_bounds(filter, *horizon_s);
  return 1;
}

void alula_dr_acbf_count(alula_dr_acbf* filter, int holds) {
  filter->failing = holds ? 0U : filter->failing + (filter->failing < 1000000U ? 1U : 0U);
}

/* Finds the feasible horizon with the largest minimum bound, testing horizons in that order. */
static int search(alula_dr_acbf* filter, int longest_only, const float desired[3], float* horizon,
                  alula_projection* found) {
  alula_horizons horizons;
  float at;
  alula_dr_acbf_horizons(filter, longest_only, &horizons);
  while (alula_dr_acbf_next(filter, &horizons, &at)) {
    if (horizons.tried == 1U) *horizon = at;
    if (!is_feasible(filter, desired, found)) continue;
    *horizon = at;
    return 1;
  }
  (void)alula_dr_acbf_set_bounds(filter, *horizon);
  return 0;
}

/* Brakes, and then sinks slowly: the fallback when no command has satisfied the rows for some time. */
static void brake_and_descend(const alula_dr_acbf_config* c, const alula_vehicle_state* vehicle, float desired[3]) {
  const float* v = vehicle->velocity;
  const float error[3] = {-v[0], -v[1], -c->descent_m_s - v[2]};
  float largest = 0.0F;
  for (int k = 0; k < 3; ++k) {
    const float size = error[k] < 0.0F ? -error[k] : error[k];
    if (size > largest) largest = size;
  }
  const float reached = c->avoidance.a_max * c->avoidance.dt_s; /* change of speed in a tick */
  const float scale = largest > reached ? c->avoidance.a_max / largest : 1.0F / c->avoidance.dt_s;
  for (int k = 0; k < 3; ++k) desired[k] = clipped(scale * error[k], c->avoidance.a_max);
}

/* Largest violation of the rows from `first` on. */
static float violation_of(const alula_dr_acbf* filter, uint32_t first, const float a[3]) {
  float most = -FLT_MAX;
  for (uint32_t i = first; i < filter->row_count; ++i) {
    const float excess = dot(filter->row[i].normal, a) - filter->row[i].bound;
    if (!(excess <= most)) most = excess;
  }
  return most;
}

alula_status alula_dr_acbf_meet(alula_dr_acbf* filter, const alula_vehicle_state* vehicle, const alula_track* track,
                                uint32_t count, const alula_wall* wall, uint32_t wall_count, const float nominal[3],
                                alula_guidance* guidance, int* longest_only) {
  const alula_dr_acbf_config* c = &filter->config;
  const alula_status step =
      alula_avoidance_step(&filter->avoidance, vehicle, track, count, wall, wall_count, nominal, guidance);
  if (step != ALULA_READY) return step;
  /* Also when a manoeuvre follows the one that ended in this tick. */
  *longest_only = guidance->mode == ALULA_AVOID && filter->avoidance.ticks_in_mode == 1U;
  const int binds = c->rows_before_warning || guidance->mode != ALULA_NOMINAL;

  filter->row_count = 0U;
  if (binds) {
    float* lambda = filter->lambda;
    for (uint32_t i = 0; i < count; ++i) {
      alula_encounter* m = filter->avoidance.encounter + i;
      m->has_row = m->active || (c->receding_rows && m->distance_m < c->avoidance.range_m) ? 1U : 0U;
    }
    alula_allocate_risk(filter->avoidance.encounter, count, *longest_only ? c->risk * c->warned_risk : c->risk,
                        lambda);
    for (uint32_t i = 0; i < count; ++i) {
      const alula_encounter* m = filter->avoidance.encounter + i;
      if (!m->has_row) continue;
      alula_half_space* row = filter->row + filter->row_count++;
      for (int k = 0; k < 3; ++k) row->normal[k] = m->los[k];
      lambda[i] = alula_cantelli(lambda[i]);
    }
  }
  return ALULA_READY;
}

alula_filter_status alula_dr_acbf_filter(alula_dr_acbf* filter, const alula_vehicle_state* vehicle,
                                         const alula_track* track, uint32_t count, const alula_wall* wall,
                                         uint32_t wall_count, const float nominal[3], alula_dr_acbf_result* result) {
  if (!result) return ALULA_FILTER_REFUSED;
  const alula_dr_acbf_result nothing = {.violation = -FLT_MAX};
  *result = nothing;
  if (!filter) return ALULA_FILTER_REFUSED;
  const alula_dr_acbf_config* c = &filter->config;
  alula_guidance* guidance = &result->guidance;
  int enters;
  if (alula_dr_acbf_meet(filter, vehicle, track, count, wall, wall_count, nominal, guidance, &enters) !=
      ALULA_READY) {
    *result = nothing;
    return ALULA_FILTER_REFUSED;
  }
  const uint32_t obstacles = filter->row_count;
  for (uint32_t i = 0; i < wall_count; ++i) {
    filter->row[filter->row_count++] =
        alula_wall_row(c, wall + i, vehicle->velocity, filter->executed, filter->avoidance.command);
  }
  result->rows = filter->row_count;

  const float limit = c->avoidance.a_max;
  alula_projection found;
  result->horizon_s = c->avoidance.h_max_s;
  result->feasible = obstacles > 0U ? search(filter, enters, guidance->desired, &result->horizon_s, &found)
                                    : is_feasible(filter, guidance->desired, &found);
  if (result->feasible && c->solver == ALULA_SOLVER_GAUSS_SOUTHWELL) {
    alula_project_gauss_southwell(filter->row, filter->row_count, limit, c->relaxation, c->iterations,
                                  guidance->desired, &found);
  }
  int holds = result->feasible && found.violation <= c->tolerance;
  if (!holds) {
    alula_project_least_violation(filter->row, filter->row_count, obstacles, limit, guidance->desired, &found);
    holds = found.violation <= c->tolerance;
    if (obstacles > 0U && violation_of(filter, obstacles, found.a) > c->tolerance) { /* walls contradict each other */
      alula_project_least_violation(filter->row + obstacles, wall_count, wall_count, limit, guidance->desired,
                                    &found);
      found.violation = violation_of(filter, 0U, found.a);
    }
  }
  alula_dr_acbf_count(filter, holds);
  if (filter->failing > c->failing_ticks && guidance->mode != ALULA_AVOID) {
    float desired[3];
    brake_and_descend(c, vehicle, desired);
    alula_project_least_violation(filter->row + obstacles, filter->row_count - obstacles, wall_count, limit, desired,
                                  &found);
    found.violation = violation_of(filter, 0U, found.a);
  }
  result->failing = filter->failing;
  result->violation = found.violation;
  result->iterations = found.iterations;
  int same = guidance->mode == ALULA_NOMINAL;
  for (int k = 0; k < 3; ++k) {
    result->a[k] = found.a[k];
    same = same && found.a[k] == nominal[k];
  }
  alula_dr_acbf_flown(filter, result->a);
  if (!holds) return ALULA_FILTER_RECOVERING;
  return same ? ALULA_FILTER_OK : ALULA_FILTER_FILTERED;
}
