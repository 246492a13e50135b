/* A recorded flight through the stack of all filters.
 *
 * inputs.bin: a `head`; an alula_geofence_config; uint32 has_box, float lower[3], upper[3], uint32 faces, float
 * faces[][4]; uint32 ticks; then per tick an `input`, its tracks and its walls.
 * outputs.bin: uint32 status of opening the map, status of the stack's set-up; then per tick a `tick`; then uint32
 * bytes of the stack. All numbers have 32 bits: enumerations have other sizes on the target than on a host.
 */
#include "alula.h"
#include "port.h"

typedef struct {
  uint32_t parts, takes, gives, most_walls;
  float velocity_gain, extent_m;
  float polytope_radius_m, beta, kappa, dt_s, speed_m_s;
  float radius_m, a_max, latency_s, clearance_m, wall_room_m, v_max; /* of dr-acbf */
} head;

typedef struct {
  uint32_t has_box;
  float lower[3], upper[3];
  uint32_t face_count;
} fence_head;

typedef struct {
  alula_racer_state state;
  float covariance[6];
  uint32_t kind;
  float nominal[3], yaw_rate_rad_s;
  alula_racer_command sticks;
  uint32_t tracks, walls;
} input;

typedef struct {
  uint32_t status, part[ALULA_STACK_PARTS];
  float velocity[3], acceleration[3];
  alula_racer_command sticks;
  uint32_t outcome, walls, walls_are_full, mode, rows;
  float margin_m, h_i, lambda;
  uint32_t counted;
} tick;

alula_map replayed_stack_map;
alula_fence replayed_stack_fence;
alula_stack replayed_stack;
static alula_track track[ALULA_OBSTACLES];
static alula_wall wall[ALULA_WALLS];

static int read_config(alula_stack_config* config) {
  head read;
  fence_head box;
  if (!port_read(&read, sizeof read) || !port_read(&config->geofence, sizeof config->geofence)) return 0;
  config->parts = read.parts;
  config->takes = (alula_stack_command)read.takes;
  config->gives = (alula_stack_command)read.gives;
  config->most_walls = read.most_walls;
  config->velocity_gain = read.velocity_gain;
  config->extent_m = read.extent_m;
  config->polytope_cbf.radius_m = read.polytope_radius_m;
  config->polytope_cbf.beta = read.beta;
  config->polytope_cbf.kappa = read.kappa;
  config->polytope_cbf.dt_s = read.dt_s;
  config->polytope_cbf.v_max = read.speed_m_s;
  config->dr_acbf.avoidance.dt_s = read.dt_s;
  config->dr_acbf.avoidance.radius_m = read.radius_m;
  config->dr_acbf.avoidance.a_max = read.a_max;
  config->dr_acbf.avoidance.latency_s = read.latency_s;
  config->dr_acbf.avoidance.clearance_m = read.clearance_m;
  config->dr_acbf.avoidance.wall_room_m = read.wall_room_m;
  config->dr_acbf.v_max = read.v_max;
  if (!port_read(&box, sizeof box) || box.face_count > ALULA_FENCE_FACES) return 0;
  replayed_stack_fence.has_box = (int)box.has_box;
  for (int i = 0; i < 3; ++i) {
    replayed_stack_fence.lower[i] = box.lower[i];
    replayed_stack_fence.upper[i] = box.upper[i];
  }
  replayed_stack_fence.face_count = box.face_count;
  return port_read(replayed_stack_fence.face, box.face_count * (uint32_t)sizeof replayed_stack_fence.face[0]);
}

static int read_input(alula_stack_input* to) {
  input in;
  if (!port_read(&in, sizeof in) || in.tracks > ALULA_OBSTACLES || in.walls > ALULA_WALLS) return 0;
  if (!port_read(track, in.tracks * (uint32_t)sizeof *track)) return 0;
  if (!port_read(wall, in.walls * (uint32_t)sizeof *wall)) return 0;
  to->state = in.state;
  for (int k = 0; k < 6; ++k) to->covariance[k] = in.covariance[k];
  to->track = track;
  to->track_count = in.tracks;
  to->wall = wall;
  to->wall_count = in.walls;
  to->kind = (alula_stack_command)in.kind;
  for (int k = 0; k < 3; ++k) to->nominal[k] = in.nominal[k];
  to->yaw_rate_rad_s = in.yaw_rate_rad_s;
  to->sticks = in.sticks;
  return 1;
}

static alula_stack_result result;

static int fly(uint32_t ticks) {
  for (uint32_t i = 0; i < ticks; ++i) {
    alula_stack_input in;
    tick out;
    if (!read_input(&in)) return 0;
    port_start();
    out.status = (uint32_t)alula_stack_filter(&replayed_stack, &in, &result);
    out.counted = port_stop();
    for (uint32_t k = 0; k < ALULA_STACK_PARTS; ++k) out.part[k] = (uint32_t)result.part[k];
    for (int k = 0; k < 3; ++k) {
      out.velocity[k] = result.velocity[k];
      out.acceleration[k] = result.acceleration[k];
    }
    out.sticks = result.sticks;
    out.outcome = (uint32_t)result.outcome;
    out.walls = result.walls;
    out.walls_are_full = (uint32_t)result.walls_are_full;
    out.mode = (uint32_t)result.dr_acbf.guidance.mode;
    out.rows = result.dr_acbf.rows;
    out.margin_m = result.polytope_cbf.margin_m;
    out.h_i = result.geofence.h_i;
    out.lambda = result.geofence.lambda;
    if (!port_write(&out, sizeof out)) return 0;
  }
  return 1;
}

int main(void) {
  uint32_t ticks, bytes;
  alula_stack_config config = alula_stack_defaults();
  if (!port_open() || !read_config(&config) || !port_read(&ticks, sizeof ticks)) return 1;
  const uint8_t* image = port_map(&bytes);
  const uint32_t opened = (uint32_t)alula_map_open(&replayed_stack_map, image, bytes);
  const uint32_t made =
      (uint32_t)alula_stack_init(&replayed_stack, &replayed_stack_map, &replayed_stack_fence, &config);
  if (!port_write(&opened, sizeof opened) || !port_write(&made, sizeof made)) return 2;
  if (opened != ALULA_MAP_READY || made != ALULA_READY || !fly(ticks)) return 4;
  const uint32_t stack = port_stack();
  return port_write(&stack, sizeof stack) ? 0 : 6;
}
