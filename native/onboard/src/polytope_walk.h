/* Which hulls a search looks at, and their planes; not for callers. */
#ifndef ALULA_ONBOARD_POLYTOPE_WALK_H
#define ALULA_ONBOARD_POLYTOPE_WALK_H

#include "alula_polytope_cbf.h"
#include "map_index.h"

/* A term below exp(-18) = 1.5e-8 of the largest is under half a unit in the last place of their sum
 * (which is at least 1) and is left out by rule, so that skipping the hull that has it changes nothing.
 * n hulls left out raise s by less than n 1.5e-8 / kappa, and never above psi. */
#define ALULA_WALK_CUTOFF 18.0F

/* More than squaring and a root round a speed by. */
#define ALULA_SPEED_ROUNDING 1.000001F

/* What a search needs no look at: a hull (or all of a box) whose psi_k is at least `bound` when
 * bound > nearer, or as much and it is no earlier one than `nearest`, and (bound - lowering) - least > cutoff.
 * All of this is monotone in `bound`, also after rounding, so that a bound of a box, the maximum over some
 * planes and psi_k itself leave out the same hulls or fewer: what is found does not depend on the tree. */
typedef struct {
  float nearer;
  uint32_t nearest;
  float lowering, least, cutoff;
} alula_walk_rule;

/* Hulls in their order. After alula_walk_next or alula_walk_to: */
typedef struct {
  uint32_t hull;      /* its number */
  float bound;        /* at most psi_k */
  const float* plane; /* after alula_walk_planes: rows of 4, as in alula_polytope_map */
  uint32_t plane_count;
  uint32_t listed;      /* next of the list */
  uint32_t level, node; /* of the index, where to go on */
  uint32_t next, end;   /* of the leaf: next hull, hull after the last */
  uint32_t record, at;  /* byte of the hull's record and of the next */
} alula_walk;

/* Lists the hulls whose bound is at most `farthest`; walks then go through the list, when it has room for all. */
void alula_walk_gather(alula_polytope_cbf* cbf, float farthest, const float x[3]);

/* The walks that follow go through all hulls. */
void alula_walk_forget(alula_polytope_cbf* cbf);

/* How far s_k lies below psi_k at most. */
static inline float alula_walk_lowering(const alula_polytope_cbf* cbf, uint32_t planes) {
  if (cbf->config.smoothing == ALULA_SMOOTHING_PAPER) return 0.0F;
  return alula_logf((float)planes) * cbf->inverse_kappa;
}

void alula_walk_begin(const alula_polytope_cbf* cbf, alula_walk* walk);

/* On to the next hull that the rule does not leave out; 0 at the end. */
int alula_walk_next(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk);

/* To one hull, by its number. */
void alula_walk_to(alula_polytope_cbf* cbf, uint32_t hull, const float x[3], alula_walk* walk);

/* A hull that is probably the nearest. */
uint32_t alula_walk_guess(alula_polytope_cbf* cbf, const float x[3]);

/* The planes of the walk's hull and their largest value, psi_k; 0 when the rule leaves the hull out after all. */
int alula_walk_planes(alula_polytope_cbf* cbf, const alula_walk_rule* rule, const float x[3], alula_walk* walk,
                      float* hard);

#endif
