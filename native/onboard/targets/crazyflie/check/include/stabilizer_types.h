/* Declarations of the firmware that the app uses, for compiling without the firmware. Not the firmware's headers:
 * written from its documentation, with only the names and types that the app needs. */
#ifndef CHECK_STABILIZER_TYPES_H
#define CHECK_STABILIZER_TYPES_H

#include <stdbool.h>
#include <stdint.h>

typedef uint32_t stabilizerStep_t;

typedef struct {
  uint32_t timestamp;
  float x, y, z;
} check_vector;

typedef struct {
  float x, y, z, w;
} check_quaternion;

typedef struct {
  uint32_t timestamp;
  float roll, pitch, yaw; /* degrees */
} check_attitude;

typedef enum { modeDisable = 0, modeAbs, modeVelocity } stab_mode_t;

typedef struct {
  uint32_t timestamp;
  check_attitude attitude, attitudeRate;
  check_quaternion attitudeQuaternion;
  float thrust;
  check_vector position, velocity, acceleration;
  bool velocity_body;
  struct {
    stab_mode_t x, y, z, roll, pitch, yaw, quat;
  } mode;
} setpoint_t;

typedef struct {
  check_attitude attitude;
  check_quaternion attitudeQuaternion;
  check_vector position, velocity, acc;
} state_t;

typedef struct {
  uint64_t interruptTimestamp;
} sensorData_t;

typedef struct {
  int16_t roll, pitch, yaw;
  float thrust;
} control_t;

#define RATE_MAIN_LOOP 1000
#define RATE_500_HZ 500
#define RATE_DO_EXECUTE(RATE, STEP) ((STEP) % (RATE_MAIN_LOOP / (RATE)) == 0)

#endif
