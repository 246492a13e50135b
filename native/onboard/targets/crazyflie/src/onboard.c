/* The part of native/onboard that the app needs, as one file in this folder. */
#if defined(__FAST_MATH__)
#error "build without -ffast-math: the margins of rounding do not hold with it"
#endif

#include "../../../src/alula_chord.c"
#include "../../../src/alula_half_spaces.c"
#include "../../../src/alula_map.c"
#include "../../../src/alula_map_index.c"
#include "../../../src/alula_math.c"
#include "../../../src/alula_polytope_setup.c"
#include "../../../src/alula_polytope_walk.c"
