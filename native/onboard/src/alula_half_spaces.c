#include "alula_half_spaces.h"

#define DEGENERATE 1.0e-6F /* squared sine below which two constraints count as parallel */
#define BISECTIONS 16      /* of the least violation */

typedef struct {
  const alula_half_space* row;
  uint32_t count;
  float limit;
  float relaxed; /* added to the bounds of rows */
} constraints;

static float dot(const float a[3], const float b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static float clipped(float x, float limit) { return x > limit ? limit : (x < -limit ? -limit : x); }

static alula_half_space constraint(const constraints* c, uint32_t i) {
  alula_half_space h;
  if (i < c->count) {
    h = c->row[i];
    h.bound += c->relaxed;
    return h;
  }
  const uint32_t face = i - c->count;
  h.normal[0] = h.normal[1] = h.normal[2] = 0.0F;
  h.normal[face / 2U] = (face & 1U) != 0U ? 1.0F : -1.0F;
  h.bound = c->limit;
  return h;
}

/* The most violated constraint at a, or what there is none after: the number of all. */
static uint32_t worst(const constraints* c, const float a[3]) {
  const uint32_t all = c->count + 6U;
  uint32_t found = all;
  float most = ALULA_HALF_SPACE_TOLERANCE;
  for (uint32_t i = 0; i < c->count; ++i) {
    const float excess = dot(c->row[i].normal, a) - (c->row[i].bound + c->relaxed);
    if (excess > most) most = excess, found = i;
  }
  for (uint32_t axis = 0; axis < 3U; ++axis) {
    const float above = a[axis] - c->limit, below = -a[axis] - c->limit;
    if (above > most) most = above, found = c->count + 2U * axis + 1U;
    if (below > most) most = below, found = c->count + 2U * axis;
  }
  return found;
}

/* Multipliers of the projection of a_0 on the planes of one, two or three constraints; 0 when they are parallel. */
static int multipliers(const alula_half_space* h, uint32_t size, const float a0[3], float mu[3]) {
  float r[3];
  for (uint32_t i = 0; i < size; ++i) r[i] = dot(h[i].normal, a0) - h[i].bound;
  if (size == 1U) {
    mu[0] = r[0];
    return 1;
  }
  const float xy = dot(h[0].normal, h[1].normal);
  if (size == 2U) {
    const float det = 1.0F - xy * xy;
    if (!(det > DEGENERATE)) return 0;
    mu[0] = (r[0] - xy * r[1]) / det;
    mu[1] = (r[1] - xy * r[0]) / det;
    return 1;
  }
  const float xz = dot(h[0].normal, h[2].normal), yz = dot(h[1].normal, h[2].normal);
  const float c0 = 1.0F - yz * yz, c1 = xz * yz - xy, c2 = xy * yz - xz; /* cofactors of the first row */
  const float det = c0 + xy * c1 + xz * c2;
  if (!(det > DEGENERATE)) return 0;
  const float d1 = 1.0F - xz * xz, d2 = xy * xz - yz, e2 = 1.0F - xy * xy;
  mu[0] = (c0 * r[0] + c1 * r[1] + c2 * r[2]) / det;
  mu[1] = (c1 * r[0] + d1 * r[1] + d2 * r[2]) / det;
  mu[2] = (c2 * r[0] + d2 * r[1] + e2 * r[2]) / det;
  return 1;
}

/* Projects a_0 on what `basis` and `added` allow, `added` being active there. The subset that is then active
 * replaces the basis; 0 when nothing is allowed. */
static int exchange(const constraints* c, uint32_t added, const float a0[3], float a[3], uint32_t basis[4],
                    uint32_t* size) {
  /* subsets of a basis of up to three beside the added one, small ones first */
  static const uint8_t subset[7] = {0U, 1U, 2U, 4U, 3U, 5U, 6U};
  alula_half_space h[4];
  const uint32_t old = *size;
  for (uint32_t i = 0; i < old; ++i) h[i] = constraint(c, basis[i]);
  h[3] = constraint(c, added);
  for (uint32_t s = 0; s < 7U; ++s) {
    if ((subset[s] >> old) != 0U) continue;
    alula_half_space active[3];
    uint32_t which[3], n = 1U;
    active[0] = h[3];
    which[0] = added;
    for (uint32_t i = 0; i < old; ++i) {
      if ((subset[s] >> i & 1U) == 0U) continue;
      active[n] = h[i];
      which[n] = basis[i];
      ++n;
    }
    float mu[3];
    if (!multipliers(active, n, a0, mu)) continue;
    int good = 1;
    for (uint32_t i = 0; i < n; ++i) good = good && mu[i] >= 0.0F;
    if (!good) continue;
    float x[3] = {a0[0], a0[1], a0[2]};
    for (uint32_t i = 0; i < n; ++i)
      for (int k = 0; k < 3; ++k) x[k] -= mu[i] * active[i].normal[k];
    for (uint32_t i = 0; i < old && good; ++i) good = dot(h[i].normal, x) - h[i].bound <= ALULA_HALF_SPACE_TOLERANCE;
    if (!good) continue;
    for (int k = 0; k < 3; ++k) a[k] = x[k];
    for (uint32_t i = 0; i < n; ++i) basis[i] = which[i];
    *size = n;
    return 1;
  }
  return 0;
}

static void close_result(const constraints* c, const float a[3], alula_projection* result) {
  for (int k = 0; k < 3; ++k) result->a[k] = clipped(a[k], c->limit);
  result->violation = -FLT_MAX;
  for (uint32_t i = 0; i < c->count; ++i) {
    const float excess = dot(c->row[i].normal, result->a) - c->row[i].bound;
    if (!(excess <= result->violation)) result->violation = excess;
  }
  result->feasible = result->violation <= 3.0F * ALULA_HALF_SPACE_TOLERANCE;
}

static int project(const constraints* c, const float a0[3], alula_projection* result) {
  float a[3] = {a0[0], a0[1], a0[2]};
  uint32_t size = 0U, steps = 0U;
  int solved = 0;
  for (; steps < ALULA_PROJECTION_STEPS; ++steps) {
    const uint32_t added = worst(c, a);
    if (added == c->count + 6U) {
      solved = 1;
      break;
    }
    if (!exchange(c, added, a0, a, result->basis, &size)) {
      result->basis[size++] = added;
      break;
    }
  }
  result->basis_count = size;
  result->iterations = steps;
  close_result(c, a, result);
  return solved;
}

void alula_project_exact(const alula_half_space* row, uint32_t count, float limit, const float a0[3],
                         alula_projection* result) {
  const constraints c = {row, count, limit, 0.0F};
  result->feasible = project(&c, a0, result) && result->feasible;
}

void alula_project_gauss_southwell(const alula_half_space* row, uint32_t count, float limit, float omega,
                                   uint32_t iterations, const float a0[3], alula_projection* result) {
  const constraints c = {row, count, limit, 0.0F};
  float a[3];
  for (int k = 0; k < 3; ++k) a[k] = clipped(a0[k], limit);
  result->iterations = 0U;
  result->basis_count = 0U;
  while (result->iterations < iterations) {
    uint32_t found = count;
    float most = 0.0F;
    for (uint32_t i = 0; i < count; ++i) {
      const float excess = dot(row[i].normal, a) - row[i].bound;
      if (excess > most) most = excess, found = i;
    }
    if (found == count) break;
    for (int k = 0; k < 3; ++k) a[k] = clipped(a[k] - omega * most * row[found].normal[k], limit);
    ++result->iterations;
  }
  close_result(&c, a, result);
}

void alula_project_least_violation(const alula_half_space* row, uint32_t count, float limit, const float a0[3],
                                   alula_projection* result) {
  constraints c = {row, count, limit, 0.0F};
  if (project(&c, a0, result) && result->feasible) return;
  uint32_t steps = result->iterations;
  float cut[3];
  for (int k = 0; k < 3; ++k) cut[k] = clipped(a0[k], limit);
  close_result(&c, cut, result); /* holds with its own violation */
  result->basis_count = 0U;
  float high = result->violation, low = 0.0F;
  for (int i = 0; i < BISECTIONS; ++i) {
    alula_projection tried;
    c.relaxed = low + 0.5F * (high - low);
    const int solved = project(&c, a0, &tried);
    steps += tried.iterations;
    if (solved) {
      *result = tried;
      high = c.relaxed;
    } else {
      low = c.relaxed;
    }
  }
  result->feasible = result->violation <= 3.0F * ALULA_HALF_SPACE_TOLERANCE;
  result->iterations = steps;
}
