/* A recorded flight through the stack.
 *
 * inputs.bin: a `head`; uint32 has_box, float lower[3], upper[3], uint32 faces, float faces[][4]; uint32 ticks; then
 * per tick an `input` and its tracks.
 * outputs.bin: uint32 status of opening the map, status of the stack's set-up; then per tick a `tick`; then uint32
 * bytes of the stack. All numbers have 32 bits: enumerations have other sizes on the target than on a host.
 */
#include "alula.h"
#include "port.h"

typedef struct {
  float extent_m, lag_s, hulls_radius_m, beta, dt_s, speed_m_s;
  float radius_m, a_max, latency_s, clearance_m, wall_room_m, v_max; /* of dr-acbf */
} head;

typedef struct {
  uint32_t has_box;
  float lower[3], upper[3];
  uint32_t face_count;
} fence_head;

typedef struct {
  float position[3], velocity[3], covariance[6], nominal[3];
  uint32_t is_taking_off, tracks;
} input;

typedef struct {
  uint32_t status;
  float velocity[3], margin_m;
  uint32_t mode, rows, obstacle_rows, failing;
  float horizon_s, violation_m_s;
  uint32_t counted;
  alula_polytope_work work;
  uint32_t soft;
} tick;

alula_map replayed_stack_map;
alula_fence replayed_stack_fence;
alula_stack replayed_stack;
static alula_track track[ALULA_OBSTACLES];
static alula_stack_result result;

static int read_config(alula_stack_config* config) {
  head read;
  fence_head box;
  if (!port_read(&read, sizeof read)) return 0;
  config->extent_m = read.extent_m;
  config->lag_s = read.lag_s;
  config->polytope_cbf.radius_m = read.hulls_radius_m;
  config->polytope_cbf.beta = read.beta;
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
  if (!port_read(&in, sizeof in) || in.tracks > ALULA_OBSTACLES) return 0;
  if (!port_read(track, in.tracks * (uint32_t)sizeof *track)) return 0;
  for (int k = 0; k < 3; ++k) {
    to->position[k] = in.position[k];
    to->velocity[k] = in.velocity[k];
    to->nominal[k] = in.nominal[k];
  }
  for (int k = 0; k < 6; ++k) to->covariance[k] = in.covariance[k];
  to->track = track;
  to->track_count = in.tracks;
  to->is_taking_off = (int)in.is_taking_off;
  return 1;
}

static int fly(uint32_t ticks) {
  for (uint32_t i = 0; i < ticks; ++i) {
    alula_stack_input in;
    tick out;
    if (!read_input(&in)) return 0;
    port_start();
    out.status = (uint32_t)alula_stack_filter(&replayed_stack, &in, &result);
    out.counted = port_stop();
    for (int k = 0; k < 3; ++k) out.velocity[k] = result.velocity[k];
    out.margin_m = result.chord.margin_m;
    out.mode = (uint32_t)result.guidance.mode;
    out.rows = result.rows;
    out.obstacle_rows = result.obstacle_rows;
    out.failing = result.failing;
    out.horizon_s = result.horizon_s;
    out.violation_m_s = result.violation_m_s;
    out.work = replayed_stack.chord.hulls.work;
    out.soft = replayed_stack.chord.soft;
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
