#include "alula_geofence.h"

#include "racer_steps.h"

#define UNIT 5.9604645e-8F  /* 2^-24 */
#define INVERTED_MORE 4.0F  /* multiple of the difference that is added for a flow that was upside down, */
#define INVERTED_FROM 0.25F /* in full from this far below the horizon */
#define SOFT 16.0F          /* beta h_B; below 25 log 2, where lambda rounds to 1 */
#define MOST_TICK 0.1F
#define MOST_RATE_GAIN 1000.0F
#define MOST_GAIN 1000.0F

alula_geofence_config alula_geofence_defaults(void) {
  const alula_geofence_config config = ALULA_GEOFENCE_DEFAULTS;
  return config;
}

static int is_in(float x, float low, float high) { return x >= low && x <= high; } /* false for NaN */

static int model_is_valid(const alula_racer_model* model) {
  if (!is_in(model->gravity, 0.1F, 100.0F) || !is_in(model->rate_gain, 1.0F, MOST_RATE_GAIN)) return 0;
  if (!is_in(model->thrust[0], -1.0F, 1.0F)) return 0;
  if (!is_in(model->thrust[1], 0.0F, MOST_GAIN) || !is_in(model->thrust[2], 0.0F, MOST_GAIN)) return 0;
  for (int i = 0; i < 3; ++i) {
    if (!is_in(model->max_rate[i], 0.1F, 40.0F)) return 0;
  }
  return alula_racer_thrust(model, 1.0F) > 1.05F * model->gravity;
}

static int config_is_valid(const alula_geofence_config* config) {
  const alula_backup_gains* backup = &config->backup;
  return model_is_valid(&config->model) && is_in(backup->tilt_gain, 0.0F, 10.0F) &&
         is_in(backup->max_tilt, 0.01F, 1.57F) && is_in(backup->attitude_gain, 0.01F, MOST_GAIN) &&
         is_in(backup->height_gain, 0.0F, 10.0F) && is_in(backup->climb_gain, 0.0F, 10.0F) &&
         is_in(backup->most_throttle, 0.0F, 1.0F) && is_in(config->push_distance_m, 0.0F, 100.0F) &&
         is_in(config->push_gain, 0.0F, 10.0F) && is_in(config->push_speed_m_s, 0.0F, 10.0F) && config->steps >= 2U &&
         config->steps <= ALULA_GEOFENCE_STEPS && config->steps % 2U == 0U && is_in(config->step_s, 1.0e-4F, 0.1F) &&
         is_in(config->tick_s, 1.0e-4F, MOST_TICK) && is_in(config->beta, 1.0e-3F, MOST_GAIN) &&
         is_in(config->slow_m_s, 1.0e-2F, 100.0F) && is_in(config->fast_m_s, config->slow_m_s, 100.0F) &&
         is_in(config->end_speed_m_s, 0.0F, 10.0F) && is_in(config->end_gain, 0.1F, MOST_GAIN) &&
         is_in(config->radius_m, 0.0F, 100.0F) && is_in(config->reserve_m, 0.0F, 100.0F) &&
         is_in(config->latency_s, 0.0F, 1.0F) && is_in(config->stale_limit_s, 0.0F, 10.0F) &&
         is_in(config->stale_speed_m_s, 0.0F, 100.0F) && is_in(config->stale_acceleration_m_s2, 0.0F, 100.0F) &&
         is_in(config->descent, 0.0F, 1.0F);
}

static float extent_of(const alula_fence* fence) {
  float largest = fence->keep_out ? fence->keep_out->extent_m : 1.0F;
  for (int i = 0; fence->has_box && i < 3; ++i) {
    if (absolute(fence->lower[i]) > largest) largest = absolute(fence->lower[i]);
    if (absolute(fence->upper[i]) > largest) largest = absolute(fence->upper[i]);
  }
  for (uint32_t l = 0; l < fence->face_count; ++l) {
    if (absolute(fence->face[l][3]) > largest) largest = absolute(fence->face[l][3]);
  }
  return largest;
}

alula_status alula_geofence_init(alula_geofence* filter, const alula_fence* fence,
                                 const alula_geofence_config* config) {
  alula_geofence_conditions conditions;
  if (!filter || !fence || !config) return ALULA_BAD_POINTER;
  filter->fence = 0;
  alula_status status = alula_fence_check(fence);
  if (status != ALULA_READY) return status;
  const float ticks = config->latency_s / config->tick_s + 0.5F;
  status = alula_geofence_examine(config, &conditions);
  if (status != ALULA_READY) return status;
  if (!(ticks < (float)ALULA_GEOFENCE_LATENCY + 1.0F)) return ALULA_BAD_PARAMETER;
  filter->latency = (uint32_t)ticks;
  filter->config = *config;
  filter->fence = fence;
  filter->extent = extent_of(fence);
  filter->hover = alula_racer_hover_throttle(&config->model);
  filter->fine = alula_racer_step_of(&config->model, config->step_s);
  filter->coarse = alula_racer_step_of(&config->model, 2.0F * config->step_s);
  filter->tick = alula_racer_step_of(&config->model, config->tick_s);
  alula_map_near_open(&filter->near, fence->keep_out);
  alula_geofence_reset(filter);
  return ALULA_READY;
}

void alula_geofence_move(alula_geofence* filter) {
  if (filter && filter->fence) alula_map_near_open(&filter->near, filter->fence->keep_out);
}

void alula_geofence_reset(alula_geofence* filter) {
  if (!filter) return;
  filter->has_state = filter->has_hold = filter->silent = 0;
  filter->stale = 0U;
  filter->newest = 0U;
  for (uint32_t k = 0; k <= ALULA_GEOFENCE_LATENCY; ++k) {
    filter->sent[k].throttle = filter->hover;
    for (int i = 0; i < 3; ++i) filter->sent[k].rates[i] = 0.0F;
  }
}

static void begin(alula_geofence* filter, const float origin[3], alula_fence_tracker* tracker) {
  const alula_geofence_config* config = &filter->config;
  alula_fence_begin(tracker, filter->fence, &filter->near, origin, config->radius_m + config->reserve_m,
                    config->push_distance_m, config->push_gain, config->push_speed_m_s);
}

/* A flow and the command of its last node, from which the next step extrapolates. */
typedef struct {
  alula_racer_state state; /* position relative to the tracker's origin, as is the hold */
  alula_racer_command last;
  float axis[3];
  float thrust, zeta; /* of the last step, at its beginning */
} course;

static inline void advance(const alula_geofence* filter, const alula_racer_step_size* step,
                           const alula_backup_hold* hold, alula_fence_tracker* tracker, int is_first, float v_d[3],
                           course* flow) {
  alula_racer_command now, middle;
  alula_fence_push(tracker, flow->state.position, v_d);
  flow->zeta = flow->axis[2];
  backup_command(&filter->config.model, &filter->config.backup, hold, filter->hover, &flow->state, flow->zeta, v_d,
                 &now);
  middle = now;
  if (!is_first) {
    middle.throttle = 1.5F * now.throttle - 0.5F * flow->last.throttle;
    ALULA_UNROLL
    for (int i = 0; i < 3; ++i) middle.rates[i] = 1.5F * now.rates[i] - 0.5F * flow->last.rates[i];
    limit_command(&filter->config.model, &middle);
  }
  flow->last = now;
  flow->thrust = step_racer(&filter->config.model, step, &middle, flow->axis, &flow->state);
}

static float distance_between(const float a[3], const float b[3]) {
  const float way[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
  return norm(way);
}

/* v_c of a constraint at the beginning. */
static float speed_towards(const alula_geofence* filter, const alula_fence_tracker* tracker, uint32_t c,
                           const float v[3]) {
  float speed;
  if (c < 3U) {
    speed = -v[c];
  } else if (c < ALULA_FENCE_BOX_FACES) {
    speed = v[c - 3U];
  } else if (c < ALULA_FENCE_MAP) {
    speed = dot(filter->fence->face[c - ALULA_FENCE_BOX_FACES], v);
  } else {
    speed = -dot(tracker->map_normal, v);
  }
  const float slow = filter->config.slow_m_s, fast = filter->config.fast_m_s;
  return speed > fast ? fast : (speed > slow ? speed : slow);
}

/* The value that replaces h_B in the regulation function lambda: never above h_B, and quadratic where h_B is small.
 * With its gain of 40 a tick can change h_B by 1; lambda = 1 - exp(-beta h_B) would then alternate between pilot and
 * backup in every tick. */
static float softened(float end, float beta) {
  const float z = beta * end;
  return z > 0.0F && z < SOFT ? end * (z / SOFT) : end;
}

/* Computes h_I, and the constraint that decides lambda. */
static void conclude(const alula_geofence* filter, const alula_fence_tracker* tracker, const float v[3],
                     alula_geofence_value* value) {
  const alula_fence* fence = filter->fence;
  value->h_i = value->end;
  value->exponent = softened(value->end, filter->config.beta);
  value->deciding = ALULA_GEOFENCE_END;
  value->v_towards = 1.0F;
  for (uint32_t c = 0; c < ALULA_FENCE_CONSTRAINTS; ++c) {
    if (c < ALULA_FENCE_BOX_FACES && !fence->has_box) continue;
    if (c >= ALULA_FENCE_BOX_FACES + fence->face_count && c < ALULA_FENCE_MAP) continue;
    if (c == ALULA_FENCE_MAP && !fence->keep_out) continue;
    const float h = tracker->least[c];
    const float speed = speed_towards(filter, tracker, c, v);
    if (!(h >= value->h_i)) value->h_i = h;
    if (h / speed < value->exponent) {
      value->exponent = h / speed;
      value->deciding = c;
      value->v_towards = speed;
    }
  }
  /* a flow that becomes NaN stays NaN to its end, but not every minimum shows it */
  if (tracker->damaged || !alula_is_finite(value->h_i) || !alula_is_finite(value->end)) value->h_i = -FLT_MAX;
}

void alula_geofence_evaluate(alula_geofence* filter, const alula_racer_state* state, const alula_backup_hold* hold,
                             float extra, alula_geofence_value* value) {
  const alula_geofence_config* config = &filter->config;
  alula_fence_tracker tracker;
  begin(filter, state->position, &tracker);
  value->distance_m = FLT_MAX;
  for (uint32_t c = 0; c < ALULA_FENCE_BOX_FACES + filter->fence->face_count; ++c) {
    if (tracker.least[c] < value->distance_m) value->distance_m = tracker.least[c];
  }
  if (tracker.least[ALULA_FENCE_MAP] < value->distance_m) value->distance_m = tracker.least[ALULA_FENCE_MAP];

  float largest = filter->extent;
  for (int i = 0; i < 3; ++i) {
    if (absolute(state->position[i]) > largest) largest = absolute(state->position[i]);
  }
  const float speed = norm(state->velocity);
  const float rounding = (float)(2U * config->steps + 64U) * UNIT * (largest + 3.0F * speed);
  const float fixed = rounding + extra + speed * config->tick_s;
  const float chord = 0.125F * config->step_s * config->step_s;
  for (uint32_t c = 0; c < ALULA_FENCE_CONSTRAINTS; ++c) tracker.least[c] -= fixed;

  alula_backup_hold relative = *hold;
  relative.height -= state->position[2];
  course fine, coarse;
  fine.state = *state;
  fine.state.position[0] = fine.state.position[1] = fine.state.position[2] = 0.0F;
  coarse.state = fine.state;
  axis_of(fine.state.attitude, fine.axis);
  axis_of(coarse.state.attitude, coarse.axis);
  float error = 0.0F, allowance = 0.0F;
  float inverted = 0.0F; /* 0 above the horizon to 1 */
  for (uint32_t k = 0; k < config->steps; k += 2U) {
    float node[3][3], v_d[3], sag = 0.0F;
    for (int j = 0; j < 2; ++j) {
      ALULA_UNROLL
      for (int i = 0; i < 3; ++i) node[j][i] = fine.state.position[i];
      advance(filter, &filter->fine, &relative, &tracker, k == 0U && j == 0, v_d, &fine);
      if (k == 0U && j == 0) {
        value->first = fine.last;
        for (int i = 0; i < 3; ++i) value->push[i] = v_d[i];
      }
      const float bow = (fine.thrust + config->model.gravity) * chord;
      if (bow > sag) sag = bow;
    }
    ALULA_UNROLL
    for (int i = 0; i < 3; ++i) node[2][i] = fine.state.position[i];
    advance(filter, &filter->coarse, &relative, &tracker, k == 0U, v_d, &coarse);
    const float now = distance_between(fine.state.position, coarse.state.position) +
                      2.0F * config->step_s * distance_between(fine.state.velocity, coarse.state.velocity);
    const float lowest = fine.zeta < coarse.zeta ? fine.zeta : coarse.zeta;
    const float below = between(-lowest * (1.0F / INVERTED_FROM), 0.0F, 1.0F);
    if (below > inverted) inverted = below;
    const float size = now * (1.0F + INVERTED_MORE * inverted);
    if (size > error) error = size; /* the two flows may cross */
    allowance = fixed + sag + error;
    alula_fence_follow(&tracker, node[0], node[1], allowance);
    alula_fence_follow(&tracker, node[1], node[2], allowance);
  }
  value->margin_m = allowance;
  value->end = config->end_gain * (config->end_speed_m_s - norm(fine.state.velocity) -
                                   distance_between(fine.state.velocity, coarse.state.velocity));
  conclude(filter, &tracker, state->velocity, value);
}

alula_backup_hold alula_geofence_hold(alula_geofence* filter, const alula_racer_state* state) {
  static const float HERE[3] = {0.0F, 0.0F, 0.0F};
  alula_fence_tracker tracker;
  float v_d[3];
  begin(filter, state->position, &tracker);
  alula_fence_push(&tracker, HERE, v_d);
  return alula_backup_hold_at(state, v_d[2]);
}

static void send(alula_geofence* filter, const alula_racer_command* command, alula_geofence_result* result) {
  filter->newest = filter->newest == ALULA_GEOFENCE_LATENCY ? 0U : filter->newest + 1U;
  filter->sent[filter->newest] = *command;
  result->command = *command;
}

/* The command sent `ago` ticks before the newest. */
static const alula_racer_command* sent_ago(const alula_geofence* filter, uint32_t ago) {
  const uint32_t size = ALULA_GEOFENCE_LATENCY + 1U;
  return &filter->sent[(filter->newest + size - ago) % size];
}

/* Updates the state: measured, or predicted from the last one by a tick with the command that acted in it. */
static void update_state(alula_geofence* filter, const alula_racer_state* navigation) {
  if (navigation && alula_racer_state_is_valid(navigation)) {
    filter->state = *navigation;
    alula_racer_normalise(&filter->state);
    filter->has_state = 1;
    filter->stale = 0U;
    return;
  }
  if (!filter->has_state) return;
  if (filter->stale < UINT32_MAX) ++filter->stale;
  (void)alula_racer_step(&filter->config.model, &filter->tick, sent_ago(filter, filter->latency), &filter->state);
  if (!alula_racer_state_is_valid(&filter->state)) filter->has_state = 0;
}

/* Level at the current yaw, and sinking. */
static void hand_over(alula_geofence* filter, alula_geofence_result* result) {
  alula_racer_command command;
  alula_racer_state level = filter->state;
  for (int i = 0; i < 3; ++i) level.velocity[i] = 0.0F;
  const alula_backup_hold hold = alula_backup_hold_at(&level, 0.0F);
  alula_backup_command(&filter->config.model, &filter->config.backup, &hold, filter->hover, &level, level.velocity,
                       &command);
  command.throttle = filter->config.descent * filter->hover;
  send(filter, &command, result);
}

static alula_geofence_status blend(alula_geofence* filter, const alula_racer_command* pilot,
                                   const alula_geofence_value* value, alula_geofence_result* result) {
  alula_racer_command desired = *pilot, command = value->first;
  alula_racer_limit(&filter->config.model, &desired);
  const int was_cut = desired.throttle != pilot->throttle || desired.rates[0] != pilot->rates[0] ||
                      desired.rates[1] != pilot->rates[1] || desired.rates[2] != pilot->rates[2];
  const float lambda = value->h_i > 0.0F ? 1.0F - alula_expf(-filter->config.beta * value->exponent) : 0.0F;
  result->lambda = lambda;
  if (lambda == 1.0F) {
    send(filter, was_cut ? &desired : pilot, result);
    return was_cut ? ALULA_GEOFENCE_BLENDED : ALULA_GEOFENCE_PASSED;
  }
  if (lambda > 0.0F) {
    command.throttle = lambda * desired.throttle + (1.0F - lambda) * command.throttle;
    for (int i = 0; i < 3; ++i) {
      command.rates[i] = lambda * desired.rates[i] + (1.0F - lambda) * command.rates[i];
    }
    alula_racer_limit(&filter->config.model, &command); /* rounding may exceed the limits */
  }
  send(filter, &command, result);
  return lambda > 0.0F ? ALULA_GEOFENCE_BLENDED : ALULA_GEOFENCE_BACKUP;
}

static alula_geofence_status refuse(alula_geofence_result* result) {
  result->command.throttle = 0.0F;
  for (int i = 0; i < 3; ++i) result->command.rates[i] = 0.0F;
  return ALULA_GEOFENCE_REFUSED;
}

alula_geofence_status alula_geofence_filter(alula_geofence* filter, const alula_racer_state* navigation,
                                            const alula_racer_command* pilot, alula_geofence_result* result) {
  if (!result) return ALULA_GEOFENCE_REFUSED;
  result->lambda = result->stale_s = result->margin_m = result->v_towards = 0.0F;
  result->h_i = result->distance_m = -FLT_MAX;
  result->deciding = ALULA_GEOFENCE_NONE;
  if (!filter || !filter->fence) return refuse(result);
  const alula_geofence_config* config = &filter->config;
  update_state(filter, navigation);
  if (!filter->has_state) return refuse(result);
  const float age = (float)filter->stale * config->tick_s;
  result->stale_s = age;
  if (age > config->stale_limit_s) {
    filter->has_hold = 0;
    hand_over(filter, result);
    return ALULA_GEOFENCE_HAND_OVER;
  }

  alula_racer_state ahead = filter->state;
  for (uint32_t k = filter->latency; k > 0U; --k) {
    (void)alula_racer_step(&config->model, &filter->tick, sent_ago(filter, k - 1U), &ahead);
  }
  const float off = age * (config->stale_speed_m_s + 0.5F * age * config->stale_acceleration_m_s2);
  const int has_pilot = pilot && alula_racer_command_is_finite(pilot);
  const int keeps = filter->silent && !has_pilot && filter->has_hold;
  const alula_backup_hold hold = keeps ? filter->hold : alula_geofence_hold(filter, &ahead);
  alula_geofence_value value;
  alula_geofence_evaluate(filter, &ahead, &hold, off, &value);
  if (value.h_i > 0.0F || !filter->has_hold) {
    filter->hold = hold;
    filter->has_hold = 1;
  } else if (!keeps) { /* continue the flow that was found safe */
    alula_backup_command(&config->model, &config->backup, &filter->hold, filter->hover, &ahead, value.push,
                         &value.first);
  }
  filter->silent = !has_pilot;
  result->h_i = value.h_i;
  result->distance_m = value.distance_m;
  result->margin_m = value.margin_m;
  result->deciding = value.deciding;
  result->v_towards = value.v_towards;
  if (!has_pilot) {
    send(filter, &value.first, result);
    return ALULA_GEOFENCE_NO_PILOT;
  }
  return blend(filter, pilot, &value, result);
}

/* The conditions of the guarantee. */

#define UPRIGHT 0.8F     /* zeta in the last quarter of the horizon, after a start upside down */
#define RESTING 0.5F     /* fraction of the starting speed that may be left in the last quarter of the horizon */
#define LEAST_START 1.0F /* [m/s] */
#define SPEEDS 6U        /* slow_m_s, fast_m_s, and multiples of it up to */
#define FASTEST_TRIED 160.0F

typedef struct {
  const alula_geofence_config* config;
  float hover;
  alula_racer_step_size fine, tick;
} free_model;

/* A flow in free space: how far it gets towards `way`, and its speeds. */
typedef struct {
  float reach, end_m_s, late_m_s, late_zeta; /* late: maximum and minimum over the last quarter */
} free_flow;

static free_flow flow_freely(const free_model* free, const alula_racer_state* start, const float way[3]) {
  static const float STILL[3] = {0.0F, 0.0F, 0.0F};
  const alula_geofence_config* config = free->config;
  const alula_backup_hold hold = alula_backup_hold_at(start, 0.0F);
  alula_racer_state x = *start;
  float axis[3];
  free_flow flow = {dot(way, x.position), 0.0F, 0.0F, 1.0F};
  axis_of(x.attitude, axis);
  for (uint32_t k = 0; k < config->steps; ++k) {
    alula_racer_command u;
    backup_command(&config->model, &config->backup, &hold, free->hover, &x, axis[2], STILL, &u);
    (void)step_racer(&config->model, &free->fine, &u, axis, &x);
    const float at = dot(way, x.position);
    flow.end_m_s = norm(x.velocity);
    if (!(at <= flow.reach)) flow.reach = at;
    if (4U * k < 3U * config->steps) continue;
    if (!(flow.end_m_s <= flow.late_m_s)) flow.late_m_s = flow.end_m_s;
    if (!(axis[2] >= flow.late_zeta)) flow.late_zeta = axis[2];
  }
  return flow;
}

static alula_racer_state state_of(float w, float y, float speed, const float way[3]) {
  alula_racer_state x;
  for (int i = 0; i < 3; ++i) {
    x.position[i] = x.rates[i] = 0.0F;
    x.velocity[i] = speed * way[i];
    x.attitude[1 + i] = 0.0F;
  }
  x.attitude[0] = w;
  x.attitude[2] = y;
  return x;
}

static const float WAYS[3][3] = {{1.0F, 0.0F, 0.0F}, {0.0F, 0.0F, 1.0F}, {0.0F, 0.0F, -1.0F}};

/* The speed that is left late in the horizon, from the end speed in each direction; and whether a vehicle that was
 * upside down is upright by then, at rest and spinning. */
static void examine_rest(const free_model* free, alula_geofence_conditions* found) {
  const alula_geofence_config* config = free->config;
  const float start = config->end_speed_m_s > LEAST_START ? config->end_speed_m_s : LEAST_START;
  for (int i = 0; i < 3; ++i) {
    const alula_racer_state x = state_of(1.0F, 0.0F, start, WAYS[i]);
    const float left = flow_freely(free, &x, WAYS[0]).late_m_s;
    if (!(left <= found->rest_m_s)) found->rest_m_s = left;
  }
  for (int i = 0; i < 2; ++i) {
    alula_racer_state x = state_of(0.0F, 1.0F, 0.0F, WAYS[0]);
    for (int j = 0; i == 1 && j < 3; ++j) x.rates[j] = config->model.max_rate[j];
    const float zeta = flow_freely(free, &x, WAYS[0]).late_zeta;
    if (!(zeta >= found->upright)) found->upright = zeta;
  }
  found->most_rest_m_s = RESTING * start;
  found->least_upright = UPRIGHT;
}

/* The largest D / v_c, at several speeds from which the horizon suffices, towards each direction, by the pilot's
 * commands at the corners of throttle and pitch; horizontally also tilted as far as u_B does, forward and back. */
static void examine_loss(const free_model* free, alula_geofence_conditions* found) {
  const alula_geofence_config* config = free->config;
  const float pitch = config->model.max_rate[1], half = 0.5F * config->backup.max_tilt;
  const float c = cosine_of_square(half * half), s = half * sinc_of_square(half * half);
  float speed = config->slow_m_s;
  found->lost_s = 0.0F;
  for (uint32_t k = 0; k < SPEEDS; ++k) {
    const float v_c = speed < config->fast_m_s ? speed : config->fast_m_s;
    for (int i = 0; i < 5; ++i) {
      const float* way = WAYS[i < 3 ? i : 0];
      const alula_racer_state x = i < 3 ? state_of(1.0F, 0.0F, speed, way) : state_of(c, i == 3 ? s : -s, speed, way);
      const free_flow before = flow_freely(free, &x, way);
      if (!(before.end_m_s < config->end_speed_m_s)) continue; /* h_I <= 0: the pilot has no part */
      for (int j = 0; j < 6; ++j) {
        alula_racer_state after = x;
        alula_racer_command u = {j < 3 ? 1.0F : 0.0F, {0.0F, 0.0F, 0.0F}};
        u.rates[1] = j % 3 == 0 ? 0.0F : (j % 3 == 1 ? pitch : -pitch);
        (void)alula_racer_step(&config->model, &free->tick, &u, &after);
        const float lost = (flow_freely(free, &after, way).reach - before.reach) / v_c;
        if (!(lost <= found->lost_s)) found->lost_s = lost;
      }
    }
    speed = k == 0U ? config->fast_m_s : 2.0F * speed;
    if (!(speed <= FASTEST_TRIED)) break;
  }
  found->most_beta = 1.0F / found->lost_s;
}

alula_status alula_geofence_examine(const alula_geofence_config* config, alula_geofence_conditions* conditions) {
  if (!config || !conditions) return ALULA_BAD_POINTER;
  conditions->rest_m_s = conditions->most_rest_m_s = conditions->lost_s = conditions->most_beta = 0.0F;
  conditions->upright = conditions->least_upright = 1.0F;
  if (!config_is_valid(config)) return ALULA_BAD_PARAMETER;
  free_model free;
  free.config = config;
  free.hover = alula_racer_hover_throttle(&config->model);
  free.fine = alula_racer_step_of(&config->model, config->step_s);
  free.tick = alula_racer_step_of(&config->model, config->tick_s);
  examine_rest(&free, conditions);
  examine_loss(&free, conditions);
  if (!(conditions->rest_m_s < conditions->most_rest_m_s)) return ALULA_NO_REST;
  if (!(conditions->upright > conditions->least_upright)) return ALULA_NO_REST;
  if (!(config->beta <= conditions->most_beta)) return ALULA_TOO_LATE;
  return ALULA_READY;
}
