/* Bounds on the accelerations of tracked obstacles. */
#include "alula_avoidance.h"
#include "vector.h"

alula_envelope* alula_find_envelope(alula_avoidance* avoidance, uint32_t id) {
  for (uint32_t i = 0; i < avoidance->envelope_count; ++i)
    if (avoidance->envelope[i].id == id) return avoidance->envelope + i;
  return 0;
}

/* One Euler step of the differentiator, and of the bound: a running maximum with forgetting. */
static void differentiate(const alula_avoidance_config* c, alula_envelope* e, const float velocity[3]) {
  for (int k = 0; k < 3; ++k) {
    const float error = e->z0[k] - velocity[k];
    const float sign = error > 0.0F ? 1.0F : (error < 0.0F ? -1.0F : 0.0F);
    e->z0[k] += c->dt_s * (e->z1[k] - c->l1 * __builtin_sqrtf(absolute(error)) * sign);
    e->z1[k] -= c->dt_s * c->l2 * sign;
  }
  if (e->age < ALULA_NO_OBSTACLE) ++e->age;
  if ((float)e->age * c->dt_s < c->settle_s) return;
  const float now = norm(e->z1), held = e->bound - c->envelope_forget * c->dt_s;
  e->bound = now > held ? now : held;
  if (e->bound > c->envelope_cap) e->bound = c->envelope_cap;
}

void alula_update_envelopes(alula_avoidance* avoidance, const alula_track* track, uint32_t count) {
  const alula_avoidance_config* c = &avoidance->config;
  for (uint32_t i = 0; i < avoidance->envelope_count; ++i) avoidance->envelope[i].seen = 0U;
  for (uint32_t i = 0; i < count; ++i) {
    alula_envelope* e = alula_find_envelope(avoidance, track[i].id);
    if (e) e->seen = 1U;
  }
  uint32_t kept = 0U;
  for (uint32_t i = 0; i < avoidance->envelope_count; ++i)
    if (avoidance->envelope[i].seen) avoidance->envelope[kept++] = avoidance->envelope[i];
  avoidance->envelope_count = kept;
  for (uint32_t i = 0; i < count; ++i) {
    alula_envelope* e = alula_find_envelope(avoidance, track[i].id);
    if (!e) {
      e = avoidance->envelope + avoidance->envelope_count++;
      e->id = track[i].id;
      e->age = 0U;
      e->bound = c->envelope_start;
      for (int k = 0; k < 3; ++k) e->z0[k] = track[i].velocity[k], e->z1[k] = 0.0F;
    }
    differentiate(c, e, track[i].velocity);
  }
}
