/* Checks that each variable is as large as its type. */
#ifndef CHECK_LOG_H
#define CHECK_LOG_H
#include <stdint.h>
typedef uint16_t logVarId_t;
logVarId_t logGetVarId(char* group, char* name);
float logGetFloat(logVarId_t id);
#define LOG_VARID_IS_VALID(ID) ((ID) != 0xFFFFU)
#define LOG_UINT8 1
#define LOG_UINT32 4
#define LOG_FLOAT 4
#define LOG_GROUP_START(NAME)
#define LOG_ADD(SIZE, NAME, ADDRESS) _Static_assert(sizeof *(ADDRESS) == (SIZE), #NAME);
#define LOG_GROUP_STOP(NAME)
#endif
