/* What the sources of native/onboard compute with; not for callers. */
#ifndef ALULA_ONBOARD_VECTOR_H
#define ALULA_ONBOARD_VECTOR_H

static inline float dot(const float a[3], const float b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static inline float norm(const float a[3]) { return __builtin_sqrtf(dot(a, a)); }
static inline float absolute(float x) { return x < 0.0F ? -x : x; }
static inline float clipped(float x, float limit) { return x > limit ? limit : (x < -limit ? -limit : x); }

#endif
