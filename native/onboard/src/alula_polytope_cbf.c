#include "polytope_walk.h"
#include "vector.h"

#define FLAT 1.0e-6F           /* squared gradient below which the escape direction is undefined */
#define DIVISION_ERROR 2.4e-7F /* 4 units in the last place: two subtractions and a division */
#define SPEED_TOLERANCE 1.0001F
#define ROUNDING 1.0e-5F /* upper bound on the relative rounding of sums of a few numbers */

/* s_k, given psi_k and the planes; its gradient too unless that is null. */
static float smooth_value(alula_polytope_cbf* cbf, const alula_walk* walk, const float x[3], float hard,
                          float* gradient) {
  const float* const end = walk->plane + 4U * walk->plane_count;
  const float at[3] = {x[0], x[1], x[2]}, kappa = cbf->config.kappa;
  float sum = 0.0F, slope[3] = {0.0F, 0.0F, 0.0F};
  for (const float* plane = walk->plane; plane < end; plane += 4) {
    const float exponent = kappa * (alula_plane_value(plane, at) - hard);
    if (exponent < -ALULA_WALK_CUTOFF) continue;
    const float weight = alula_expf(exponent);
    ++cbf->work.exponentials;
    sum += weight;
    if (!gradient) continue;
    for (int i = 0; i < 3; ++i) slope[i] += weight * plane[i];
  }
  if (gradient)
    for (int i = 0; i < 3; ++i) gradient[i] = slope[i] / sum;
  const float raised = alula_logf(sum) * cbf->inverse_kappa;
  if (cbf->config.smoothing == ALULA_SMOOTHING_PAPER) return hard + raised;
  const float down = alula_walk_lowering(cbf, walk->plane_count);
  return hard - (raised < down ? down - raised : 0.0F);
}

static int inside_extent(const alula_polytope_map* map, const float x[3]) {
  for (int i = 0; i < 3; ++i) {
    if (!(x[i] >= -map->extent_m && x[i] <= map->extent_m)) return 0; /* also NaN */
  }
  return 1;
}

/* Lists the hulls that matter where psi and the minimum s_k are at most `base`: hulls with an s_k that may be near
 * it, and hulls within reach of a step. Adds more than the rounding of the compared values; u exceeds v_max by less.
 */
static void gather(alula_polytope_cbf* cbf, const float x[3], float base) {
  const alula_polytope_cbf_config* c = &cbf->config;
  const float kept = c->radius_m + cbf->map.slack_m;
  const float smooth = base + cbf->max_lowering_m + cbf->cutoff_m;
  const float step = (kept > base ? kept : base) + c->v_max * c->dt_s + cbf->map.slack_m;
  const float farthest = smooth > step ? smooth : step;
  const float rounding = absolute(base) + cbf->max_lowering_m + cbf->cutoff_m + kept + c->v_max * c->dt_s;
  alula_walk_gather(cbf, farthest + ROUNDING * rounding, x);
  cbf->near_base_m = base;
}

/* A lower bound of s where psi is `hard`. */
static float smooth_bound(const alula_polytope_cbf* cbf, float hard) {
  return (hard - cbf->max_lowering_m) - cbf->crowd_m;
}

/* Nonzero if the row could bind: it does not while beta (s - r) >= v_max, because no gradient is longer than 1. */
static int could_bind(const alula_polytope_cbf* cbf, float smooth) {
  return cbf->config.beta * (smooth - cbf->config.radius_m) < cbf->config.v_max * ALULA_SPEED_ROUNDING;
}

/* Finds psi and the nearest hull. */
static void find_hard(alula_polytope_cbf* cbf, const float x[3], alula_polytope_value* value) {
  alula_walk walk;
  alula_walk_rule rule = {FLT_MAX, ALULA_NO_HULL, 0.0F, 0.0F, -FLT_MAX};
  const uint32_t guess = alula_walk_guess(cbf, x);
  float hard;
  alula_walk_to(cbf, guess, x, &walk);
  if (alula_walk_planes(cbf, &rule, x, &walk, &hard)) {
    rule.nearer = hard;
    rule.nearest = guess;
    if (could_bind(cbf, smooth_bound(cbf, hard))) gather(cbf, x, hard); /* one walk for all later steps */
  }
  alula_walk_begin(cbf, &walk);
  while (alula_walk_next(cbf, &rule, x, &walk)) {
    if (walk.hull == guess || !alula_walk_planes(cbf, &rule, x, &walk, &hard)) continue;
    if (hard < rule.nearer || (hard == rule.nearer && walk.hull < rule.nearest)) {
      rule.nearer = hard;
      rule.nearest = walk.hull;
    }
  }
  value->hard = rule.nearer;
  value->nearest = rule.nearest;
}

/* The minimum s_k. */
static float find_least(alula_polytope_cbf* cbf, const float x[3], const alula_polytope_value* value) {
  alula_walk walk;
  alula_walk_rule rule = {-FLT_MAX, ALULA_NO_HULL, cbf->max_lowering_m, FLT_MAX, 0.0F};
  float hard;
  alula_walk_to(cbf, value->nearest, x, &walk);
  if (alula_walk_planes(cbf, &rule, x, &walk, &hard)) rule.least = smooth_value(cbf, &walk, x, hard, 0);
  const float base = rule.least > value->hard ? rule.least : value->hard;
  if (cbf->near_count == ALULA_NO_LIST || base > cbf->near_base_m) gather(cbf, x, base);
  alula_walk_begin(cbf, &walk);
  while (alula_walk_next(cbf, &rule, x, &walk)) {
    if (walk.hull == value->nearest || !alula_walk_planes(cbf, &rule, x, &walk, &hard)) continue;
    const float smooth = smooth_value(cbf, &walk, x, hard, 0);
    if (smooth < rule.least) rule.least = smooth;
  }
  return rule.least;
}

/* s and its gradient, from all hulls with terms that count, in their order. */
static void find_smooth(alula_polytope_cbf* cbf, const float x[3], alula_polytope_value* value) {
  const float least = find_least(cbf, x, value);
  const alula_walk_rule rule = {-FLT_MAX, ALULA_NO_HULL, cbf->max_lowering_m, least, cbf->cutoff_m};
  alula_walk walk;
  float hard, sum = 0.0F;
  alula_walk_begin(cbf, &walk);
  while (alula_walk_next(cbf, &rule, x, &walk)) {
    if (!alula_walk_planes(cbf, &rule, x, &walk, &hard)) continue;
    float gradient[3];
    const float above = smooth_value(cbf, &walk, x, hard, gradient) - least;
    if (above > cbf->cutoff_m) continue;
    const float weight = alula_expf(-cbf->config.kappa * above);
    sum += weight;
    for (int i = 0; i < 3; ++i) value->gradient[i] += weight * gradient[i];
  }
  for (int i = 0; i < 3; ++i) value->gradient[i] /= sum;
  value->smooth = least - alula_logf(sum) * cbf->inverse_kappa;
}

/* Starts a call: computes psi, or returns a status for a position that is refused. */
static alula_status begin(alula_polytope_cbf* cbf, const float x[3], alula_polytope_value* value) {
  static const alula_polytope_work NONE = {0U, 0U, 0U, 0U, 0U};
  value->hard = value->smooth = FLT_MAX;
  value->gradient[0] = value->gradient[1] = value->gradient[2] = 0.0F;
  value->nearest = ALULA_NO_HULL;
  cbf->work = NONE;
  alula_walk_forget(cbf);
  cbf->used_before = cbf->used;
  cbf->used = 0U;
  if (!inside_extent(&cbf->map, x)) return ALULA_BAD_INPUT;
  if (cbf->map.hull_count > 0U) find_hard(cbf, x, value);
  return cbf->is_damaged ? ALULA_BAD_MAP : ALULA_READY;
}

alula_status alula_polytope_cbf_evaluate(alula_polytope_cbf* cbf, const float x[3], alula_polytope_value* value) {
  if (!cbf || !x || !value) return ALULA_BAD_POINTER;
  const alula_status status = begin(cbf, x, value);
  if (status != ALULA_READY || cbf->map.hull_count == 0U) return status;
  find_smooth(cbf, x, value);
  return cbf->is_damaged ? ALULA_BAD_MAP : ALULA_READY;
}

/* The fraction of the step from x to end that provably keeps psi_k >= least for all k, in [0, 1].
 *
 * Along the step each plane's value is linear, so hull k is entered between the last plane that
 * goes below the threshold and the first that comes back above it: the step is clear when that
 * interval is empty. The float values are at most the true ones at both ends, hence in between. */
static float clear_fraction(alula_polytope_cbf* cbf, const float x[3], const float end[3], float reach, float least) {
  const alula_walk_rule rule = {-FLT_MAX, ALULA_NO_HULL, reach, least, 0.0F};
  float fraction = 1.0F, hard;
  alula_walk walk;
  alula_walk_begin(cbf, &walk);
  while (alula_walk_next(cbf, &rule, x, &walk)) {
    if (!alula_walk_planes(cbf, &rule, x, &walk, &hard)) continue;
    const float threshold = hard < least ? hard : least; /* if already closer, do not come closer */
    const float* const after = walk.plane + 4U * walk.plane_count;
    float enter = 0.0F, leave = 2.0F;
    int separated = 0;
    for (const float* plane = walk.plane; plane < after && !separated; plane += 4) {
      const float from = alula_plane_value(plane, x);
      const float to = alula_plane_value(plane, end);
      if (from >= threshold && to >= threshold) {
        separated = 1;
      } else if (from >= threshold) {
        const float t = (from - threshold) / (from - to);
        if (t > enter) enter = t;
      } else if (to >= threshold) {
        const float t = (threshold - from) / (to - from);
        if (t < leave) leave = t;
      }
    }
    enter *= 1.0F - DIVISION_ERROR;
    leave *= 1.0F + DIVISION_ERROR;
    if (!separated && enter < leave && enter < fraction) fraction = enter;
  }
  return fraction;
}

/* Scales u down to the speed limit; nonzero when that changed it. */
static int limit_speed(float u[3], float v_max) {
  const float speed_squared = dot(u, u);
  if (speed_squared <= v_max * v_max * ALULA_SPEED_ROUNDING) return 0;
  float largest = 0.0F; /* u may be so large that its square overflows */
  for (int i = 0; i < 3; ++i) {
    const float size = u[i] < 0.0F ? -u[i] : u[i];
    if (size > largest) largest = size;
  }
  for (int i = 0; i < 3; ++i) u[i] /= largest;
  const float scale = v_max / __builtin_sqrtf(dot(u, u));
  for (int i = 0; i < 3; ++i) u[i] *= scale;
  return 1;
}

/* Drives out along the gradient, as fast as the row requires but within the speed limit. */
static alula_filter_status recover(const alula_polytope_cbf* cbf, const alula_polytope_value* value, float row,
                                   float u[3]) {
  const float square = dot(value->gradient, value->gradient);
  if (square < FLAT) {
    u[0] = u[1] = u[2] = 0.0F;
    return ALULA_FILTER_REFUSED;
  }
  const float norm = __builtin_sqrtf(square);
  const float wanted = row / norm;
  const float speed = wanted < cbf->config.v_max ? wanted : cbf->config.v_max;
  for (int i = 0; i < 3; ++i) u[i] = value->gradient[i] * (speed / norm);
  return ALULA_FILTER_RECOVERING;
}

/* The u with gradient . u >= row and |u| <= v_max that is nearest to the given one (which keeps the limit). */
static alula_filter_status project(const alula_polytope_cbf* cbf, const alula_polytope_value* value, float row,
                                   float u[3]) {
  const float* gradient = value->gradient;
  const float v_max = cbf->config.v_max;
  const float along = dot(gradient, u);
  if (along >= row) return ALULA_FILTER_OK;
  const float square = dot(gradient, gradient);
  if (row > 0.0F && row * row > square * v_max * v_max) return recover(cbf, value, row, u);
  if (!(square > FLT_MIN)) {
    u[0] = u[1] = u[2] = 0.0F; /* row <= 0: zero satisfies it */
    return ALULA_FILTER_FILTERED;
  }
  for (int i = 0; i < 3; ++i) u[i] += gradient[i] * ((row - along) / square);
  if (row > 0.0F && dot(u, u) > v_max * v_max * ALULA_SPEED_ROUNDING) {
    /* Both constraints bind: the nearest point of a circle keeps the part along the gradient. */
    float normal[3], tangent[3];
    for (int i = 0; i < 3; ++i) {
      normal[i] = gradient[i] * (row / square);
      tangent[i] = u[i] - normal[i];
    }
    const float room = v_max * v_max - dot(normal, normal);
    const float scale = room > 0.0F ? __builtin_sqrtf(room / dot(tangent, tangent)) : 0.0F;
    for (int i = 0; i < 3; ++i) u[i] = normal[i] + scale * tangent[i];
  }
  return ALULA_FILTER_FILTERED;
}

/* The fraction of the command u, held for dt from x, that keeps psi_k >= least for all k. */
static float checked(alula_polytope_cbf* cbf, const float x[3], const float u[3], float least) {
  float end[3];
  for (int i = 0; i < 3; ++i) end[i] = x[i] + u[i] * cbf->config.dt_s;
  const float reach = __builtin_sqrtf(dot(u, u)) * cbf->config.dt_s * ALULA_SPEED_ROUNDING + cbf->map.slack_m;
  return clear_fraction(cbf, x, end, reach, least);
}

static alula_filter_status check_step(alula_polytope_cbf* cbf, const float x[3], alula_filter_status status,
                                      alula_polytope_result* result) {
  result->fraction = checked(cbf, x, result->u, cbf->config.radius_m + cbf->map.slack_m);
  if (result->fraction >= 1.0F) return status;
  for (int i = 0; i < 3; ++i) result->u[i] *= result->fraction;
  return status == ALULA_FILTER_RECOVERING ? status : ALULA_FILTER_SHORTENED;
}

/* A step out must not lead deeper, into this hull or another. The gradient of s may lead deeper: it is a mean of
 * normals, of many near edges and for a small kappa. Then the normal of the plane that decides psi,
 * along which psi_k grows, may allow a longer step. */
static void check_recovery(alula_polytope_cbf* cbf, const float x[3], const alula_polytope_value* value,
                           alula_polytope_result* result) {
  result->fraction = checked(cbf, x, result->u, value->hard);
  if (result->fraction < 1.0F) {
    const alula_walk_rule all = {FLT_MAX, ALULA_NO_HULL, 0.0F, 0.0F, 0.0F};
    alula_walk walk;
    float hard;
    alula_walk_to(cbf, value->nearest, x, &walk);
    if (!alula_walk_planes(cbf, &all, x, &walk, &hard)) return; /* damaged */
    const float *nearest = walk.plane, *const end = walk.plane + 4U * walk.plane_count;
    for (const float* plane = nearest; plane < end; plane += 4) {
      if (alula_plane_value(plane, x) > alula_plane_value(nearest, x)) nearest = plane;
    }
    const float speed = __builtin_sqrtf(dot(result->u, result->u));
    const float straight[3] = {speed * nearest[0], speed * nearest[1], speed * nearest[2]};
    const float fraction = checked(cbf, x, straight, value->hard);
    if (fraction > result->fraction) {
      result->fraction = fraction;
      for (int i = 0; i < 3; ++i) result->u[i] = straight[i];
    }
  }
  if (result->fraction >= 1.0F) return;
  for (int i = 0; i < 3; ++i) result->u[i] *= result->fraction;
}

static alula_filter_status filter(alula_polytope_cbf* cbf, const float x[3], const float u_nom[3],
                                  alula_polytope_result* result) {
  alula_polytope_value value;
  if (begin(cbf, x, &value) != ALULA_READY) return ALULA_FILTER_REFUSED;
  if (cbf->map.hull_count > 0U) {
    value.smooth = smooth_bound(cbf, value.hard); /* replaces s when the row cannot bind */
    if (could_bind(cbf, value.smooth)) find_smooth(cbf, x, &value);
  }
  result->margin_m = value.smooth - cbf->config.radius_m;
  result->hard_margin_m = value.hard - cbf->config.radius_m;
  result->active = value.nearest;
  result->fraction = 1.0F;
  for (int i = 0; i < 3; ++i) result->u[i] = u_nom[i];

  const float row = -cbf->config.beta * result->margin_m;
  const int sound = cbf->config.smoothing == ALULA_SMOOTHING_SOUND;
  if (sound && result->hard_margin_m < 0.0F) {
    const alula_filter_status out = recover(cbf, &value, row, result->u);
    if (out == ALULA_FILTER_RECOVERING) check_recovery(cbf, x, &value, result);
    return out;
  }
  const int limited = limit_speed(result->u, cbf->config.v_max);
  alula_filter_status status = project(cbf, &value, row, result->u);
  if (status == ALULA_FILTER_OK && limited) status = ALULA_FILTER_FILTERED;
  if (!sound || status == ALULA_FILTER_REFUSED) return status;
  return check_step(cbf, x, status, result);
}

static void clear_result(alula_polytope_result* result) {
  result->u[0] = result->u[1] = result->u[2] = 0.0F;
  result->margin_m = result->hard_margin_m = -FLT_MAX;
  result->fraction = 0.0F;
  result->active = ALULA_NO_HULL;
}

alula_filter_status alula_polytope_cbf_filter(alula_polytope_cbf* cbf, const float x[3], const float u_nom[3],
                                              alula_polytope_result* result) {
  if (!result) return ALULA_FILTER_REFUSED;
  clear_result(result);
  if (!cbf || !x || !u_nom) return ALULA_FILTER_REFUSED;
  if (!alula_is_finite(u_nom[0]) || !alula_is_finite(u_nom[1]) || !alula_is_finite(u_nom[2])) {
    return ALULA_FILTER_REFUSED;
  }
  const alula_filter_status status = filter(cbf, x, u_nom, result);
  /* the speed exceeds the limit only on a map that has changed since it was opened */
  if (!cbf->is_damaged && dot(result->u, result->u) <= SPEED_TOLERANCE * cbf->config.v_max * cbf->config.v_max) {
    return status;
  }
  clear_result(result);
  return ALULA_FILTER_REFUSED;
}
