/* As in the firmware, a group is one array; also checks that each variable is as large as its type. */
#ifndef CHECK_PARAM_H
#define CHECK_PARAM_H
#include <stdint.h>
#define PARAM_UINT8 8
#define PARAM_FLOAT 6
struct param_s {
  uint8_t type, extended_type;
  char* name;
  void* address;
  void (*callback)(void);
  void* (*getter)(void);
};
#define CHECK_PARAM_SIZE(TYPE) ((TYPE) == PARAM_UINT8 ? 1 : 4)
#define PARAM_GROUP_START(NAME)                     \
  static const struct param_s check_params_##NAME[] \
      __attribute__((section(".param." #NAME), used)) = {{0, 0, #NAME, 0, 0, 0},
#define PARAM_ADD(TYPE, NAME, ADDRESS) \
  {TYPE + 0 * sizeof(char[sizeof *(ADDRESS) == CHECK_PARAM_SIZE(TYPE) ? 1 : -1]), 0, #NAME, (void*)(ADDRESS), 0, 0},
#define PARAM_GROUP_STOP(NAME) {0, 0, "stop_" #NAME, 0, 0, 0}} \
  ;
#endif
