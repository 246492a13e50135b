/* Common definitions of native/onboard: freestanding C99, single precision, no heap, no libm.
 *
 * Build with -ffp-contract=off and -fno-math-errno: then a host and a microcontroller with an
 * IEEE 754 single-precision unit compute the same bits. All state is in structs that the caller owns.
 */
#ifndef ALULA_ONBOARD_H
#define ALULA_ONBOARD_H

#include <float.h>
#include <stdint.h>

#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0
#error "float expressions must be evaluated in float"
#endif

#if defined(__GNUC__)
#define ALULA_MUST_USE __attribute__((warn_unused_result))
#else
#define ALULA_MUST_USE
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Result of a set-up call. */
typedef enum {
  ALULA_READY = 0,
  ALULA_BAD_POINTER,
  ALULA_BAD_PARAMETER,
  ALULA_BAD_MAP,
  ALULA_BAD_INPUT,
  ALULA_NO_REST, /* a geofence's horizon ends before the backup controller has stopped the vehicle */
  ALULA_TOO_LATE /* a geofence's regulation function takes over later than a tick of the pilot's allows */
} alula_status;

/* Outcome of a filter's tick. In all cases but REFUSED the result may be flown. */
typedef enum {
  ALULA_FILTER_OK = 0,     /* the nominal input is safe and returned bit by bit */
  ALULA_FILTER_FILTERED,   /* changed by the barrier's row or the speed limit */
  ALULA_FILTER_SHORTENED,  /* scaled down further, so the held step stays clear */
  ALULA_FILTER_RECOVERING, /* the state is already too close: drives out, the nominal input is ignored */
  ALULA_FILTER_REFUSED     /* no safe input is known: zero */
} alula_filter_status;

/* e^x with a relative error below 1e-7 where the result is a normal number; smaller results are 0,
 * larger ones infinity, and NaN gives NaN. */
ALULA_MUST_USE float alula_expf(float x);

/* Natural logarithm with a relative error below 1e-7 for finite x > 0; 0 gives -infinity, infinity
 * gives infinity, negative numbers and NaN give NaN. */
ALULA_MUST_USE float alula_logf(float x);

/* False for NaN and both infinities. */
ALULA_MUST_USE static inline int alula_is_finite(float x) { return x >= -FLT_MAX && x <= FLT_MAX; }

#ifdef __cplusplus
}
#endif
#endif
