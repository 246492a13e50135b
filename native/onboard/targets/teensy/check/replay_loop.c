/* The loop in flight on an emulated Cortex-M7 and on a host: records the sent frames, with the model as the plant.
 *
 * outputs.bin: per tick a `tick`; then uint32 bytes of the stack. A flight at a wall, then a silent radio, then a
 * pilot again, then no navigation, then both.
 */
#include "port.h"
#include "teensy_loop.h"

#define TICKS 1600U
#define SUBSTEPS 8
#define FRAME_SUBSTEPS 5
#define TICK_US 5000U
#define SILENT_FROM 700U
#define SILENT_TO 900U
#define BLIND_FROM 1100U
#define BLIND_TO 1220U

typedef struct {
  uint8_t frame[ALULA_SBUS_BYTES];
  uint8_t status;
  uint8_t zero[2];
  float position[3];
  uint32_t counted;
} tick;

alula_teensy_loop replayed_loop;

static float rate_of_stick(const alula_teensy_config* c, int axis, uint32_t channel) {
  const float x = (880.0F + 0.625F * (float)channel - c->rates.middle_us) / 500.0F;
  return (axis == 2 ? -1.0F : 1.0F) * alula_rates_at(&c->rates.axis[axis], x);
}

static uint16_t channel_of(float us) { return (uint16_t)((us - 880.0F) / 0.625F + 0.5F); }

/* Tilts forward with constant yaw, and holds the height roughly. */
static void fly_by_hand(const alula_teensy_config* c, const alula_racer_state* x, alula_sbus_frame* frame) {
  float axis[3];
  alula_racer_axis(x->attitude, axis);
  const float rates[3] = {6.0F * axis[1], 6.0F * (0.9F - axis[0]), 0.0F};
  const float throttle = 0.34F + 0.3F * axis[0] - 0.03F * x->velocity[2] + 0.02F * (20.0F - x->position[2]);
  const float cut = throttle < 0.0F ? 0.0F : (throttle > 1.0F ? 1.0F : throttle);
  for (uint32_t i = 0; i < ALULA_SBUS_CHANNELS; ++i) frame->channel[i] = 172U;
  for (int i = 0; i < 2; ++i) {
    const float deflection = alula_rates_deflection(&c->rates.axis[i], rates[i]);
    frame->channel[i == 0 ? c->roll : c->pitch] = channel_of(c->rates.middle_us + 500.0F * deflection);
  }
  frame->channel[c->yaw] = channel_of(c->rates.middle_us);
  frame->channel[c->throttle] = channel_of(1050.0F + 950.0F * cut);
  frame->flags = 0U;
}

static void heed(const alula_teensy_config* c, const uint8_t bytes[ALULA_SBUS_BYTES], alula_racer_command* command) {
  alula_sbus_frame frame;
  if (!alula_sbus_decode(bytes, &frame)) return;
  const uint8_t channels[3] = {c->roll, c->pitch, c->yaw};
  for (int i = 0; i < 3; ++i) command->rates[i] = rate_of_stick(c, i, frame.channel[channels[i]]);
  const float throttle = (880.0F + 0.625F * (float)frame.channel[c->throttle] - 1050.0F) / 950.0F;
  command->throttle = throttle < 0.0F ? 0.0F : throttle;
}

int main(void) {
  static const alula_fence FENCE = {.has_box = 1, .lower = {-90, -90, 0}, .upper = {40, 90, 60}};
  const alula_teensy_config config = alula_teensy_defaults();
  const alula_racer_step_size step = alula_racer_step_of(&config.geofence.model, 0.000625F);
  alula_racer_state x = {{0, 0, 20}, {0, 0, 0}, {1, 0, 0, 0}, {0, 0, 0}};
  alula_racer_command command = {0.3F, {0, 0, 0}};
  tick out = {{0}, 0, {0, 0}, {0, 0, 0}, 0};
  if (!port_open() || alula_teensy_init(&replayed_loop, &FENCE, &config) != ALULA_READY) return 1;
  for (uint32_t k = 0; k < TICKS; ++k) {
    const uint32_t now = k * TICK_US;
    if (k < SILENT_FROM || k >= SILENT_TO) {
      alula_sbus_frame frame;
      uint8_t bytes[ALULA_SBUS_BYTES];
      fly_by_hand(&config, &x, &frame);
      alula_sbus_encode(&frame, bytes);
      alula_teensy_receive(&replayed_loop, now + 3000U, bytes, sizeof bytes);
    }
    if (k < BLIND_FROM || k >= BLIND_TO) {
      const alula_navigation n = {x, now, (uint16_t)k, ALULA_NAVIGATION_VALID};
      uint8_t bytes[ALULA_NAVIGATION_BYTES];
      if (!alula_navigation_encode(&n, bytes)) return 2;
      alula_teensy_navigate(&replayed_loop, now + 500U, bytes, sizeof bytes);
    }
    port_start();
    out.status = (uint8_t)alula_teensy_tick(&replayed_loop, now + TICK_US, out.frame);
    out.counted = port_stop();
    for (int j = 0; j < SUBSTEPS; ++j) {
      if (j == FRAME_SUBSTEPS) heed(&config, out.frame, &command);
      (void)alula_racer_step(&config.geofence.model, &step, &command, &x);
    }
    for (int i = 0; i < 3; ++i) out.position[i] = x.position[i];
    if (!port_write(&out, sizeof out)) return 3;
  }
  const uint32_t stack = port_stack();
  return port_write(&stack, sizeof stack) ? 0 : 4;
}
