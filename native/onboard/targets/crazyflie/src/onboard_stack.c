/* The part of native/onboard for a fence and moving obstacles; its own file, because names that are local differ. */
#include "crazyflie_filter.h"

#if ALULA_CRAZYFLIE_OBSTACLES > 0U
#include "../../../src/alula_avoidance.c"
#include "../../../src/alula_bypass.c"
#include "../../../src/alula_dr_acbf.c"
#include "../../../src/alula_early_warning.c"
#include "../../../src/alula_envelope.c"
#include "../../../src/alula_fence_check.c"
#include "../../../src/alula_stack.c"
#endif
