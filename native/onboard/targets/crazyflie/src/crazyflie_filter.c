#include "crazyflie_filter.h"

#define LARGEST_GAIN 20.0F
#define LARGEST_SPEED 20.0F
#define LARGEST_WISH 1.0e6F
#define LARGEST_FAR 1.0e3F /* of an obstacle */
#define FLAT 1.0e-3F       /* squared length of the heading's projection below which the yaw is undefined */

alula_crazyflie_config alula_crazyflie_defaults(void) {
  const alula_polytope_cbf_config filter = ALULA_POLYTOPE_CBF_DEFAULTS;
  alula_crazyflie_config config;
  config.radius_m = 0.15F;
  config.beta = filter.beta;
  config.lag = 0.35F;
  config.v_max = 1.0F;
  config.period_s = 0.01F;
  config.gain = 2.0F;
  config.variance = 0.0025F;
  config.enabled = 1U;
  config.attitude = 0U;
#if ALULA_CRAZYFLIE_OBSTACLES > 0U
  config.fenced = 0U;
  for (int i = 0; i < 3; ++i) {
    config.lower[i] = -1.0F;
    config.upper[i] = 1.0F;
  }
#endif
  return config;
}

static int all_finite(const float* x, int count) {
  for (int i = 0; i < count; ++i) {
    if (!alula_is_finite(x[i])) return 0;
  }
  return 1;
}

/* Checks the parameters of this file; the filter checks the rest. */
static int config_is_good(const alula_crazyflie_config* c) {
  return c->gain > 0.0F && c->gain <= LARGEST_GAIN && c->v_max <= LARGEST_SPEED && c->variance > 0.0F &&
         c->variance <= 1.0F && c->period_s >= 0.001F && c->period_s <= 0.1F;
}

#if ALULA_CRAZYFLIE_OBSTACLES > 0U
static int open_filter(alula_crazyflie_filter* filter, const alula_polytope_cbf_config* wanted,
                       const alula_crazyflie_config* config) {
  alula_stack_config c = alula_stack_defaults();
  c.polytope_cbf = *wanted;
  c.extent_m = ALULA_CRAZYFLIE_EXTENT;
  c.lag_s = config->lag;
  c.dr_acbf.v_max = wanted->v_max;
  c.dr_acbf.avoidance.dt_s = wanted->dt_s;
  c.dr_acbf.avoidance.radius_m = wanted->radius_m;
  c.dr_acbf.avoidance.latency_s = wanted->dt_s; /* positions are those at which the command begins */
  const alula_fence none = {.has_box = 0};
  filter->fence = none;
  filter->fence.has_box = config->fenced != 0U;
  for (int i = 0; i < 3; ++i) {
    filter->fence.lower[i] = config->lower[i];
    filter->fence.upper[i] = config->upper[i];
  }
  return alula_stack_init(&filter->stack, &filter->map, config->fenced ? &filter->fence : 0, &c) == ALULA_READY;
}
#else
static int open_filter(alula_crazyflie_filter* filter, const alula_polytope_cbf_config* wanted,
                       const alula_crazyflie_config* config) {
  return alula_chord_open(&filter->chord, &filter->map, ALULA_CRAZYFLIE_EXTENT, wanted, config->lag) == ALULA_READY;
}
#endif

static int apply(alula_crazyflie_filter* filter, const alula_crazyflie_config* config) {
  alula_polytope_cbf_config wanted = ALULA_POLYTOPE_CBF_DEFAULTS;
  wanted.radius_m = config->radius_m;
  wanted.beta = config->beta;
  wanted.dt_s = config->period_s;
  wanted.v_max = config->v_max;
  return open_filter(filter, &wanted, config);
}

int alula_crazyflie_configure(alula_crazyflie_filter* filter, const alula_crazyflie_config* config) {
  if (!filter->map.data || !config_is_good(config)) return 0;
  if (!apply(filter, config)) {
    if (filter->is_open) filter->is_open = apply(filter, &filter->config); /* the last ones were accepted */
    return 0;
  }
  filter->config = *config;
  return 1;
}

static void set_velocity(alula_crazyflie_output* output, alula_crazyflie_status status, const float* velocity) {
  output->status = status;
  output->is_off = 0;
  output->is_replaced = 1;
  for (int i = 0; i < 3; ++i) output->velocity[i] = velocity ? velocity[i] : 0.0F;
}

static void set_through(alula_crazyflie_output* output, alula_crazyflie_status status) {
  set_velocity(output, status, 0);
  output->is_replaced = 0;
  output->is_off = status == ALULA_CRAZYFLIE_NOT_READY;
}

int alula_crazyflie_open(alula_crazyflie_filter* filter, const uint8_t* image, uint32_t length,
                         const alula_crazyflie_config* config) {
  filter->is_open = 0;
  filter->turn = ALULA_CRAZYFLIE_FREE;
  filter->has_request = 0;
  filter->is_taking_off = 1;
  filter->still = 0;
  filter->still_way = 0.0F;
  filter->late = filter->corrections = 0U;
  filter->margin_m = 0.0F;
#if ALULA_CRAZYFLIE_OBSTACLES > 0U
  filter->track_count = 0U;
#endif
  for (int i = 0; i < 6; ++i) filter->seen[i] = 0.0F;
  set_through(&filter->output, ALULA_CRAZYFLIE_NOT_READY);
  if (alula_map_open(&filter->map, image, length) != ALULA_MAP_READY) return 0;
  filter->is_open = alula_crazyflie_configure(filter, config);
  filter->period_s = config->period_s;
  return filter->is_open;
}

/* cos and sin of yaw: the direction of the body's x axis, seen from above. */
static int heading(const float q[4], float* cosine, float* sine) {
  const float x = 1.0F - 2.0F * (q[2] * q[2] + q[3] * q[3]), y = 2.0F * (q[1] * q[2] + q[0] * q[3]);
  const float square = x * x + y * y;
  if (!(square > FLAT && square < 2.0F)) return 0; /* also NaN */
  const float inverse = 1.0F / __builtin_sqrtf(square);
  *cosine = x * inverse;
  *sine = y * inverse;
  return 1;
}

/* Checks the current state; returns the reason why it cannot be used. */
static alula_crazyflie_status judge(alula_crazyflie_filter* filter, const alula_crazyflie_state* state,
                                    float step_s) {
  const float* u = filter->output.velocity;
  int is_same = 1;
  for (int i = 0; i < 3; ++i) {
    if (state->position[i] != filter->seen[i] || state->velocity[i] != filter->seen[3 + i]) is_same = 0;
    filter->seen[i] = state->position[i];
    filter->seen[3 + i] = state->velocity[i];
  }
  /* A working estimator changes with every measurement; the state of a commanded vehicle changes in any case. */
  if (!is_same) {
    filter->still = 0;
    filter->still_way = 0.0F;
  } else if (filter->still < ALULA_CRAZYFLIE_STALE_STEPS || filter->still_way < ALULA_CRAZYFLIE_STALE_WAY) {
    if (filter->still < ALULA_CRAZYFLIE_STALE_STEPS) ++filter->still;
    filter->still_way += __builtin_sqrtf(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]) * step_s;
  }
  if (!all_finite(state->position, 3) || !all_finite(state->velocity, 3)) return ALULA_CRAZYFLIE_BAD_STATE;
  for (int i = 0; i < 3; ++i) {
    const float x = state->position[i];
    if (x < -ALULA_CRAZYFLIE_EXTENT || x > ALULA_CRAZYFLIE_EXTENT) return ALULA_CRAZYFLIE_BAD_STATE;
  }
  if (!(state->variance > 0.0F && state->variance <= filter->config.variance)) return ALULA_CRAZYFLIE_UNCERTAIN;
  if (filter->still >= ALULA_CRAZYFLIE_STALE_STEPS && filter->still_way >= ALULA_CRAZYFLIE_STALE_WAY) {
    return ALULA_CRAZYFLIE_STALE;
  }
  return ALULA_CRAZYFLIE_OK;
}

/* Computes the nominal velocity, in the world frame. */
static alula_crazyflie_status read_request(const alula_crazyflie_config* config,
                                           const alula_crazyflie_request* request, const alula_crazyflie_state* state,
                                           float v[3]) {
  float given[3] = {request->velocity[0], request->velocity[1], request->velocity[2]};
  const int has_velocity = request->mode[0] == ALULA_AXIS_VELOCITY || request->mode[1] == ALULA_AXIS_VELOCITY;
  if (request->is_body && has_velocity) {
    float cosine, sine;
    if (!heading(state->attitude, &cosine, &sine)) return ALULA_CRAZYFLIE_BAD_STATE;
    /* an axis in another mode adds nothing to the other axis, as in the firmware's own controller */
    const float x = request->mode[0] == ALULA_AXIS_VELOCITY ? given[0] : 0.0F;
    const float y = request->mode[1] == ALULA_AXIS_VELOCITY ? given[1] : 0.0F;
    given[0] = cosine * x - sine * y;
    given[1] = sine * x + cosine * y;
  }
  float square = 0.0F;
  int has_position = 0;
  for (int i = 0; i < 3; ++i) {
    v[i] = given[i];
    if (request->mode[i] == ALULA_AXIS_POSITION) {
      v[i] = config->gain * (request->position[i] - state->position[i]);
      has_position = 1;
    }
    if (!(v[i] >= -LARGEST_WISH && v[i] <= LARGEST_WISH)) return ALULA_CRAZYFLIE_BAD_WISH; /* also NaN */
    square += v[i] * v[i];
  }
  if (has_position && square > config->v_max * config->v_max) {
    const float scale = config->v_max / __builtin_sqrtf(square);
    for (int i = 0; i < 3; ++i) v[i] *= scale;
  }
  return ALULA_CRAZYFLIE_OK;
}

/* Takes the result of the request from the start of the last period. */
static void collect(alula_crazyflie_filter* filter) {
  static const alula_crazyflie_status MEANING[] = {ALULA_CRAZYFLIE_OK, ALULA_CRAZYFLIE_FILTERED,
                                                   ALULA_CRAZYFLIE_SHORTENED, ALULA_CRAZYFLIE_RECOVERING,
                                                   ALULA_CRAZYFLIE_REFUSED};
  const int had_request = filter->has_request;
  filter->has_request = 0;
  if (__atomic_load_n(&filter->turn, __ATOMIC_ACQUIRE) != ALULA_CRAZYFLIE_DONE) {
    if (had_request) ++filter->late;
    set_velocity(&filter->output, had_request ? ALULA_CRAZYFLIE_LATE : ALULA_CRAZYFLIE_STARTING, 0);
    return;
  }
  filter->margin_m = filter->result.margin_m;
  if (filter->margin_m >= 0.0F) filter->is_taking_off = 0;
  const int is_known = (uint32_t)filter->answer <= ALULA_FILTER_REFUSED;
  const alula_crazyflie_status status = is_known ? MEANING[filter->answer] : ALULA_CRAZYFLIE_REFUSED;
  if (!had_request) { /* from before an interruption: for another position */
    set_velocity(&filter->output, ALULA_CRAZYFLIE_STARTING, 0);
  } else if (status == ALULA_CRAZYFLIE_REFUSED || !all_finite(filter->result.u, 3)) {
    set_velocity(&filter->output, ALULA_CRAZYFLIE_REFUSED, 0);
  } else {
    set_velocity(&filter->output, status, filter->result.u);
  }
  if (status != ALULA_CRAZYFLIE_OK) ++filter->corrections;
  __atomic_store_n(&filter->turn, ALULA_CRAZYFLIE_FREE, __ATOMIC_RELEASE);
}

/* Discards the request: flies the set-point itself, or zero velocity. */
static void interrupt(alula_crazyflie_filter* filter, alula_crazyflie_status status, int is_through) {
  filter->has_request = 0;
  if (is_through) {
    set_through(&filter->output, status);
  } else {
    set_velocity(&filter->output, status, 0);
  }
}

/* The state of the request: that of a vehicle with this lag at the end of the period. */
static void predict(alula_crazyflie_filter* filter, const alula_crazyflie_state* state, float period_s) {
  const float lag = filter->config.lag, left = lag > 0.0F ? alula_expf(-period_s / lag) : 0.0F;
  for (int i = 0; i < 3; ++i) {
    const float u = filter->output.velocity[i], off = state->velocity[i] - u;
    filter->at[i] = state->position[i] + period_s * u + lag * (1.0F - left) * off;
    filter->moving[i] = u + left * off;
  }
  filter->from_the_ground = filter->is_taking_off;
}

void alula_crazyflie_restart(alula_crazyflie_filter* filter) { interrupt(filter, ALULA_CRAZYFLIE_STARTING, 0); }

void alula_crazyflie_step(alula_crazyflie_filter* filter, const alula_crazyflie_request* request,
                          const alula_crazyflie_state* state, int is_due, float step_s,
                          alula_crazyflie_output* output) {
  const alula_crazyflie_config* config = &filter->config;
  int axes_off = 0;
  for (int i = 0; i < 3; ++i) {
    if (request->mode[i] != ALULA_AXIS_POSITION && request->mode[i] != ALULA_AXIS_VELOCITY) ++axes_off;
  }
  const alula_crazyflie_status now = judge(filter, state, step_s);
  const float period_s = config->period_s;
  const int is_as_long = period_s == filter->period_s; /* otherwise command and request are for another period */
  filter->period_s = period_s;
  if (!filter->is_open) {
    interrupt(filter, ALULA_CRAZYFLIE_NOT_READY, 1);
  } else if (axes_off == 3 && request->thrust == 0.0F) {
    interrupt(filter, ALULA_CRAZYFLIE_OFF, 1);
    filter->is_taking_off = 1;
  } else if (!config->enabled) {
    interrupt(filter, ALULA_CRAZYFLIE_DISABLED, 1);
  } else if (axes_off > 0) {
    interrupt(filter, config->attitude ? ALULA_CRAZYFLIE_UNGUARDED : ALULA_CRAZYFLIE_BAD_WISH, config->attitude);
  } else if (now != ALULA_CRAZYFLIE_OK) {
    interrupt(filter, now, 0);
  } else if (!is_as_long) {
    interrupt(filter, ALULA_CRAZYFLIE_STARTING, 0);
  } else if (is_due) {
    float v[3];
    collect(filter);
    const alula_crazyflie_status read = read_request(config, request, state, v);
    if (read != ALULA_CRAZYFLIE_OK) {
      interrupt(filter, read, 0);
    } else if (__atomic_load_n(&filter->turn, __ATOMIC_ACQUIRE) == ALULA_CRAZYFLIE_FREE) {
      predict(filter, state, period_s);
      for (int i = 0; i < 3; ++i) filter->nominal[i] = v[i];
      filter->has_request = 1;
      __atomic_store_n(&filter->turn, ALULA_CRAZYFLIE_POSTED, __ATOMIC_RELEASE);
    }
  } else if (!filter->output.is_replaced) { /* guarded from now on, but no period has begun */
    interrupt(filter, ALULA_CRAZYFLIE_STARTING, 0);
  }
  *output = filter->output;
}

#if ALULA_CRAZYFLIE_OBSTACLES > 0U
int alula_crazyflie_report(alula_crazyflie_filter* filter, const alula_crazyflie_obstacle* obstacle) {
  static const float POSITION = 2.5e-3F, VELOCITY = 0.04F; /* variances: 0.05 m, 0.2 m/s */
  static const uint32_t DIAGONAL[6] = {0U, 2U, 5U, 9U, 14U, 20U};
  if (obstacle->id == 0U || !(obstacle->radius_m >= 0.0F && obstacle->radius_m <= 10.0F)) return 0;
  for (int i = 0; i < 3; ++i) {
    const float x = obstacle->position[i], v = obstacle->velocity[i];
    if (!(x >= -LARGEST_FAR && x <= LARGEST_FAR && v >= -LARGEST_FAR && v <= LARGEST_FAR)) return 0; /* also NaN */
  }
  uint32_t at = 0U;
  while (at < filter->track_count && filter->track[at].id != obstacle->id) ++at;
  if (at == ALULA_CRAZYFLIE_OBSTACLES) return 0;
  if (at == filter->track_count) ++filter->track_count;
  static const alula_track NONE;
  alula_track* track = filter->track + at;
  *track = NONE;
  track->id = obstacle->id;
  track->radius_m = obstacle->radius_m;
  for (int i = 0; i < 3; ++i) {
    track->position[i] = obstacle->position[i];
    track->velocity[i] = obstacle->velocity[i];
  }
  for (int i = 0; i < 6; ++i) track->covariance[DIAGONAL[i]] = i < 3 ? POSITION : VELOCITY;
  filter->age_s[at] = 0.0F;
  return 1;
}

/* Obstacles fly straight on for a period; those without a report for long are forgotten. */
static void move_obstacles(alula_crazyflie_filter* filter) {
  const float period_s = filter->config.period_s;
  uint32_t left = 0U;
  for (uint32_t k = 0; k < filter->track_count; ++k) {
    const float age_s = filter->age_s[k] + period_s;
    if (age_s > ALULA_CRAZYFLIE_FORGOTTEN_S) continue;
    alula_track* track = filter->track + left;
    *track = filter->track[k];
    for (int i = 0; i < 3; ++i) track->position[i] += period_s * track->velocity[i];
    filter->age_s[left++] = age_s;
  }
  filter->track_count = left;
}

static alula_filter_status answer(alula_crazyflie_filter* filter) {
  alula_stack_input in;
  alula_stack_result result;
  move_obstacles(filter); /* to the time at which the velocity begins */
  for (int i = 0; i < 3; ++i) {
    in.position[i] = filter->at[i];
    in.velocity[i] = filter->moving[i];
    in.nominal[i] = filter->nominal[i];
  }
  for (int i = 0; i < 6; ++i) in.covariance[i] = 0.0F; /* radius has the errors of position */
  in.track = filter->track;
  in.track_count = filter->track_count;
  in.is_taking_off = filter->from_the_ground;
  const alula_filter_status status = alula_stack_filter(&filter->stack, &in, &result);
  filter->result = result.chord;
  return status;
}
#else
static alula_filter_status answer(alula_crazyflie_filter* filter) {
  return alula_chord_filter(&filter->chord, filter->at, filter->moving, filter->nominal, filter->from_the_ground,
                            &filter->result);
}
#endif

int alula_crazyflie_work(alula_crazyflie_filter* filter) {
  if (__atomic_load_n(&filter->turn, __ATOMIC_ACQUIRE) != ALULA_CRAZYFLIE_POSTED) return 0;
  filter->answer = answer(filter);
  __atomic_store_n(&filter->turn, ALULA_CRAZYFLIE_DONE, __ATOMIC_RELEASE);
  return 1;
}
