/* Recorded states and nominal velocities through the chord filter.
 *
 * inputs.bin: uint32 ticks; float extent_m, radius_m, beta, lag_s, dt_s, v_max; then per tick x[3], v[3], u_nom[3].
 * outputs.bin: uint32 status of opening the map, status of the filter's set-up; then per tick a `tick`; then
 * uint32 bytes of the stack.
 */
#include "alula.h"
#include "port.h"

typedef struct {
  uint32_t status;
  alula_polytope_result result;
  uint32_t counted;
  alula_polytope_work work;
  uint32_t rows, soft;
} tick;

alula_map replayed_map;
alula_chord replayed_chord;

int main(void) {
  uint32_t ticks, bytes;
  float parameter[6];
  if (!port_open() || !port_read(&ticks, sizeof ticks) || !port_read(parameter, sizeof parameter)) return 1;
  alula_polytope_cbf_config config = ALULA_POLYTOPE_CBF_DEFAULTS;
  config.radius_m = parameter[1];
  config.beta = parameter[2];
  config.dt_s = parameter[4];
  config.v_max = parameter[5];
  const uint8_t* image = port_map(&bytes);
  const uint32_t opened = (uint32_t)alula_map_open(&replayed_map, image, bytes);
  const uint32_t made =
      (uint32_t)alula_chord_open(&replayed_chord, &replayed_map, parameter[0], &config, parameter[3]);
  if (!port_write(&opened, sizeof opened) || !port_write(&made, sizeof made)) return 2;
  if (opened != ALULA_MAP_READY || made != ALULA_READY) return 3;
  for (uint32_t i = 0; i < ticks; ++i) {
    float input[9];
    tick out;
    if (!port_read(input, sizeof input)) return 4;
    port_start();
    out.status = (uint32_t)alula_chord_filter(&replayed_chord, input, input + 3, input + 6, 0, &out.result);
    out.counted = port_stop();
    out.work = replayed_chord.hulls.work;
    out.rows = replayed_chord.count;
    out.soft = replayed_chord.soft;
    if (!port_write(&out, sizeof out)) return 5;
  }
  const uint32_t stack = port_stack();
  return port_write(&stack, sizeof stack) ? 0 : 6;
}
