/* The conditional value at risk (CVaR) of coming too close, from samples of a track's Gaussian. */
#include "alula_avoidance.h"
#include "vector.h"

#define TIMES 5U /* of the prediction, from 0 to h_max_s */
#define HALF (ALULA_SAMPLES / 2U)

/* Quantile of the standard normal for 0 < u < 1, to 5e-4 (Abramowitz, Stegun 26.2.23). */
static float normal_quantile(float u) {
  const float tail = u < 0.5F ? u : 1.0F - u;
  const float t = __builtin_sqrtf(-2.0F * alula_logf(tail));
  const float z =
      t - (2.515517F + t * (0.802853F + t * 0.010328F)) / (1.0F + t * (1.432788F + t * (0.189269F + t * 0.001308F)));
  return u < 0.5F ? -z : z;
}

void alula_early_warning_samples(float sample[HALF][6]) {
  /* Kronecker sequence: steps of 2^32 g^-(j + 1), g the real root of g^7 = g + 1 */
  static const uint32_t step[6] = {3859688306U, 3468523225U, 3117001274U, 2801104767U, 2517223198U, 2262111973U};
  for (int j = 0; j < 6; ++j) {
    uint32_t at = 0x80000000U;
    float square = 0.0F;
    for (uint32_t n = 0; n < HALF; ++n) {
      at += step[j];
      sample[n][j] = normal_quantile(((float)(at >> 8) + 0.5F) * 5.9604644775390625e-8F);
      square += sample[n][j] * sample[n][j];
    }
    const float scale = __builtin_sqrtf((float)HALF / square); /* variance 1; the mirrored samples make the mean 0 */
    for (uint32_t n = 0; n < HALF; ++n) sample[n][j] *= scale;
  }
}

/* Lower triangular L with L L^T = C + the vehicle's covariance of position; a direction without variance stays 0. */
static void factor(const float covariance[21], const float own[6], float l[21]) {
  for (uint32_t i = 0; i < 6U; ++i) {
    for (uint32_t j = 0; j <= i; ++j) {
      const uint32_t at = i * (i + 1U) / 2U + j;
      float s = covariance[at];
      if (i < 3U) s += own[j == 0U ? i : (j == 1U ? i + 2U : 5U)];
      for (uint32_t k = 0; k < j; ++k) s -= l[i * (i + 1U) / 2U + k] * l[j * (j + 1U) / 2U + k];
      if (i == j) {
        l[at] = s > 0.0F ? __builtin_sqrtf(s) : 0.0F;
      } else {
        const float pivot = l[j * (j + 1U) / 2U + j];
        l[at] = pivot > 0.0F ? s / pivot : 0.0F;
      }
    }
  }
}

static float lipschitz(const alula_avoidance_config* c, float closing) {
  const float slope = c->latency_s + closing / (c->a_max + c->obstacle_braking);
  return __builtin_sqrtf(1.0F + slope * slope);
}

static float needed(const alula_avoidance_config* c, float radius, float closing) {
  return radius + closing * c->latency_s + closing * closing / (2.0F * (c->a_max + c->obstacle_braking));
}

/* Z of one sample at one time, and its closing speed. */
static float violation(const alula_avoidance_config* c, float radius, const float p[3], const float v[3],
                       const float a[3], float t, float* closing) {
  float at[3], moving[3];
  for (int k = 0; k < 3; ++k) {
    moving[k] = v[k] + a[k] * t;
    at[k] = p[k] + (v[k] + 0.5F * a[k] * t) * t;
  }
  const float distance = norm(at);
  const float towards = -dot(at, moving);
  *closing = towards > 0.0F && distance > 0.0F ? towards / distance : 0.0F;
  return needed(c, radius, *closing) - distance;
}

/* An upper bound over all samples and times. */
static float bound_of(const alula_avoidance* avoidance, float radius, const float p[3], const float v[3],
                      const float a[3], const float l[21]) {
  const alula_avoidance_config* c = &avoidance->config;
  float square_p = 0.0F, square_v = 0.0F;
  for (uint32_t i = 0; i < 21U; ++i) *(i < 6U ? &square_p : &square_v) += l[i] * l[i];
  const float off = avoidance->worst_sample * __builtin_sqrtf(square_p);
  const float speed = norm(v) + avoidance->worst_sample * __builtin_sqrtf(square_v) + norm(a) * c->h_max_s;
  return 1.0e-3F + needed(c, radius, speed) + c->wasserstein * lipschitz(c, speed) -
         (norm(p) - off - speed * c->h_max_s);
}

/* CVaR: the mean of the largest fraction `tail` of Z at time t, plus eps L_Z. */
static float risk_at(const alula_avoidance* avoidance, float radius, const float p[3], const float v[3],
                     const float a[3], float t, float offset[HALF][6]) {
  const alula_avoidance_config* c = &avoidance->config;
  const float share = c->tail * (float)ALULA_SAMPLES;
  uint32_t kept = 1U;
  while (kept < ALULA_SAMPLES && (float)kept < share) ++kept;
  float largest[ALULA_SAMPLES], fastest = 0.0F; /* `largest` in descending order */
  for (uint32_t i = 0; i < kept; ++i) largest[i] = -FLT_MAX;
  for (uint32_t n = 0; n < ALULA_SAMPLES; ++n) {
    const float* d = offset[n % HALF];
    const float sign = n < HALF ? 1.0F : -1.0F;
    const float at[3] = {p[0] + sign * d[0], p[1] + sign * d[1], p[2] + sign * d[2]};
    const float moving[3] = {v[0] + sign * d[3], v[1] + sign * d[4], v[2] + sign * d[5]};
    float closing;
    const float z = violation(c, radius, at, moving, a, t, &closing);
    if (z > largest[0]) fastest = closing;
    uint32_t i = kept;
    for (; i > 0U && largest[i - 1U] < z; --i)
      if (i < kept) largest[i] = largest[i - 1U];
    if (i < kept) largest[i] = z;
  }
  float sum = 0.0F;
  for (uint32_t i = 0; i < kept; ++i) sum += largest[i];
  return sum / (float)kept + c->wasserstein * lipschitz(c, fastest);
}

float alula_early_warning(const alula_avoidance* avoidance, const alula_vehicle_state* vehicle,
                          const alula_track* track, const float relative_acceleration[3]) {
  const alula_avoidance_config* c = &avoidance->config;
  const float radius = c->radius_m + track->radius_m;
  float p[3], v[3], l[21], offset[HALF][6];
  for (int k = 0; k < 3; ++k) {
    p[k] = track->position[k] - vehicle->position[k];
    v[k] = track->velocity[k] - vehicle->velocity[k];
  }
  factor(track->covariance, vehicle->covariance, l);
  const float bound = bound_of(avoidance, radius, p, v, relative_acceleration, l);
  if (bound < 0.0F) return bound;
  for (uint32_t n = 0; n < HALF; ++n) {
    for (uint32_t i = 0; i < 6U; ++i) {
      offset[n][i] = 0.0F;
      for (uint32_t j = 0; j <= i; ++j) offset[n][i] += l[i * (i + 1U) / 2U + j] * avoidance->sample[n][j];
    }
  }
  float most = -FLT_MAX;
  for (uint32_t k = 0; k < TIMES; ++k) {
    const float t = c->h_max_s * (float)k / (float)(TIMES - 1U);
    const float risk = risk_at(avoidance, radius, p, v, relative_acceleration, t, offset);
    if (!(risk <= most)) most = risk;
  }
  return most;
}
