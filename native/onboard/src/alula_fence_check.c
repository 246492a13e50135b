/* The check of a fence, without what follows flows in it. */
#include "alula_fence.h"
#include "vector.h"

#define UNIT_ERROR 1.0e-5F

static int is_near(float x) { return absolute(x) <= ALULA_FENCE_FAR; } /* also refuses NaN */

alula_status alula_fence_check(const alula_fence* fence) {
  if (!fence) return ALULA_BAD_POINTER;
  if (!fence->has_box && fence->face_count == 0U && !fence->keep_out) return ALULA_BAD_PARAMETER;
  if (fence->face_count > ALULA_FENCE_FACES) return ALULA_BAD_PARAMETER;
  for (int i = 0; fence->has_box && i < 3; ++i) {
    if (!is_near(fence->lower[i]) || !is_near(fence->upper[i])) return ALULA_BAD_PARAMETER;
    if (!(fence->lower[i] < fence->upper[i])) return ALULA_BAD_PARAMETER;
  }
  for (uint32_t l = 0; l < fence->face_count; ++l) {
    const float* n = fence->face[l];
    if (!is_near(n[3]) || !(absolute(dot(n, n) - 1.0F) <= UNIT_ERROR)) return ALULA_BAD_PARAMETER;
  }
  if (fence->keep_out && !fence->keep_out->data) return ALULA_BAD_MAP;
  return ALULA_READY;
}
