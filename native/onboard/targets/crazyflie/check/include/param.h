/* Checks that each variable is as large as its type. */
#ifndef CHECK_PARAM_H
#define CHECK_PARAM_H
#define PARAM_UINT8 1
#define PARAM_FLOAT 4
#define PARAM_GROUP_START(NAME)
#define PARAM_ADD(SIZE, NAME, ADDRESS) _Static_assert(sizeof *(ADDRESS) == (SIZE), #NAME);
#define PARAM_GROUP_STOP(NAME)
#endif
