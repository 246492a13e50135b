/* Selection of the hulls that a search evaluates, and their planes. Private. */
#ifndef ALULA_ONBOARD_POLYTOPE_WALK_H
#define ALULA_ONBOARD_POLYTOPE_WALK_H

#include "alula_polytope_cbf.h"
#include "map_index.h"

/* A term below exp(-18) = 1.5e-8 of the largest is under half a unit in the last place of their sum
 * (which is at least 1). It is always left out, so skipping its hull changes nothing.
 * n hulls left out raise s by less than n 1.5e-8 / kappa, and never above psi. */
#define ALULA_WALK_CUTOFF 18.0F

/* Exceeds the rounding of a speed by squaring and a root. */
#define ALULA_SPEED_ROUNDING 1.000001F

/* Rule for hulls that a search may skip. A hull (or all hulls of a box) with psi_k of at least `bound` is skipped
 * when bound > nearer, or bound = nearer and it is not before `nearest`, and (bound - lowering) - least > cutoff. The
 * rule is monotone in `bound`, also after rounding. So with a bound of a box or the maximum over some planes it skips
 * the same hulls as with psi_k itself, or fewer: the result does not depend on the tree. */
typedef struct {
  float nearer;
  uint32_t nearest;
  float lowering, least, cutoff;
} alula_walk_rule;

/* A walk through the hulls in their order. The fields after alula_walk_next or alula_walk_to: */
typedef struct {
  uint32_t hull;      /* its number */
  float bound;        /* at most psi_k */
  const float* plane; /* after alula_walk_planes: rows of 4, as in alula_polytope_map */
  uint32_t plane_count;
  uint32_t listed;      /* next of the list */
  uint32_t level, node; /* next node of the index */
  uint32_t next, end;   /* of the leaf: next hull, hull after the last */
  uint32_t record, at;  /* byte of the hull's record and of the next */
} alula_walk;

/* Lists the hulls with a bound of at most `farthest`; if the list holds all of them, walks then use the list. */
void alula_walk_gather(alula_polytope_cbf* cbf, float farthest, const float x[3]);

/* Makes later walks go through all hulls. */
void alula_walk_forget(alula_polytope_cbf* cbf);

/* Maximum of psi_k - s_k. */
static inline float alula_walk_lowering(const alula_polytope_cbf* cbf, uint32_t planes) {
  if (cbf->config.smoothing == ALULA_SMOOTHING_PAPER) return 0.0F;
  return alula_logf((float)planes) * cbf->inverse_kappa;
}

void alula_walk_begin(const alula_polytope_cbf* cbf, alula_walk* walk);

/* Advances to the next hull that the rule does not skip; 0 at the end. */
int alula_walk_next(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk);

/* Moves to one hull, by its number. */
void alula_walk_to(alula_polytope_cbf* cbf, uint32_t hull, const float x[3], alula_walk* walk);

/* A hull that is probably the nearest. */
uint32_t alula_walk_guess(alula_polytope_cbf* cbf, const float x[3]);

/* The planes of the walk's hull and their largest value, psi_k; 0 when the rule skips the hull after all. */
int alula_walk_planes(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk,
                      float* hard);

#endif
