/* Exponential and logarithm from their series, so the last bit does not depend on a library. */
#include "alula_onboard.h"

#define LOG2_E 1.44269504F
#define LN2_HIGH 0.693359375F /* 355 / 512: k * LN2_HIGH is exact for |k| < 2^15 */
#define LN2_LOW (-2.12194440e-4F)
#define EXP_LARGEST 88.7228317F     /* log FLT_MAX, rounded down */
#define EXP_SMALLEST (-87.3365448F) /* log FLT_MIN, rounded up */

typedef union {
  float value;
  uint32_t bits;
} float_bits;

/* 2^k for -126 <= k <= 127. */
static float power_of_two(int32_t k) {
  float_bits result;
  result.bits = (uint32_t)(k + 127) << 23;
  return result.value;
}

float alula_expf(float x) {
  if (x != x) return x;
  if (x > EXP_LARGEST) return __builtin_inff();
  if (x < EXP_SMALLEST) return 0.0F;
  const int32_t k = (int32_t)(x * LOG2_E + (x < 0.0F ? -0.5F : 0.5F));
  const float r = (x - (float)k * LN2_HIGH) - (float)k * LN2_LOW; /* |r| <= 0.3467 */
  const float tail =
      0.5F +
      r * (1.0F / 6.0F + r * (1.0F / 24.0F + r * (1.0F / 120.0F + r * (1.0F / 720.0F + r * (1.0F / 5040.0F)))));
  const float y = (r * r * tail + r) + 1.0F;
  const int32_t half = k / 2; /* a float cannot hold 2^128, but its square root */
  return y * power_of_two(half) * power_of_two(k - half);
}

float alula_logf(float x) {
  if (x != x || x < 0.0F) return __builtin_nanf("");
  if (x == 0.0F) return -__builtin_inff();
  if (x > FLT_MAX) return x;
  int32_t exponent = 0;
  if (x < FLT_MIN) {
    x *= 8388608.0F; /* 2^23 */
    exponent = -23;
  }
  float_bits m;
  m.value = x;
  exponent += (int32_t)(m.bits >> 23) - 127;
  m.bits = (m.bits & 0x007FFFFFU) | 0x3F800000U; /* in [1, 2) */
  if (m.value > 1.41421354F) {
    m.value *= 0.5F;
    ++exponent;
  }
  /* log m = 2 artanh s, s = (m - 1) / (m + 1), |s| <= 0.1716; with f = m - 1 exact,
   * 2 s = f - s f, so the leading term carries no rounding. */
  const float f = m.value - 1.0F;
  const float s = f / (2.0F + f);
  const float z = s * s;
  const float tail =
      z * (1.0F / 3.0F + z * (1.0F / 5.0F + z * (1.0F / 7.0F + z * (1.0F / 9.0F + z * (1.0F / 11.0F)))));
  const float e = (float)exponent;
  const float half_square = 0.5F * f * f;
  /* 2 s (1 + tail) = f - f^2 / 2 + s (f^2 / 2 + 2 tail) */
  return e * LN2_HIGH + (f - (half_square - (s * (half_square + 2.0F * tail) + e * LN2_LOW)));
}
