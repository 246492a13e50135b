/* Vector operations for the sources of native/onboard. Private. */
#ifndef ALULA_ONBOARD_VECTOR_H
#define ALULA_ONBOARD_VECTOR_H

/* Unrolls loops over the components of vectors: with -O2 they would stay loops, at three times the instructions. */
#if defined(__GNUC__) && !defined(__clang__)
#define ALULA_UNROLL _Pragma("GCC unroll 6")
#else
#define ALULA_UNROLL
#endif

static inline float dot(const float a[3], const float b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static inline float norm(const float a[3]) { return __builtin_sqrtf(dot(a, a)); }
static inline float absolute(float x) { return __builtin_fabsf(x); }

/* Clips to [-limit, limit], also NaN. */
static inline float clipped(float x, float limit) {
  if (absolute(x) <= limit) return x;
  return x < 0.0F ? -limit : limit;
}

#endif
