/* As in the firmware, a group is one array; also checks that each variable is as large as its type. */
#ifndef CHECK_LOG_H
#define CHECK_LOG_H
#include <stdbool.h>
#include <stdint.h>
typedef uint16_t logVarId_t;
logVarId_t logGetVarId(const char* group, const char* name);
float logGetFloat(logVarId_t id);
static inline bool logVarIdIsValid(logVarId_t id) { return id != 0xFFFFU; }

#define LOG_UINT8 1
#define LOG_UINT32 3
#define LOG_FLOAT 7
struct log_s {
  uint8_t type;
  char* name;
  void* address;
};
#define CHECK_LOG_SIZE(TYPE) ((TYPE) == LOG_UINT8 ? 1 : 4)
#define LOG_GROUP_START(NAME) \
  static const struct log_s check_logs_##NAME[] __attribute__((section(".log." #NAME), used)) = {{0, #NAME, 0},
#define LOG_ADD(TYPE, NAME, ADDRESS) \
  {TYPE + 0 * sizeof(char[sizeof *(ADDRESS) == CHECK_LOG_SIZE(TYPE) ? 1 : -1]), #NAME, (void*)(ADDRESS)},
#define LOG_GROUP_STOP(NAME) {0, "stop_" #NAME, 0}} \
  ;
#endif
