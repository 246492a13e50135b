#include "chord_rows.h"
#include "polytope_walk.h"
#include "sorted.h"
#include "vector.h"

#define LONGEST_LAG_S 5.0F
#define MOST_PASSES 16          /* over the planes of a hull; each raises the lower bound of D_k */
#define RETURN_GAIN 2.0F        /* times 1 / lag */
#define DOWN (-0.1F)            /* z of a normal that points down */
#define FLAT 1.0e-5F            /* length of a normal without a direction */
#define ROUNDING 1.0e-5F        /* more than the relative rounding of sums of a few numbers */
#define SPEED_TOLERANCE 1.0001F /* of the result */
#define FENCE_ROUNDING 4.8e-7F  /* more than the relative rounding of a face's value */

/* An affine function n . s - d with its values at the ends of the chord, each at most the true one. */
typedef struct {
  float normal[3], at_p, at_q;
} affine;

static affine plane_at(const float* plane, const float p[3], const float q[3]) {
  const affine a = {{plane[0], plane[1], plane[2]}, alula_plane_value(plane, p), alula_plane_value(plane, q)};
  return a;
}

/* The convex combination of a falling and a rising function that is constant along the chord. */
static affine constant_of(const affine* falling, const affine* rising) {
  const float fall = falling->at_p - falling->at_q, rise = rising->at_q - rising->at_p;
  const float part = rise / (fall + rise); /* of `falling`, in (0, 1) */
  affine a;
  for (int i = 0; i < 3; ++i) a.normal[i] = part * falling->normal[i] + (1.0F - part) * rising->normal[i];
  a.at_p = part * falling->at_p + (1.0F - part) * rising->at_p;
  a.at_q = part * falling->at_q + (1.0F - part) * rising->at_q;
  return a;
}

static float least_of(const affine* a) { return a->at_p < a->at_q ? a->at_p : a->at_q; }

/* The plane with the largest value at p (or at q), of equals the one with the largest at the other end. */
static affine largest_at(alula_polytope_work* work, const alula_walk* walk, const float p[3], const float q[3],
                         int at_q, int not_down) {
  const float* const end = walk->plane + 4U * walk->plane_count;
  work->planes += 2U * walk->plane_count;
  affine best = {{0.0F, 0.0F, 0.0F}, -FLT_MAX, -FLT_MAX};
  for (const float* plane = walk->plane; plane < end; plane += 4) {
    if (not_down && plane[2] < DOWN) continue;
    const affine a = plane_at(plane, p, q);
    const float here = at_q ? a.at_q : a.at_p, there = at_q ? a.at_p : a.at_q;
    const float most = at_q ? best.at_q : best.at_p, other = at_q ? best.at_p : best.at_q;
    if (here > most || (here == most && there > other)) best = a;
  }
  return best;
}

/* The affine function that is at least D_k on the chord and at most psi_k everywhere; a lower one if the passes end.
 *
 * Cutting planes: the functions of a falling and of a rising plane meet at a value of at most D_k. The largest plane
 * there replaces one of them until none is larger. */
static affine separating(alula_polytope_work* work, const alula_walk* walk, const float p[3], const float q[3],
                         float slack) {
  affine falling = largest_at(work, walk, p, q, 0, 0);
  if (!(falling.at_q < falling.at_p)) return falling; /* psi_k does not fall from p on */
  affine rising = largest_at(work, walk, p, q, 1, 0);
  if (!(rising.at_p < rising.at_q)) return rising;
  const float* const end = walk->plane + 4U * walk->plane_count;
  for (int pass = 0; pass < MOST_PASSES; ++pass) {
    const affine level = constant_of(&falling, &rising);
    const float fall = falling.at_p - falling.at_q, rise = rising.at_q - rising.at_p;
    const float theta = (falling.at_p - rising.at_p) / (fall + rise);
    const float* best = 0;
    float most = least_of(&level) + slack, s[3];
    for (int i = 0; i < 3; ++i) s[i] = p[i] + theta * (q[i] - p[i]);
    work->planes += walk->plane_count;
    for (const float* plane = walk->plane; plane < end; plane += 4) {
      const float value = alula_plane_value(plane, s);
      if (!(value > most)) continue;
      most = value;
      best = plane;
    }
    if (!best) return level;
    const affine a = plane_at(best, p, q);
    if (a.at_q < a.at_p) {
      falling = a;
    } else if (a.at_p < a.at_q) {
      rising = a;
    } else {
      return a;
    }
  }
  return constant_of(&falling, &rising);
}

/* Of the planes that p is outside of by r and q is not, the one that the chord crosses last. */
static affine entered(alula_polytope_work* work, const alula_walk* walk, const float p[3], const float q[3],
                      float r) {
  const float* const end = walk->plane + 4U * walk->plane_count;
  work->planes += 2U * walk->plane_count;
  affine last = {{0.0F, 0.0F, 0.0F}, -FLT_MAX, -FLT_MAX};
  float latest = -1.0F;
  for (const float* plane = walk->plane; plane < end; plane += 4) {
    const affine a = plane_at(plane, p, q);
    if (!(a.at_p >= r && a.at_q < r)) continue;
    const float theta = (a.at_p - r) / (a.at_p - a.at_q);
    if (theta > latest) {
      latest = theta;
      last = a;
    }
  }
  return last;
}

/* Adds a row to those of the tick, which are sorted by what they spare; the least of those left out is in *left. */
static void add(alula_chord* chord, const float normal[3], float bound, float spare, float* left) {
  if (chord->count == ALULA_CHORD_ROWS) {
    const float last = chord->spare[ALULA_CHORD_ROWS - 1U];
    if (!(spare < last)) {
      if (spare < *left) *left = spare;
      return;
    }
    if (last < *left) *left = last;
    --chord->count;
  }
  const uint32_t at = insert_sorted(chord->spare, chord->count, spare);
  for (uint32_t i = chord->count++; i > at; --i) chord->row[i] = chord->row[i - 1U];
  for (int i = 0; i < 3; ++i) chord->row[at].normal[i] = normal[i];
  chord->row[at].bound = bound;
}

/* Adds the row of an affine function that is positive on this side; 0 for one without a direction. */
static int bind(alula_chord* chord, const affine* a, float spare, float r, float* left) {
  const alula_polytope_cbf_config* c = &chord->hulls.config;
  float bound = c->beta * spare;
  if (spare < 0.0F) {
    const float gain = RETURN_GAIN > c->beta * chord->lag_s ? RETURN_GAIN / chord->lag_s : c->beta;
    bound = (a->at_q - r) * (gain * c->dt_s < 1.0F ? gain : 1.0F / c->dt_s); /* 1 / 0 is not flown */
    if (bound > 0.0F) bound = c->beta * (a->at_q - r);                       /* q is outside of that plane */
    if (bound < -0.5F * c->v_max) bound = -0.5F * c->v_max;
  }
  const float length = norm(a->normal);
  if (!(length > FLAT)) return 0;
  const float outward[3] = {-a->normal[0] / length, -a->normal[1] / length, -a->normal[2] / length};
  add(chord, outward, bound / length, spare, left);
  return 1;
}

static int cannot_bind(const alula_chord* chord, float spare) {
  const alula_polytope_cbf_config* c = &chord->hulls.config;
  return c->beta * spare >= c->v_max * ALULA_SPEED_ROUNDING;
}

/* The row of a hull; 0 for one without a direction. */
static int consider(alula_chord* chord, const alula_walk* walk, const float p[3], const float q[3], float hard,
                    int is_taking_off, float* left) {
  const float slack = chord->hulls.map.slack_m, r = chord->hulls.config.radius_m + slack;
  alula_polytope_work* work = &chord->hulls.work;
  affine a = separating(work, walk, p, q, slack);
  const float spare = least_of(&a) - r;
  if (cannot_bind(chord, spare)) return 1;
  if (spare < 0.0F)
    a = hard >= r ? entered(work, walk, p, q, r) : largest_at(work, walk, p, q, 0, is_taking_off && hard <= 0.0F);
  return bind(chord, &a, spare, r, left);
}

/* A face n . s <= d of the fence, seen from inside: d - n . s. */
static void consider_face(alula_chord* chord, const float n[3], float d, const float p[3], const float q[3],
                          float* left) {
  const float slack = chord->hulls.map.slack_m + FENCE_ROUNDING * (absolute(d) + chord->hulls.map.extent_m);
  const float r = chord->hulls.config.radius_m + slack;
  const affine a = {{-n[0], -n[1], -n[2]}, d - dot(n, p), d - dot(n, q)};
  const float spare = least_of(&a) - r;
  if (!cannot_bind(chord, spare)) (void)bind(chord, &a, spare, r, left);
}

static void consider_fence(alula_chord* chord, const alula_fence* fence, const float p[3], const float q[3],
                           float* left) {
  for (int i = 0; fence->has_box && i < 3; ++i) {
    float n[3] = {0.0F, 0.0F, 0.0F};
    n[i] = -1.0F;
    consider_face(chord, n, -fence->lower[i], p, q, left);
    n[i] = 1.0F;
    consider_face(chord, n, fence->upper[i], p, q, left);
  }
  for (uint32_t l = 0; l < fence->face_count; ++l)
    consider_face(chord, fence->face[l], fence->face[l][3], p, q, left);
}

void alula_chord_limit(float u[3], float most) {
  float largest = 0.0F; /* u may be so large that its square overflows */
  for (int i = 0; i < 3; ++i)
    if (absolute(u[i]) > largest) largest = absolute(u[i]);
  if (!(largest > 0.0F)) return;
  const float part[3] = {u[0] / largest, u[1] / largest, u[2] / largest};
  const float length = norm(part);
  if (length * largest <= most) return;
  for (int i = 0; i < 3; ++i) u[i] = part[i] * (most / length);
}

static int is_within(const float x[3], float extent) {
  for (int i = 0; i < 3; ++i)
    if (!(absolute(x[i]) <= extent)) return 0; /* also NaN */
  return 1;
}

static void stop(alula_polytope_result* result) {
  for (int i = 0; i < 3; ++i) result->u[i] = 0.0F;
  result->fraction = 0.0F;
}

void alula_chord_clear(alula_polytope_result* result) {
  stop(result);
  result->margin_m = result->hard_margin_m = -FLT_MAX;
  result->active = ALULA_NO_HULL;
}

/* Collects the rows of all hulls and faces that matter; 0 for a damaged map or a hull without a direction. */
static int collect(alula_chord* chord, const alula_fence* fence, const float p[3], const float q[3],
                   int is_taking_off, alula_polytope_result* result, float* left) {
  static const alula_polytope_work NONE = {0U, 0U, 0U, 0U, 0U};
  alula_polytope_cbf* hulls = &chord->hulls;
  const alula_polytope_cbf_config* c = &hulls->config;
  const float d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
  const float reach = c->radius_m + c->v_max / c->beta + norm(d) + 4.0F * hulls->map.slack_m;
  const alula_walk_rule rule = {reach * (1.0F + ROUNDING), ALULA_NO_HULL, 0.0F, 0.0F, -FLT_MAX};
  alula_walk walk;
  float hard;
  int has_directions = 1;
  hulls->work = NONE;
  hulls->used_before = hulls->used;
  hulls->used = 0U;
  result->margin_m = result->hard_margin_m = reach - c->radius_m;
  alula_walk_forget(hulls);
  if (fence) consider_fence(chord, fence, p, q, left);
  if (hulls->map.hull_count > 0U) {
    alula_walk_begin(hulls, &walk);
    while (alula_walk_next(hulls, &rule, p, &walk)) {
      if (!alula_walk_planes(hulls, &rule, p, &walk, &hard)) continue;
      if (!consider(chord, &walk, p, q, hard, is_taking_off, left)) has_directions = 0;
      if (hard - c->radius_m < result->hard_margin_m) {
        result->hard_margin_m = hard - c->radius_m;
        result->active = walk.hull;
      }
    }
  }
  if (chord->count > 0U && chord->spare[0] < result->margin_m) result->margin_m = chord->spare[0];
  return has_directions && !hulls->is_damaged;
}

int alula_chord_find_rows(alula_chord* chord, const alula_fence* fence, const float p[3], const float v[3],
                          int is_taking_off, float* speed, alula_polytope_result* result) {
  const alula_polytope_cbf_config* c = &chord->hulls.config;
  float q[3], left = FLT_MAX;
  for (int i = 0; i < 3; ++i) q[i] = p[i] + chord->lag_s * v[i];
  chord->count = chord->soft = 0U;
  *speed = c->v_max;
  if (!is_within(p, chord->hulls.map.extent_m) || !is_within(q, chord->hulls.map.extent_m)) return 0;
  if (!collect(chord, fence, p, q, is_taking_off, result, &left)) return 0;
  if (left < FLT_MAX) {
    if (!(left > 0.0F)) return 0; /* more hulls in the margin than rows */
    if (c->beta * left < *speed) *speed = c->beta * left;
  }
  while (chord->soft < chord->count && chord->spare[chord->soft] < 0.0F) ++chord->soft;
  return 1;
}

void alula_chord_project(const alula_chord* chord, const float wanted[3], float speed,
                         alula_polytope_result* result) {
  float within[3] = {wanted[0], wanted[1], wanted[2]};
  alula_projection found;
  alula_chord_limit(within, speed);
  alula_project_least_violation(chord->row, chord->count, chord->soft, speed, within, &found);
  alula_chord_put(chord, found.a, speed, result);
}

void alula_chord_put(const alula_chord* chord, const float found[3], float speed, alula_polytope_result* result) {
  result->fraction = 1.0F;
  for (int i = 0; i < 3; ++i) result->u[i] = found[i];
  const float length = norm(result->u);
  if (length > speed) {
    result->fraction = speed / length;
    for (int i = 0; i < 3; ++i) result->u[i] *= result->fraction;
  }
  for (uint32_t i = chord->soft; i < chord->count; ++i) { /* zero satisfies these rows */
    if (dot(chord->row[i].normal, result->u) <= chord->row[i].bound) continue;
    stop(result);
    break;
  }
}

alula_filter_status alula_chord_status(const alula_chord* chord, const float u_nom[3],
                                       alula_polytope_result* result) {
  if (!is_within(result->u, SPEED_TOLERANCE * chord->hulls.config.v_max)) {
    stop(result);
    return ALULA_FILTER_REFUSED;
  }
  if (chord->soft > 0U) return ALULA_FILTER_RECOVERING;
  int is_same = 1;
  for (int i = 0; i < 3; ++i)
    if (result->u[i] != u_nom[i]) is_same = 0;
  if (is_same) return ALULA_FILTER_OK;
  return result->fraction < 1.0F ? ALULA_FILTER_SHORTENED : ALULA_FILTER_FILTERED;
}

alula_status alula_chord_open(alula_chord* chord, const alula_map* image, float extent_m,
                              const alula_polytope_cbf_config* config, float lag_s) {
  if (!chord) return ALULA_BAD_POINTER;
  if (!(lag_s >= 0.0F && lag_s <= LONGEST_LAG_S)) return ALULA_BAD_PARAMETER;
  const alula_status status = alula_polytope_cbf_open(&chord->hulls, image, extent_m, config);
  if (status != ALULA_READY) return status;
  alula_walk_forget(&chord->hulls);
  chord->lag_s = lag_s;
  chord->count = chord->soft = 0U;
  return ALULA_READY;
}

alula_filter_status alula_chord_filter(alula_chord* chord, const float x[3], const float v[3], const float u_nom[3],
                                       int is_taking_off, alula_polytope_result* result) {
  float speed;
  if (!result) return ALULA_FILTER_REFUSED;
  alula_chord_clear(result);
  if (!chord || !x || !v || !u_nom) return ALULA_FILTER_REFUSED;
  if (!is_within(u_nom, FLT_MAX)) return ALULA_FILTER_REFUSED;
  if (!alula_chord_find_rows(chord, 0, x, v, is_taking_off, &speed, result)) return ALULA_FILTER_REFUSED;
  alula_chord_project(chord, u_nom, speed, result);
  return alula_chord_status(chord, u_nom, result);
}
