/* Recorded encounters through dr-acbf with its default parameters.
 *
 * inputs.bin: uint32 ticks; then per tick an alula_vehicle_state, float nominal[3], uint32 tracks, walls, and these.
 * outputs.bin: uint32 status of the filter's set-up; then per tick a `tick`; then uint32 bytes of the stack.
 */
#include "alula.h"
#include "port.h"

typedef struct {
  uint32_t status;
  float a[3];
  uint32_t mode, feasible, rows, iterations;
  float horizon_s, violation;
  uint32_t counted;
} tick;

alula_dr_acbf replayed_dr_acbf;
static alula_track track[ALULA_OBSTACLES];
static alula_wall wall[ALULA_WALLS];

int main(void) {
  uint32_t ticks;
  if (!port_open() || !port_read(&ticks, sizeof ticks)) return 1;
  const alula_dr_acbf_config config = alula_dr_acbf_defaults();
  const uint32_t made = (uint32_t)alula_dr_acbf_init(&replayed_dr_acbf, &config);
  if (!port_write(&made, sizeof made)) return 2;
  if (made != ALULA_READY) return 3;
  for (uint32_t i = 0; i < ticks; ++i) {
    alula_vehicle_state vehicle;
    float nominal[3];
    uint32_t count[2];
    if (!port_read(&vehicle, sizeof vehicle) || !port_read(nominal, sizeof nominal)) return 4;
    if (!port_read(count, sizeof count) || count[0] > ALULA_OBSTACLES || count[1] > ALULA_WALLS) return 4;
    if (!port_read(track, count[0] * (uint32_t)sizeof *track)) return 4;
    if (!port_read(wall, count[1] * (uint32_t)sizeof *wall)) return 4;
    alula_dr_acbf_result result = {.horizon_s = 0.0F};
    tick out;
    port_start();
    out.status = (uint32_t)alula_dr_acbf_filter(&replayed_dr_acbf, &vehicle, track, count[0], wall, count[1], nominal,
                                                &result);
    out.counted = port_stop();
    for (int k = 0; k < 3; ++k) out.a[k] = result.a[k];
    out.mode = (uint32_t)result.guidance.mode;
    out.feasible = (uint32_t)result.feasible;
    out.rows = result.rows;
    out.iterations = result.iterations;
    out.horizon_s = result.horizon_s;
    out.violation = result.violation;
    if (!port_write(&out, sizeof out)) return 5;
  }
  const uint32_t stack = port_stack();
  return port_write(&stack, sizeof stack) ? 0 : 6;
}
