/* The out-of-tree controller of a Crazyflie: set-points through the chord filter, then the firmware's own controller.
 *
 * The stabilizer's task calls controllerOutOfTree; the app's task does the work of the filter (crazyflie_filter.h).
 */
#include <stdbool.h>
#include <stdint.h>

#include "FreeRTOS.h"
#include "app.h"
#include "controller.h"
#include "controller_pid.h"
#include "crazyflie_filter.h"
#include "log.h"
#include "param.h"
#include "task.h"
#include "usec_time.h"

#define DEBUG_MODULE "ALULA"
#include "debug.h"

/* `alula export COVER -o src/cover_map.bin --target crazyflie` writes it; without one nothing is armed. */
#if defined(ALULA_COVER_MAP_HEADER)
#include ALULA_COVER_MAP_HEADER
#elif __has_include("cover_map.h")
#include "cover_map.h"
#else
#define COVER_MAP_BYTES 0U
static const uint8_t cover_map[1];
#endif

#define BASE_HZ RATE_500_HZ /* periods are whole numbers of its steps: 250, 167, 125, 100 Hz and so on */
#define SHORTEST 1U
#define LONGEST 50U
#define UNKNOWN (-1.0F) /* a variance that is never accepted */

static alula_crazyflie_filter filter;
static alula_crazyflie_config wanted; /* parameters, changed by the radio */
static uint8_t divider = 5;           /* of 500 Hz */
static bool isOpened, isReady;
static logVarId_t variances[3];

static uint8_t status;
static uint32_t work_us, refusedParameters;
static float velocity[3];

/* NaN equals NaN here: refused parameters are not tried again every millisecond. */
static bool is_same(const alula_crazyflie_config* a, const alula_crazyflie_config* b) {
  const float one[] = {a->radius_m, a->beta, a->lag, a->v_max, a->period_s, a->gain, a->variance};
  const float other[] = {b->radius_m, b->beta, b->lag, b->v_max, b->period_s, b->gain, b->variance};
  for (uint32_t i = 0; i < sizeof one / sizeof one[0]; ++i) {
    if (one[i] != other[i] && (one[i] == one[i] || other[i] == other[i])) return false;
  }
#if ALULA_CRAZYFLIE_OBSTACLES > 0U
  for (int i = 0; i < 3; ++i)
    if (a->lower[i] != b->lower[i] || a->upper[i] != b->upper[i]) return false;
  if (a->fenced != b->fenced) return false;
#endif
  return a->enabled == b->enabled && a->attitude == b->attitude;
}

#if ALULA_CRAZYFLIE_OBSTACLES > 0U
static alula_crazyflie_obstacle obstacle; /* parameters; `id` is written last and becomes 0 when it was taken */
static uint32_t refusedObstacles;

static void take_report(void) {
  if (obstacle.id == 0U) return;
  if (!alula_crazyflie_report(&filter, &obstacle)) ++refusedObstacles;
  obstacle.id = 0U;
}
#else
static void take_report(void) {}
#endif

/* The parameters with the period of the divider. */
static alula_crazyflie_config parameters(void) {
  alula_crazyflie_config now = wanted;
  const uint32_t steps = divider < SHORTEST ? SHORTEST : (divider > LONGEST ? LONGEST : divider);
  now.period_s = (float)steps / (float)BASE_HZ;
  return now;
}

void appMain() {
  alula_crazyflie_config tried = parameters();
  if (isReady)
    DEBUG_PRINT("%lu hulls\n", (unsigned long)filter.map.hull_count);
  else
    DEBUG_PRINT("no map, not armed\n");
  while (1) {
    vTaskDelay(M2T(1));
    if (!isReady) continue;
    const alula_crazyflie_config now = parameters();
    if (!is_same(&now, &tried)) {
      tried = now;
      if (!alula_crazyflie_configure(&filter, &now)) ++refusedParameters;
    }
    take_report();
    const uint64_t begin = usecTimestamp();
    if (alula_crazyflie_work(&filter)) work_us = (uint32_t)(usecTimestamp() - begin);
  }
}

void controllerOutOfTreeInit(void) {
  controllerPidInit();
  if (isOpened) { /* selected again; the app's task may be running */
    alula_crazyflie_restart(&filter);
    return;
  }
  isOpened = true;
  wanted = alula_crazyflie_defaults();
  const alula_crazyflie_config config = parameters();
  isReady = alula_crazyflie_open(&filter, cover_map, COVER_MAP_BYTES, &config) != 0;
}

/* Without a map the self-test fails, and the firmware blocks the motors. */
bool controllerOutOfTreeTest(void) { return controllerPidTest() && isReady; }

/* The largest variance of the Kalman filter's position; other estimators have neither variance nor position. */
static float variance_now(void) {
  static bool isKnown;
  if (!isKnown) {
    variances[0] = logGetVarId("kalman", "varX");
    variances[1] = logGetVarId("kalman", "varY");
    variances[2] = logGetVarId("kalman", "varZ");
    isKnown = true;
  }
  float largest = 0.0F;
  for (int i = 0; i < 3; ++i) {
    if (!logVarIdIsValid(variances[i])) return UNKNOWN;
    const float now = logGetFloat(variances[i]);
    if (!(now <= largest)) largest = now; /* NaN is kept */
    if (largest != largest) return UNKNOWN;
  }
  return largest;
}

void controllerOutOfTree(control_t* control, const setpoint_t* setpoint, const sensorData_t* sensors,
                         const state_t* state, const stabilizerStep_t stabilizerStep) {
  const alula_crazyflie_request request = {
      {(uint8_t)setpoint->mode.x, (uint8_t)setpoint->mode.y, (uint8_t)setpoint->mode.z},
      setpoint->velocity_body,
      {setpoint->position.x, setpoint->position.y, setpoint->position.z},
      {setpoint->velocity.x, setpoint->velocity.y, setpoint->velocity.z},
      setpoint->thrust};
  const alula_crazyflie_state now = {{state->position.x, state->position.y, state->position.z},
                                     {state->velocity.x, state->velocity.y, state->velocity.z},
                                     {state->attitudeQuaternion.w, state->attitudeQuaternion.x,
                                      state->attitudeQuaternion.y, state->attitudeQuaternion.z},
                                     variance_now()};
  const uint32_t steps = (uint32_t)(filter.config.period_s * (float)BASE_HZ + 0.5F);
  const bool isDue = RATE_DO_EXECUTE(BASE_HZ, stabilizerStep) &&
                     stabilizerStep / (RATE_MAIN_LOOP / BASE_HZ) % (steps > 0U ? steps : 1U) == 0U;

  alula_crazyflie_output output;
  alula_crazyflie_step(&filter, &request, &now, isDue, 1.0F / (float)RATE_MAIN_LOOP, &output);
  setpoint_t flown = *setpoint;
  if (output.is_off) {
    static const setpoint_t NOTHING;
    flown = NOTHING; /* all axes off, no thrust */
  } else if (output.is_replaced) {
    flown.mode.x = flown.mode.y = flown.mode.z = modeVelocity;
    flown.mode.roll = flown.mode.pitch = flown.mode.quat = modeDisable; /* rates would override the velocity */
    flown.velocity.x = output.velocity[0];
    flown.velocity.y = output.velocity[1];
    flown.velocity.z = output.velocity[2];
    flown.velocity_body = false;
  }
  status = (uint8_t)output.status;
  for (int i = 0; i < 3; ++i) velocity[i] = output.velocity[i];
  controllerPid(control, &flown, sensors, state, stabilizerStep);
}

PARAM_GROUP_START(alula)
PARAM_ADD(PARAM_UINT8, enable, &wanted.enabled)
PARAM_ADD(PARAM_UINT8, attitude, &wanted.attitude)
PARAM_ADD(PARAM_UINT8, divider, &divider)
PARAM_ADD(PARAM_FLOAT, radius, &wanted.radius_m)
PARAM_ADD(PARAM_FLOAT, beta, &wanted.beta)
PARAM_ADD(PARAM_FLOAT, lag, &wanted.lag)
PARAM_ADD(PARAM_FLOAT, vmax, &wanted.v_max)
PARAM_ADD(PARAM_FLOAT, gain, &wanted.gain)
PARAM_ADD(PARAM_FLOAT, variance, &wanted.variance)
PARAM_GROUP_STOP(alula)

#if ALULA_CRAZYFLIE_OBSTACLES > 0U
PARAM_GROUP_START(alulaBox)
PARAM_ADD(PARAM_UINT8, enable, &wanted.fenced)
PARAM_ADD(PARAM_FLOAT, lowX, &wanted.lower[0])
PARAM_ADD(PARAM_FLOAT, lowY, &wanted.lower[1])
PARAM_ADD(PARAM_FLOAT, lowZ, &wanted.lower[2])
PARAM_ADD(PARAM_FLOAT, highX, &wanted.upper[0])
PARAM_ADD(PARAM_FLOAT, highY, &wanted.upper[1])
PARAM_ADD(PARAM_FLOAT, highZ, &wanted.upper[2])
PARAM_GROUP_STOP(alulaBox)

PARAM_GROUP_START(alulaBall)
PARAM_ADD(PARAM_FLOAT, x, &obstacle.position[0])
PARAM_ADD(PARAM_FLOAT, y, &obstacle.position[1])
PARAM_ADD(PARAM_FLOAT, z, &obstacle.position[2])
PARAM_ADD(PARAM_FLOAT, vx, &obstacle.velocity[0])
PARAM_ADD(PARAM_FLOAT, vy, &obstacle.velocity[1])
PARAM_ADD(PARAM_FLOAT, vz, &obstacle.velocity[2])
PARAM_ADD(PARAM_FLOAT, radius, &obstacle.radius_m)
PARAM_ADD(PARAM_UINT8, id, &obstacle.id)
PARAM_GROUP_STOP(alulaBall)

LOG_GROUP_START(alulaBall)
LOG_ADD(LOG_UINT32, known, &filter.track_count)
LOG_ADD(LOG_UINT32, refused, &refusedObstacles)
LOG_GROUP_STOP(alulaBall)
#endif

LOG_GROUP_START(alula)
LOG_ADD(LOG_FLOAT, h, &filter.margin_m)
LOG_ADD(LOG_UINT32, us, &work_us)
LOG_ADD(LOG_UINT8, status, &status)
LOG_ADD(LOG_UINT32, changed, &filter.corrections)
LOG_ADD(LOG_UINT32, late, &filter.late)
LOG_ADD(LOG_UINT32, refused, &refusedParameters)
LOG_ADD(LOG_FLOAT, vx, &velocity[0])
LOG_ADD(LOG_FLOAT, vy, &velocity[1])
LOG_ADD(LOG_FLOAT, vz, &velocity[2])
LOG_GROUP_STOP(alula)
