/* Recorded flights through the geofence.
 *
 * inputs.bin: uint32 flights, has_map; then per flight an alula_geofence_config; uint32 has_box, float lower[3],
 * upper[3], uint32 faces, float faces[][4]; uint32 ticks, and these: uint32 of two bits, whether there is navigation
 * and whether a pilot, an alula_racer_state, an alula_racer_command.
 * outputs.bin: uint32 status of opening the map, 0 without one, and of the first flight's set-up; then per tick a
 * `tick`; then uint32 bytes of the stack.
 */
#include "alula.h"
#include "port.h"

#define HAS_NAVIGATION 1U
#define HAS_PILOT 2U

typedef struct {
  uint32_t has_box;
  float lower[3], upper[3];
  uint32_t face_count;
} head;

typedef struct {
  uint32_t there;
  alula_racer_state navigation;
  alula_racer_command pilot;
} input;

typedef struct {
  uint32_t status;
  alula_geofence_result result;
  uint32_t counted;
} tick;

alula_map replayed_fence_map;
alula_fence replayed_fence;
alula_geofence replayed_geofence;

static int read_fence(uint32_t has_map) {
  head read;
  if (!port_read(&read, sizeof read) || read.face_count > ALULA_FENCE_FACES) return 0;
  replayed_fence.has_box = (int)read.has_box;
  for (int i = 0; i < 3; ++i) {
    replayed_fence.lower[i] = read.lower[i];
    replayed_fence.upper[i] = read.upper[i];
  }
  replayed_fence.face_count = read.face_count;
  replayed_fence.keep_out = has_map ? &replayed_fence_map : 0;
  return port_read(replayed_fence.face, read.face_count * (uint32_t)sizeof replayed_fence.face[0]);
}

static int fly(uint32_t ticks) {
  for (uint32_t i = 0; i < ticks; ++i) {
    input in;
    tick out;
    if (!port_read(&in, sizeof in)) return 0;
    const alula_racer_state* navigation = (in.there & HAS_NAVIGATION) != 0U ? &in.navigation : 0;
    const alula_racer_command* pilot = (in.there & HAS_PILOT) != 0U ? &in.pilot : 0;
    port_start();
    out.status = (uint32_t)alula_geofence_filter(&replayed_geofence, navigation, pilot, &out.result);
    out.counted = port_stop();
    if (!port_write(&out, sizeof out)) return 0;
  }
  return 1;
}

int main(void) {
  uint32_t count[2], bytes, opened = 0U;
  if (!port_open() || !port_read(count, sizeof count)) return 1;
  const uint8_t* image = port_map(&bytes);
  if (count[1]) opened = (uint32_t)alula_map_open(&replayed_fence_map, image, bytes);
  for (uint32_t flight = 0; flight < count[0]; ++flight) {
    alula_geofence_config config;
    uint32_t ticks;
    if (!port_read(&config, sizeof config) || !read_fence(count[1]) || !port_read(&ticks, sizeof ticks)) return 3;
    const uint32_t made = (uint32_t)alula_geofence_init(&replayed_geofence, &replayed_fence, &config);
    if (flight == 0U && (!port_write(&opened, sizeof opened) || !port_write(&made, sizeof made))) return 2;
    if (opened != ALULA_MAP_READY || made != ALULA_READY || !fly(ticks)) return 4;
  }
  const uint32_t stack = port_stack();
  return port_write(&stack, sizeof stack) ? 0 : 6;
}
