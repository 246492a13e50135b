#include "alula_polytope_cbf.h"

#include "vector.h"

/* A term below exp(-18) = 1.5e-8 of the largest is under half a unit in the last place of their sum
 * (which is at least 1) and is left out by rule, so that skipping the hull that has it changes nothing.
 * n hulls left out raise s by less than n 1.5e-8 / kappa, and never above psi. */
#define CUTOFF 18.0F
#define KAPPA_MAX 1.0e5F
#define SPEED_MAX 1.0e6F
#define FLAT 1.0e-6F           /* squared gradient below which there is no direction to leave in */
#define DIVISION_ERROR 2.4e-7F /* 4 units in the last place: two subtractions and a division */
#define SPEED_ROUNDING 1.000001F

static float plane_value(const float* plane, const float x[3]) {
  return ((plane[0] * x[0] + plane[1] * x[1]) + plane[2] * x[2]) - plane[3];
}

/* Lower bound of psi_k from the planes of hull k that are parallel to the axes. The arithmetic is
 * that of plane_value for such a plane, so the bound also holds for the rounded values. */
static float box_value(const alula_polytope_map* map, uint32_t hull, const float x[3]) {
  const float* lower = map->lower + 3U * hull;
  const float* upper = map->upper + 3U * hull;
  float value = -FLT_MAX;
  for (int i = 0; i < 3; ++i) {
    const float below = lower[i] - x[i];
    const float above = x[i] - upper[i];
    if (below > value) value = below;
    if (above > value) value = above;
  }
  return value;
}

static float hard_value(const alula_polytope_map* map, uint32_t hull, const float x[3]) {
  float value = -FLT_MAX;
  const uint32_t end = map->plane_start[hull + 1U];
  for (uint32_t l = map->plane_start[hull]; l < end; ++l) {
    const float a = plane_value(map->plane + 4U * l, x);
    if (a > value) value = a;
  }
  return value;
}

static float lowering(const alula_polytope_cbf* cbf, uint32_t hull) {
  if (cbf->config.smoothing == ALULA_SMOOTHING_PAPER) return 0.0F;
  const uint32_t planes = cbf->map.plane_start[hull + 1U] - cbf->map.plane_start[hull];
  return alula_logf((float)planes) * cbf->inverse_kappa;
}

/* s_k and its gradient, given psi_k. */
static float smooth_value(const alula_polytope_cbf* cbf, uint32_t hull, const float x[3], float hard,
                          float gradient[3]) {
  const alula_polytope_map* map = &cbf->map;
  const uint32_t end = map->plane_start[hull + 1U];
  float sum = 0.0F;
  gradient[0] = gradient[1] = gradient[2] = 0.0F;
  for (uint32_t l = map->plane_start[hull]; l < end; ++l) {
    const float* plane = map->plane + 4U * l;
    const float exponent = cbf->config.kappa * (plane_value(plane, x) - hard);
    if (exponent < -CUTOFF) continue;
    const float weight = alula_expf(exponent);
    sum += weight;
    for (int i = 0; i < 3; ++i) gradient[i] += weight * plane[i];
  }
  for (int i = 0; i < 3; ++i) gradient[i] /= sum;
  const float raised = alula_logf(sum) * cbf->inverse_kappa;
  if (cbf->config.smoothing == ALULA_SMOOTHING_PAPER) return hard + raised;
  const float down = lowering(cbf, hull);
  return hard - (raised < down ? down - raised : 0.0F);
}

static int inside_extent(const alula_polytope_map* map, const float x[3]) {
  for (int i = 0; i < 3; ++i) {
    if (!(x[i] >= -map->extent_m && x[i] <= map->extent_m)) return 0; /* also NaN */
  }
  return 1;
}

static int map_is_valid(const alula_polytope_map* map) {
  if (map->plane_start[0] != 0U || !(map->extent_m > 0.0F) || !(map->extent_m < 1.0e12F)) return 0;
  if (!(map->slack_m >= 0.0F) || !alula_is_finite(map->slack_m)) return 0;
  for (uint32_t k = 0; k < map->hull_count; ++k) {
    const uint32_t begin = map->plane_start[k], end = map->plane_start[k + 1U];
    if (end <= begin || end > ALULA_MAX_PLANES) return 0;
    for (uint32_t l = 4U * begin; l < 4U * end; ++l) {
      if (!alula_is_finite(map->plane[l])) return 0;
    }
    for (uint32_t i = 3U * k; i < 3U * (k + 1U); ++i) {
      if (!alula_is_finite(map->lower[i]) || !alula_is_finite(map->upper[i])) return 0;
    }
  }
  return 1;
}

alula_status alula_polytope_cbf_init(alula_polytope_cbf* cbf, const alula_polytope_map* map,
                                     const alula_polytope_cbf_config* config, float* hull_value) {
  if (!cbf || !map || !config || !map->plane_start) return ALULA_BAD_POINTER;
  if (map->hull_count > 0U && (!map->plane || !map->lower || !map->upper || !hull_value)) return ALULA_BAD_POINTER;
  if (map->hull_count > ALULA_MAX_PLANES || !map_is_valid(map)) return ALULA_BAD_MAP;
  const int good = config->radius_m >= 0.0F && config->radius_m <= map->extent_m && config->beta > 0.0F &&
                   config->dt_s > 0.0F && config->beta * config->dt_s <= SPEED_ROUNDING && config->kappa > 0.0F &&
                   config->kappa <= KAPPA_MAX && config->v_max > 0.0F && config->v_max <= SPEED_MAX &&
                   config->v_max * config->dt_s <= map->extent_m &&
                   (config->smoothing == ALULA_SMOOTHING_SOUND || config->smoothing == ALULA_SMOOTHING_PAPER);
  if (!good) return ALULA_BAD_PARAMETER;
  cbf->map = *map;
  cbf->config = *config;
  cbf->inverse_kappa = 1.0F / config->kappa;
  if (!alula_is_finite(cbf->inverse_kappa * CUTOFF)) return ALULA_BAD_PARAMETER;
  cbf->cutoff_m = CUTOFF * cbf->inverse_kappa;
  cbf->max_lowering_m = 0.0F;
  cbf->hull_value = hull_value;
  for (uint32_t k = 0; k < map->hull_count; ++k) {
    const float down = lowering(cbf, k);
    if (down > cbf->max_lowering_m) cbf->max_lowering_m = down;
  }
  return ALULA_READY;
}

/* The hull whose box is nearest: a good guess for the nearest hull, so that most others are skipped. */
static uint32_t first_guess(const alula_polytope_map* map, const float x[3]) {
  uint32_t guess = 0U;
  float least = FLT_MAX;
  for (uint32_t k = 0; k < map->hull_count; ++k) {
    const float value = box_value(map, k, x);
    if (value < least) {
      least = value;
      guess = k;
    }
  }
  return guess;
}

/* psi and all s_k that can matter; the least s_k. A hull is skipped when its lower bound shows both
 * that it is not the nearest and that its term is left out by rule. Every operation in these
 * comparisons is monotone also after rounding, so brute force comes to the same result. */
static float first_pass(alula_polytope_cbf* cbf, const float x[3], alula_polytope_value* value) {
  const alula_polytope_map* map = &cbf->map;
  const int brute_force = cbf->config.brute_force;
  const uint32_t guess = brute_force ? 0U : first_guess(map, x);
  float least = FLT_MAX, unused[3];
  for (uint32_t turn = 0; turn <= map->hull_count; ++turn) {
    /* the guess first, then all in order */
    const uint32_t k = turn == 0U ? guess : turn - 1U;
    if (turn > 0U && k == guess) continue;
    cbf->hull_value[k] = FLT_MAX;
    if (!brute_force && turn > 0U) {
      const float bound = box_value(map, k, x);
      if (bound > value->hard && (bound - cbf->max_lowering_m) - least > cbf->cutoff_m) continue;
    }
    const float hard = hard_value(map, k, x);
    if (hard < value->hard || (hard == value->hard && k < value->nearest)) {
      value->hard = hard;
      value->nearest = k;
    }
    if (!brute_force && (hard - cbf->max_lowering_m) - least > cbf->cutoff_m) continue;
    const float smooth = smooth_value(cbf, k, x, hard, unused);
    cbf->hull_value[k] = smooth;
    if (smooth < least) least = smooth;
  }
  return least;
}

alula_status alula_polytope_cbf_evaluate(alula_polytope_cbf* cbf, const float x[3], alula_polytope_value* value) {
  if (!cbf || !x || !value) return ALULA_BAD_POINTER;
  value->hard = value->smooth = FLT_MAX;
  value->gradient[0] = value->gradient[1] = value->gradient[2] = 0.0F;
  value->nearest = ALULA_NO_HULL;
  if (!inside_extent(&cbf->map, x)) return ALULA_BAD_INPUT;
  if (cbf->map.hull_count == 0U) return ALULA_READY;
  const float least = first_pass(cbf, x, value);
  float sum = 0.0F;
  for (uint32_t k = 0; k < cbf->map.hull_count; ++k) {
    const float above = cbf->hull_value[k] - least;
    if (above > cbf->cutoff_m) continue;
    float gradient[3];
    (void)smooth_value(cbf, k, x, hard_value(&cbf->map, k, x), gradient);
    const float weight = alula_expf(-cbf->config.kappa * above);
    sum += weight;
    for (int i = 0; i < 3; ++i) value->gradient[i] += weight * gradient[i];
  }
  for (int i = 0; i < 3; ++i) value->gradient[i] /= sum;
  value->smooth = least - alula_logf(sum) * cbf->inverse_kappa;
  return ALULA_READY;
}

/* The part of the step from x to end that provably keeps psi_k >= least for all k, in [0, 1].
 *
 * Along the step each plane's value is linear, so hull k is entered between the last plane that
 * goes below the threshold and the first that comes back above it: the step is clear when that
 * interval is empty. The float values are at most the true ones at both ends, hence in between. */
static float clear_fraction(const alula_polytope_cbf* cbf, const float x[3], const float end[3], float reach,
                            float least) {
  const alula_polytope_map* map = &cbf->map;
  float fraction = 1.0F;
  for (uint32_t k = 0; k < map->hull_count; ++k) {
    if (!cbf->config.brute_force && box_value(map, k, x) - reach > least) continue;
    const float hard = hard_value(map, k, x);
    const float threshold = hard < least ? hard : least; /* already closer: at least no closer */
    const uint32_t plane_end = map->plane_start[k + 1U];
    float enter = 0.0F, leave = 2.0F;
    int separated = 0;
    for (uint32_t l = map->plane_start[k]; l < plane_end && !separated; ++l) {
      const float from = plane_value(map->plane + 4U * l, x);
      const float to = plane_value(map->plane + 4U * l, end);
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

/* Scale u down to the speed limit; nonzero when that changed it. */
static int limit_speed(float u[3], float v_max) {
  const float speed_squared = dot(u, u);
  if (speed_squared <= v_max * v_max * SPEED_ROUNDING) return 0;
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

/* Drive out along the gradient, as fast as the row asks but within the speed limit. */
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
  if (row > 0.0F && dot(u, u) > v_max * v_max * SPEED_ROUNDING) {
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

/* The part of the command u, held for dt from x, that keeps psi_k >= least for all k. */
static float checked(const alula_polytope_cbf* cbf, const float x[3], const float u[3], float least) {
  float end[3];
  for (int i = 0; i < 3; ++i) end[i] = x[i] + u[i] * cbf->config.dt_s;
  const float reach = __builtin_sqrtf(dot(u, u)) * cbf->config.dt_s * SPEED_ROUNDING + cbf->map.slack_m;
  return clear_fraction(cbf, x, end, reach, least);
}

static alula_filter_status check_step(const alula_polytope_cbf* cbf, const float x[3], alula_filter_status status,
                                      alula_polytope_result* result) {
  result->fraction = checked(cbf, x, result->u, cbf->config.radius_m + cbf->map.slack_m);
  if (result->fraction >= 1.0F) return status;
  for (int i = 0; i < 3; ++i) result->u[i] *= result->fraction;
  return status == ALULA_FILTER_RECOVERING ? status : ALULA_FILTER_SHORTENED;
}

/* A step out must not lead deeper, into this hull or another. The gradient of s may: it is a mean of
 * normals, near edges and for a small kappa of many. Then the normal of the plane that decides psi,
 * along which psi_k grows, may allow more. */
static void check_recovery(const alula_polytope_cbf* cbf, const float x[3], const alula_polytope_value* value,
                           alula_polytope_result* result) {
  const alula_polytope_map* map = &cbf->map;
  result->fraction = checked(cbf, x, result->u, value->hard);
  if (result->fraction < 1.0F) {
    const float* nearest = map->plane + 4U * map->plane_start[value->nearest];
    const float* const end = map->plane + 4U * map->plane_start[value->nearest + 1U];
    for (const float* plane = nearest; plane < end; plane += 4) {
      if (plane_value(plane, x) > plane_value(nearest, x)) nearest = plane;
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

alula_filter_status alula_polytope_cbf_filter(alula_polytope_cbf* cbf, const float x[3], const float u_nom[3],
                                              alula_polytope_result* result) {
  if (!result) return ALULA_FILTER_REFUSED;
  result->u[0] = result->u[1] = result->u[2] = 0.0F;
  result->margin_m = result->hard_margin_m = -FLT_MAX;
  result->fraction = 0.0F;
  result->active = ALULA_NO_HULL;
  if (!cbf || !x || !u_nom) return ALULA_FILTER_REFUSED;
  if (!alula_is_finite(u_nom[0]) || !alula_is_finite(u_nom[1]) || !alula_is_finite(u_nom[2])) {
    return ALULA_FILTER_REFUSED;
  }
  alula_polytope_value value;
  if (alula_polytope_cbf_evaluate(cbf, x, &value) != ALULA_READY) return ALULA_FILTER_REFUSED;
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
