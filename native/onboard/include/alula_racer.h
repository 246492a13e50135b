/* Model of a racing drone with its rate loop, and the backup controller that stops it, in freestanding C99.
 *
 *   p' = v,  q' = q (0, omega) / 2,  v' = a(throttle) z(q) - g e3,  omega' = C (omega_des - omega)
 *   a(throttle) = a_0 + a_1 throttle + a_2 throttle^2
 *
 * z(q) is the body's z axis; the world's z points up. The backup controller u_B steers to a velocity v_d:
 *
 *   (e_x, e_y) = Rz(yaw_0)^T (v_d - v),  t = 0.15 (e_x, e_y), |t| cut at pi / 2.1 and faded to 0 below the horizon
 *   R_d = Rz(yaw_0) exp(-t_y, t_x, 0),  omega_des = -10 e_R,  e_R = vee(R_d^T R - R^T R_d) / 2
 *   throttle = hover / zeta + cut(0.1 (z_0 - z), 0.3) + cut(0.05 (v_d,z - v_z), 0.3)
 *
 * Above 90 degrees of error e_R keeps growing like the sine of half the angle, up to sqrt 2; as printed it vanishes
 * at 180 degrees, where an inverted drone would fall.
 * zeta is the third component of z(q); 1 / zeta is 2 below zeta = 1/2 and decreases to 1/3 from the horizon to a
 * quarter below it. The hold (z_0, yaw_0) is frozen when a flow starts, and is part of the state of the caller.
 *
 * Other differences to the published controller. Its flow jumps where the thrust passes the horizon; here the jump is
 * a ramp of a quarter. At high speed along a diagonal it brakes one axis after the other; here the tilt is one
 * rotation instead of a pitch and then a roll (the same along an axis). yaw_0 also turns the error of the velocity
 * (the same while the yaw is held), and the height is controlled as (17) controls x and y.
 *
 * Source: Singletary, Swann, Chen, Ames 2022 (arXiv 2201.04331), eq. 15, 17, section IV-B.
 * Single precision; SI units. Every loop is bounded by a constant.
 */
#ifndef ALULA_RACER_H
#define ALULA_RACER_H

#include "alula_onboard.h"
#include "alula_options.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
  float position[3], velocity[3]; /* world */
  float attitude[4];              /* w, x, y, z; body to world */
  float rates[3];                 /* body [rad/s] */
} alula_racer_state;

typedef struct {
  float throttle; /* 0 to 1 */
  float rates[3]; /* omega_des */
} alula_racer_command;

/* The published gains. */
alula_backup_gains alula_backup_defaults(void);

typedef struct {
  float height;         /* z_0 */
  float cosine, sine;   /* of yaw_0 */
  float half_c, half_s; /* of yaw_0 / 2 */
} alula_backup_hold;

/* Constants of a fixed step: 1 - exp(-C dt), and the mean of exp(-C t) over the step. */
typedef struct {
  float dt, gain, mean;
} alula_racer_step_size;

alula_racer_step_size alula_racer_step_of(const alula_racer_model* model, float dt);

float alula_racer_thrust(const alula_racer_model* model, float throttle);     /* [m/s^2] */
float alula_racer_throttle_for(const alula_racer_model* model, float thrust); /* 0 where none is so small */
float alula_racer_hover_throttle(const alula_racer_model* model); /* a(throttle) = g; above 1: cannot hover */
void alula_racer_axis(const float attitude[4], float axis[3]);    /* z(q) */
void alula_racer_limit(const alula_racer_model* model, alula_racer_command* command); /* into its box */

/* Nonzero for a finite, plausible state: |v_i| <= 200 m/s, |omega_i| <= 100 rad/s, |p_i| <= 10^5 m,
 * | |q| - 1 | <= 0.05. */
ALULA_MUST_USE int alula_racer_state_is_valid(const alula_racer_state* state);
void alula_racer_normalise(alula_racer_state* state); /* to |q| = 1, of a valid state */
ALULA_MUST_USE int alula_racer_command_is_finite(const alula_racer_command* command);

/* The hold of a flow that starts here; `climb` is the target height relative to the current one. */
alula_backup_hold alula_backup_hold_at(const alula_racer_state* state, float climb);

/* u_B, limited to the box of commands. `hover` is the throttle that hovers. */
void alula_backup_command(const alula_racer_model* model, const alula_backup_gains* gains,
                          const alula_backup_hold* hold, float hover, const alula_racer_state* state,
                          const float v_d[3], alula_racer_command* command);

/* A step with the command held. Rates are exact; the attitude turns by their integral; velocity and position are of
 * second order in dt. Returns the thrust. */
float alula_racer_step(const alula_racer_model* model, const alula_racer_step_size* step,
                       const alula_racer_command* command, alula_racer_state* state);

#ifdef __cplusplus
}
#endif
#endif
