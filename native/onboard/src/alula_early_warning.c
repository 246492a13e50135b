/* The conditional value at risk (CVaR) of coming too close, of a track's Gaussian: a closed form, rounded up.
 *
 * The source takes the mean of the worst m of N_s samples. That estimate is too small on average, and with few
 * samples by a large part of the deviation. Here Z = R + D(v) - |P| is replaced by a quadratic in the Gaussian error:
 * -|P| by -n . P, which is at least as large, and v by its linearisation, so that D(v) becomes linear plus c^2 / (2
 * (a_e + a_i)). CVaR is subadditive: that of the linear part is its mean plus k_beta times its deviation, and that of
 * the square is added in full. Close to the line-of-sight's singularity a second bound, with |V| for v, is smaller.
 */
#include "alula_avoidance.h"
#include "vector.h"

#define NEAREST 1.0e-3F /* [m], [m/s] */
#define TIMES 5U        /* of the prediction, from 0 to h_max_s */
#define ROUNDING 1.002F /* of the two factors below, for the error of the quantile */

/* Quantile of the standard normal for 0 < u < 1, to 5e-4 (Abramowitz, Stegun 26.2.23). */
static float normal_quantile(float u) {
  const float tail = u < 0.5F ? u : 1.0F - u;
  const float t = __builtin_sqrtf(-2.0F * alula_logf(tail));
  const float z =
      t - (2.515517F + t * (0.802853F + t * 0.010328F)) / (1.0F + t * (1.432788F + t * (0.189269F + t * 0.001308F)));
  return u < 0.5F ? -z : z;
}

/* CVaR at `tail` of a standard normal, and of its square; both rounded up. */
void alula_early_warning_tails(float tail, float* of_normal, float* of_square) {
  const float density = 0.39894228F;
  *of_normal = 0.0F;
  if (tail < 1.0F) {
    const float q = normal_quantile(tail); /* negative: the same density, and no digits of a small tail are lost */
    *of_normal = ROUNDING * density * alula_expf(-0.5F * q * q) / tail;
  }
  const float q = -normal_quantile(0.5F * tail); /* of the absolute value */
  *of_square = ROUNDING * (1.0F + 2.0F * (q > 0.0F ? q : 0.0F) * density * alula_expf(-0.5F * q * q) / tail);
}

/* x^T C x of the track's covariance, the vehicle's covariance of position included; at least 0. Where it overflows,
 * the largest number: the sum may then be NaN. */
static float spread(const float covariance[21], const float own[6], const float x[6]) {
  float sum = 0.0F;
  for (uint32_t i = 0; i < 6U; ++i) {
    for (uint32_t j = 0; j <= i; ++j) {
      float c = covariance[i * (i + 1U) / 2U + j];
      if (i < 3U) c += own[j == 0U ? i : (j == 1U ? i + 2U : 5U)];
      sum += (i == j ? 1.0F : 2.0F) * c * x[i] * x[j];
    }
  }
  return sum > 0.0F ? sum : 0.0F;
}

static float lipschitz(const alula_avoidance_config* c, float closing) {
  const float slope = c->latency_s + closing / (c->a_max + c->obstacle_braking);
  return __builtin_sqrtf(1.0F + slope * slope);
}

static float needed(const alula_avoidance_config* c, float radius, float closing) {
  return radius + closing * c->latency_s + closing * closing / (2.0F * (c->a_max + c->obstacle_braking));
}

/* A state at time t: relative position, velocity and their products. */
typedef struct {
  float at[3], moving[3], los[3], distance, closing, speed;
} prediction;

static prediction predict(const float p[3], const float v[3], const float a[3], float t) {
  prediction s;
  for (int k = 0; k < 3; ++k) {
    s.moving[k] = v[k] + a[k] * t;
    s.at[k] = p[k] + (v[k] + 0.5F * a[k] * t) * t;
  }
  s.distance = norm(s.at);
  for (int k = 0; k < 3; ++k) s.los[k] = s.distance > NEAREST ? s.at[k] / s.distance : (k == 0 ? 1.0F : 0.0F);
  s.closing = -dot(s.los, s.moving);
  s.speed = norm(s.moving);
  return s;
}

/* The variance of a linear form of (position, velocity) at time t, in terms of the estimate at time 0. */
static float variance_at(const alula_track* track, const float own[6], const float of_position[3],
                         const float of_velocity[3], float t) {
  float x[6];
  for (int k = 0; k < 3; ++k) {
    x[k] = of_position[k];
    x[k + 3] = of_velocity[k] + t * of_position[k];
  }
  return spread(track->covariance, own, x);
}

/* Variance of the velocity, all axes. */
static float trace(const alula_track* track) {
  return track->covariance[9] + track->covariance[14] + track->covariance[20];
}

/* CVaR of R + D(v) - |P|, linear in the closing speed along the predicted line of sight; D's curvature is added. */
static float risk_along(const alula_avoidance* avoidance, float radius, const alula_track* track, const float own[6],
                        const prediction* s, float t, float* fastest) {
  const alula_avoidance_config* c = &avoidance->config;
  const float deceleration = c->a_max + c->obstacle_braking;
  const float closing = s->closing > 0.0F ? s->closing : 0.0F;
  const float slope = s->closing > 0.0F ? c->latency_s + closing / deceleration : 0.0F;
  const float length = s->distance > NEAREST ? s->distance : NEAREST;
  float of_position[3], of_velocity[3], turning[3], range[3];
  for (int k = 0; k < 3; ++k) {
    const float across = s->moving[k] + s->closing * s->los[k];
    turning[k] = -across / length; /* gradient of the closing speed in the position */
    range[k] = -s->los[k];
    of_position[k] = range[k] + slope * turning[k];
    of_velocity[k] = slope * range[k];
  }
  const float deviation = __builtin_sqrtf(variance_at(track, own, of_position, of_velocity, t));
  const float square = variance_at(track, own, turning, range, t); /* of the closing speed */
  const float speeding = __builtin_sqrtf(square);
  *fastest = closing + avoidance->tail_of_normal * speeding;
  float risk = needed(c, radius, closing) - s->distance + avoidance->tail_of_normal * deviation +
               avoidance->tail_of_square * square / (2.0F * deceleration);
  if (!(s->closing > 0.0F)) risk += c->latency_s * __builtin_sqrtf(avoidance->tail_of_square * square);
  return risk;
}

/* An upper bound that holds for every line of sight: the closing speed is at most |V|, and |P| at least n . P. */
static float risk_of_speed(const alula_avoidance* avoidance, float radius, const alula_track* track,
                           const float own[6], const prediction* s, float t) {
  const alula_avoidance_config* c = &avoidance->config;
  const float deceleration = c->a_max + c->obstacle_braking, speed = s->speed > NEAREST ? s->speed : NEAREST;
  const float slope = (c->latency_s + speed / deceleration) / speed;
  float of_position[3], of_velocity[3];
  for (int k = 0; k < 3; ++k) {
    of_position[k] = -s->los[k];
    of_velocity[k] = slope * s->moving[k];
  }
  return needed(c, radius, speed) - s->distance +
         avoidance->tail_of_normal * __builtin_sqrtf(variance_at(track, own, of_position, of_velocity, t)) +
         0.5F * slope * avoidance->tail_of_square * trace(track);
}
float alula_early_warning(const alula_avoidance* avoidance, const alula_vehicle_state* vehicle,
                          const alula_track* track, const float relative_acceleration[3]) {
  const alula_avoidance_config* c = &avoidance->config;
  const float radius = c->radius_m + track->radius_m;
  float p[3], v[3], most = -FLT_MAX;
  for (int k = 0; k < 3; ++k) {
    p[k] = track->position[k] - vehicle->position[k];
    v[k] = track->velocity[k] - vehicle->velocity[k];
  }
  for (uint32_t k = 0; k < TIMES; ++k) {
    const float t = c->h_max_s * (float)k / (float)(TIMES - 1U);
    const prediction s = predict(p, v, relative_acceleration, t);
    float fastest;
    const float along = risk_along(avoidance, radius, track, vehicle->covariance, &s, t, &fastest);
    const float any = risk_of_speed(avoidance, radius, track, vehicle->covariance, &s, t);
    const float limit = s.speed + avoidance->tail_of_normal * __builtin_sqrtf(trace(track));
    const float risk = (along < any ? along : any) + c->wasserstein * lipschitz(c, fastest < limit ? fastest : limit);
    if (!(risk <= most)) most = risk;
  }
  return most;
}
