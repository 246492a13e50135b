/* Set-up of a filter among polytopes: checks of the map and the parameters. */
#include "polytope_walk.h"

#define OUTWARD_OF_EXTENT (1.0F / 262144.0F) /* 2^-18, see alula_polytope_cbf_open */
#define KAPPA_MAX 1.0e5F
#define SPEED_MAX 1.0e6F
#define TERMS 46.0F      /* at least 18 + 2 log 261 + log 2^24, see alula_polytope_cbf_reach */
#define ROUNDING 1.0e-5F /* more than the relative rounding of the sum of the reach */

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

static int config_is_good(const alula_polytope_cbf_config* config, float extent_m) {
  return config->radius_m >= 0.0F && config->radius_m <= extent_m && config->beta > 0.0F && config->dt_s > 0.0F &&
         config->beta * config->dt_s <= ALULA_SPEED_ROUNDING && config->kappa > 0.0F && config->kappa <= KAPPA_MAX &&
         config->v_max > 0.0F && config->v_max <= SPEED_MAX && config->v_max * config->dt_s <= extent_m &&
         alula_is_finite(1.0F / config->kappa * ALULA_WALK_CUTOFF) &&
         (config->smoothing == ALULA_SMOOTHING_SOUND || config->smoothing == ALULA_SMOOTHING_PAPER);
}

static alula_status set_up(alula_polytope_cbf* cbf, const alula_map* image, const alula_polytope_map* map,
                           const alula_polytope_cbf_config* config, uint32_t most_planes) {
  static const alula_polytope_work NONE = {0U, 0U, 0U, 0U, 0U};
  if (!config_is_good(config, map->extent_m)) return ALULA_BAD_PARAMETER;
  cbf->map = *map;
  cbf->image = *image;
  cbf->config = *config;
  cbf->outward_m = map->slack_m;
  cbf->inverse_kappa = 1.0F / config->kappa;
  cbf->cutoff_m = ALULA_WALK_CUTOFF * cbf->inverse_kappa;
  cbf->max_lowering_m = most_planes > 0U ? alula_walk_lowering(cbf, most_planes) : 0.0F;
  cbf->crowd_m = map->hull_count > 0U ? alula_logf((float)map->hull_count) * cbf->inverse_kappa : 0.0F;
  cbf->is_damaged = 0;
  cbf->kept_count = cbf->row_count = cbf->used = cbf->used_before = 0U;
  cbf->work = NONE;
  return ALULA_READY;
}

alula_status alula_polytope_cbf_init(alula_polytope_cbf* cbf, const alula_polytope_map* map,
                                     const alula_polytope_cbf_config* config) {
  static const alula_map NO_IMAGE = {0};
  if (!cbf || !map || !config || !map->plane_start) return ALULA_BAD_POINTER;
  if (map->hull_count > 0U && (!map->plane || !map->lower || !map->upper)) return ALULA_BAD_POINTER;
  if (map->hull_count > ALULA_MAX_PLANES || !map_is_valid(map)) return ALULA_BAD_MAP;
  uint32_t most = 0U;
  for (uint32_t k = 0; k < map->hull_count; ++k) {
    const uint32_t planes = map->plane_start[k + 1U] - map->plane_start[k];
    if (planes > most) most = planes;
  }
  return set_up(cbf, &NO_IMAGE, map, config, most);
}

alula_status alula_polytope_cbf_open(alula_polytope_cbf* cbf, const alula_map* image, float extent_m,
                                     const alula_polytope_cbf_config* config) {
  if (!cbf || !image || !config || !image->data) return ALULA_BAD_POINTER;
  if (image->most_planes + 6U > ALULA_PLANE_ROWS) return ALULA_BAD_MAP;
  if (!(extent_m >= 0.0F && extent_m < 1.0e12F)) return ALULA_BAD_PARAMETER;
  alula_polytope_map map = {0, 0, 0, 0, 0U, 0.0F, 0.0F};
  map.hull_count = image->hull_count;
  map.extent_m = extent_m > image->extent_m ? extent_m : image->extent_m;
  map.slack_m = map.extent_m * OUTWARD_OF_EXTENT;
  return set_up(cbf, image, &map, config, image->hull_count > 0U ? image->most_planes + 6U : 0U);
}

alula_status alula_polytope_cbf_move(alula_polytope_cbf* cbf, const alula_map* image) {
  if (!cbf || !image || !image->data) return ALULA_BAD_POINTER;
  if (image->most_planes + 6U > ALULA_PLANE_ROWS || image->extent_m > cbf->map.extent_m) return ALULA_BAD_MAP;
  alula_polytope_map map = cbf->map;
  map.hull_count = image->hull_count;
  const alula_polytope_cbf_config config = cbf->config;
  const alula_status status =
      set_up(cbf, image, &map, &config, image->hull_count > 0U ? image->most_planes + 6U : 0U);
  if (status == ALULA_READY) alula_walk_forget(cbf);
  return status;
}

float alula_polytope_cbf_reach(const alula_polytope_cbf* cbf) {
  const alula_polytope_cbf_config* c = &cbf->config;
  const float sum = c->radius_m + c->v_max / c->beta + c->v_max * c->dt_s + TERMS * cbf->inverse_kappa;
  return (sum + 4.0F * cbf->map.slack_m) * (1.0F + ROUNDING);
}
