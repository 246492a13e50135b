#include "alula_half_spaces.h"

#include "vector.h"

#define PARALLEL 1.0e-12F /* squared sine below which constraints count as parallel */
#define FARTHEST 16.0F    /* in limits: a_0 is clipped to this */
#define REFINEMENTS 2
#define RELAXATIONS 24 /* iterations for the minimum violation */

typedef struct {
  const alula_half_space* row;
  uint32_t count, soft; /* the first `soft` rows are relaxed */
  float limit;
  float tolerance; /* a quarter of the tightening of rows: then they hold after rounding and clipping */
  float relaxed;
} constraints;

/* a x b. For nearly parallel unit vectors it uses the difference, which is exact: a x b = a x (b -+ a). */
static void cross(const float a[3], const float b[3], float c[3]) {
  const float along = dot(a, b), sign = along > 0.5F ? -1.0F : (along < -0.5F ? 1.0F : 0.0F);
  const float d[3] = {b[0] + sign * a[0], b[1] + sign * a[1], b[2] + sign * a[2]};
  c[0] = a[1] * d[2] - a[2] * d[1];
  c[1] = a[2] * d[0] - a[0] * d[2];
  c[2] = a[0] * d[1] - a[1] * d[0];
}

static float bound_of(const constraints* c, uint32_t i) {
  return c->row[i].bound - 4.0F * c->tolerance + (i < c->soft ? c->relaxed : 0.0F);
}

static alula_half_space constraint(const constraints* c, uint32_t i) {
  alula_half_space h;
  if (i < c->count) {
    h = c->row[i];
    h.bound = bound_of(c, i);
    return h;
  }
  const uint32_t face = i - c->count;
  h.normal[0] = h.normal[1] = h.normal[2] = 0.0F;
  h.normal[face / 2U] = (face & 1U) != 0U ? 1.0F : -1.0F;
  h.bound = c->limit;
  return h;
}

/* The most violated constraint at a; if there is none, the number of constraints. */
static uint32_t worst(const constraints* c, const float a[3]) {
  uint32_t found = c->count + 6U;
  float most = c->tolerance;
  for (uint32_t i = 0; i < c->count; ++i) {
    const float excess = dot(c->row[i].normal, a) - bound_of(c, i);
    if (excess > most) most = excess, found = i;
  }
  for (uint32_t axis = 0; axis < 3U; ++axis) {
    const float above = a[axis] - c->limit, below = -a[axis] - c->limit;
    if (above > most) most = above, found = c->count + 2U * axis + 1U;
    if (below > most) most = below, found = c->count + 2U * axis;
  }
  return found;
}

/* Vectors d_i in the span of the normals with d_i . n_j = 1 for i = j and 0 otherwise; 0 when parallel. */
static int dual_vectors(const float* const n[3], uint32_t size, float d[3][3]) {
  if (size == 1U) {
    const float square = dot(n[0], n[0]);
    for (int k = 0; k < 3; ++k) d[0][k] = n[0][k] / square;
    return 1;
  }
  float scale;
  if (size == 2U) {
    float c[3];
    cross(n[0], n[1], c);
    scale = dot(c, c);
    if (!(scale > PARALLEL)) return 0;
    cross(n[1], c, d[0]);
    cross(c, n[0], d[1]);
  } else {
    cross(n[1], n[2], d[0]);
    cross(n[2], n[0], d[1]);
    cross(n[0], n[1], d[2]);
    uint32_t narrow = 0U, wide = 0U; /* the pair with the smallest angle gives the most accurate volume */
    for (uint32_t i = 1; i < 3U; ++i) {
      if (dot(d[i], d[i]) < dot(d[narrow], d[narrow])) narrow = i;
      if (dot(d[i], d[i]) > dot(d[wide], d[wide])) wide = i;
    }
    scale = dot(n[narrow], d[narrow]);
    if (!(scale * scale > PARALLEL * dot(d[wide], d[wide]))) return 0;
  }
  for (uint32_t i = 0; i < size; ++i)
    for (int k = 0; k < 3; ++k) d[i][k] /= scale;
  return 1;
}

/* Projects a_0 on the planes of up to three constraints; 0 when they are parallel or a multiplier has the wrong
 * sign by more than the rounding of x in units of the tolerance. A smaller error means that dropping the constraint
 * would violate it by only that much. */
static int touch(const alula_half_space* h, uint32_t size, const float a0[3], float tolerance, float x[3]) {
  const float* const n[3] = {h[0].normal, h[size > 1U ? 1 : 0].normal, h[size > 2U ? 2 : 0].normal};
  float d[3][3];
  if (!dual_vectors(n, size, d)) return 0;
  for (int k = 0; k < 3; ++k) x[k] = a0[k];
  for (int pass = 0; pass <= REFINEMENTS; ++pass) {
    float r[3];
    for (uint32_t i = 0; i < size; ++i) r[i] = dot(n[i], x) - h[i].bound;
    for (uint32_t i = 0; i < size; ++i)
      for (int k = 0; k < 3; ++k) x[k] -= r[i] * d[i][k];
  }
  const float way[3] = {a0[0] - x[0], a0[1] - x[1], a0[2] - x[2]};
  for (uint32_t i = 0; i < size; ++i) {
    const float push = dot(d[i], way);
    if (push < -0.25F * tolerance * dot(d[i], d[i])) return 0;
  }
  return 1;
}

/* Projects a_0 on the set that `basis` and `added` allow, with `added` active. The active subset replaces the basis;
 * 0 when the set is empty. */
static int exchange(const constraints* c, uint32_t added, const float a0[3], float a[3], uint32_t basis[4],
                    uint32_t* size) {
  /* subsets of a basis of up to three beside the added one, small ones first */
  static const uint8_t subset[7] = {0U, 1U, 2U, 4U, 3U, 5U, 6U};
  alula_half_space h[4];
  const uint32_t old = *size;
  for (uint32_t i = 0; i < old; ++i) h[i] = constraint(c, basis[i]);
  h[old] = constraint(c, added);
  for (uint32_t s = 0; s < 7U; ++s) {
    if ((subset[s] >> old) != 0U) continue;
    alula_half_space active[3];
    uint32_t which[3], n = 1U;
    active[0] = h[old];
    which[0] = added;
    for (uint32_t i = 0; i < old; ++i) {
      if ((subset[s] >> i & 1U) == 0U) continue;
      active[n] = h[i];
      which[n] = basis[i];
      ++n;
    }
    float x[3] = {0.0F, 0.0F, 0.0F};
    int good = touch(active, n, a0, c->tolerance, x);
    /* Edges of narrow wedges may be far away, where rounding is larger, before a face of the box is added. */
    const float bears = c->tolerance + 4.0F * FLT_EPSILON * (absolute(x[0]) + absolute(x[1]) + absolute(x[2]));
    for (uint32_t i = 0; i <= old && good; ++i) good = dot(h[i].normal, x) - h[i].bound <= bears;
    if (!good) continue;
    for (int k = 0; k < 3; ++k) a[k] = x[k];
    for (uint32_t i = 0; i < n; ++i) basis[i] = which[i];
    *size = n;
    return 1;
  }
  return 0;
}

static void close_result(const constraints* c, const float a[3], float bears, alula_projection* result) {
  for (int k = 0; k < 3; ++k) result->a[k] = clipped(a[k], c->limit);
  result->violation = -FLT_MAX;
  for (uint32_t i = 0; i < c->count; ++i) {
    const float excess = dot(c->row[i].normal, result->a) - c->row[i].bound;
    if (!(excess <= result->violation)) result->violation = excess;
  }
  result->feasible = result->violation <= bears;
}

static int project(const constraints* c, const float a0[3], alula_projection* result) {
  float start[3], a[3];
  for (int k = 0; k < 3; ++k) a[k] = start[k] = clipped(a0[k], FARTHEST * c->limit);
  uint32_t size = 0U, steps = 0U;
  int solved = 0;
  for (; steps < ALULA_PROJECTION_STEPS; ++steps) {
    const uint32_t added = worst(c, a);
    if (added == c->count + 6U) {
      solved = 1;
      break;
    }
    if (!exchange(c, added, start, a, result->basis, &size)) {
      result->basis[size++] = added;
      break;
    }
  }
  result->basis_count = size;
  result->iterations = steps;
  close_result(c, a, 0.0F, result);
  return solved;
}

static constraints all_of(const alula_half_space* row, uint32_t count, uint32_t soft, float limit) {
  const constraints c = {row, count, soft, limit, 0.25F * ALULA_HALF_SPACE_MARGIN * limit, 0.0F};
  return c;
}

/* Nonzero if a_0 needs no change; then it is returned bit by bit. */
static int stays(const constraints* c, const float a0[3], alula_projection* result) {
  result->iterations = result->basis_count = 0U;
  close_result(c, a0, 0.0F, result);
  return result->feasible && result->a[0] == a0[0] && result->a[1] == a0[1] && result->a[2] == a0[2];
}

void alula_project_exact(const alula_half_space* row, uint32_t count, float limit, const float a0[3],
                         alula_projection* result) {
  const constraints c = all_of(row, count, 0U, limit);
  if (stays(&c, a0, result)) return;
  result->feasible = project(&c, a0, result) && result->feasible;
}

void alula_project_gauss_southwell(const alula_half_space* row, uint32_t count, float limit, float omega,
                                   uint32_t iterations, const float a0[3], alula_projection* result) {
  const constraints c = all_of(row, count, 0U, limit);
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
  close_result(&c, a, ALULA_HALF_SPACE_MARGIN * limit, result);
}

/* Lower bound on the relaxation of a basis of four constraints that no point satisfies together: with
 * y >= 0 and sum y_i n_i = 0, r >= -y . b / (sum of y_i of the soft ones). -FLT_MAX when there is no bound. */
static float least_relaxation(const constraints* c, const alula_projection* tried) {
  static const uint8_t others[4][3] = {{1U, 2U, 3U}, {0U, 3U, 2U}, {0U, 1U, 3U}, {0U, 2U, 1U}};
  if (tried->basis_count != 4U) return -FLT_MAX;
  alula_half_space h[4];
  float y[4], product = 0.0F, weight = 0.0F, sign = 0.0F;
  for (uint32_t i = 0; i < 4U; ++i) h[i] = constraint(c, tried->basis[i]);
  for (uint32_t i = 0; i < 4U; ++i) { /* Cramer's rule */
    float n[3];
    cross(h[others[i][1]].normal, h[others[i][2]].normal, n);
    y[i] = dot(h[others[i][0]].normal, n);
    sign += y[i];
  }
  for (uint32_t i = 0; i < 4U; ++i) {
    if (sign < 0.0F) y[i] = -y[i];
    if (y[i] < 0.0F) return -FLT_MAX;
    product -= y[i] * h[i].bound;
    if (tried->basis[i] < c->soft) weight += y[i];
  }
  return weight > 1.0e-6F ? c->relaxed + product / weight : -FLT_MAX;
}

/* Finds the minimum relaxation of the soft rows; 0 when the other rows contradict each other in the box. */
static int relax(constraints c, const float a0[3], alula_projection* result) {
  float cut[3], most = 0.0F;
  for (int k = 0; k < 3; ++k) cut[k] = clipped(a0[k], c.limit);
  for (uint32_t i = 0; i < c.soft; ++i)
    if (-c.row[i].bound > most) most = -c.row[i].bound;
  const float enough = most + 2.0F * c.limit + 8.0F * c.tolerance; /* with it, no soft row cuts the box */
  alula_projection tried;
  int found = project(&c, a0, result);
  uint32_t steps = result->iterations;
  if (found && result->feasible) return 1;
  float low = 0.0F, high = FLT_MAX, next = least_relaxation(&c, result); /* low: too little, high: enough */
  close_result(&c, cut, 0.0F, result);
  result->basis_count = 0U;
  found = 0;
  for (int i = 0; i < RELAXATIONS && high - low > 4.0F * c.tolerance; ++i) {
    const float half = low + 0.5F * (high - low);
    c.relaxed = next > low ? next + 2.0F * c.tolerance : (found ? half : enough);
    if (!(c.relaxed < high)) c.relaxed = half;
    const int solved = project(&c, a0, &tried);
    steps += tried.iterations;
    if (solved) {
      *result = tried;
      found = 1;
      high = c.relaxed;
      next = low;
    } else {
      if (!found && !(c.relaxed < enough)) break;
      low = c.relaxed;
      next = least_relaxation(&c, &tried);
    }
  }
  result->iterations = steps;
  return found;
}

void alula_project_least_violation(const alula_half_space* row, uint32_t count, uint32_t soft, float limit,
                                   const float a0[3], alula_projection* result) {
  const constraints c = all_of(row, count, soft, limit);
  if (stays(&c, a0, result) || relax(c, a0, result) || soft == count) return;
  (void)relax(all_of(row, count, count, limit), a0, result);
}
