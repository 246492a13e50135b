/* An image, positions, and finally a byte of the image that changes during use. */
#include "fuzz.h"

static void check_value(const alula_map* map, alula_map_status status, const float x[3], const alula_map_value* v) {
  if (status != ALULA_MAP_READY) {
    CHECK(v->psi_m == -FLT_MAX && v->hull == ALULA_MAP_NO_HULL);
    return;
  }
  CHECK(all_finite(x, 3) && isfinite(v->psi_m));
  if (map->hull_count == 0U) return;
  CHECK(v->hull < map->hull_count);
  const float square = v->normal[0] * v->normal[0] + v->normal[1] * v->normal[1] + v->normal[2] * v->normal[2];
  CHECK(fabsf(square - 1.0F) < 1.0e-5F);
}

static void walk_records(const alula_map* map) {
  uint32_t at = ALULA_MAP_HEADER_BYTES, planes = 0;
  for (uint32_t h = 0; h < map->hull_count; ++h) {
    alula_map_hull hull;
    CHECK(alula_map_read(map, at, &hull) == ALULA_MAP_READY);
    for (int i = 0; i < 3; ++i) CHECK(hull.lower[i] < hull.upper[i]);
    for (uint32_t l = 0; l < hull.plane_count; ++l) CHECK(alula_map_plane_at(map, &hull, l).depth > 0U);
    planes += hull.plane_count;
    at = hull.next;
  }
  CHECK(at == map->records_end && planes == map->plane_count);
}

/* Uses a damaged image: nothing is read outside it, and results are numbers. */
static void use_damaged(const alula_map* map, alula_map_near* near, uint8_t* image, uint32_t size, bytes* in) {
  for (int k = 0; k < 4; ++k) {
    image[take(in, 4) % size] = (uint8_t)take(in, 1);
    float x[3];
    alula_map_value value;
    take_floats(in, 2.0F * map->extent_m, x, 3);
    if (alula_map_evaluate(map, x, &value) == ALULA_MAP_READY) CHECK(isfinite(value.psi_m));
    if (alula_map_near_evaluate(near, x, &value) == ALULA_MAP_READY) CHECK(isfinite(value.psi_m));
  }
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  bytes in = {data, size};
  uint32_t length;
  uint8_t* image = take_image(&in, &length);
  alula_map map;
  static alula_map_near near;
  if (open_image(image, length, &map)) {
    walk_records(&map);
    alula_map_near_open(&near, &map);
    float x[3] = {0.0F, 0.0F, 0.0F};
    for (int k = 0; k < 24; ++k) {
      alula_map_value alone, along;
      if (k % 4 == 0) {
        take_floats(&in, 1.5F * map.extent_m, x, 3);
      } else {
        for (int i = 0; i < 3; ++i) x[i] += take_float(&in, 0.1F * map.extent_m);
      }
      const alula_map_status status = alula_map_evaluate(&map, x, &alone);
      check_value(&map, status, x, &alone);
      CHECK(alula_map_near_evaluate(&near, x, &along) == status);
      CHECK(same_bits(&alone, &along, sizeof alone));
    }
    use_damaged(&map, &near, image, length, &in);
  }
  free(image);
  return 0;
}
