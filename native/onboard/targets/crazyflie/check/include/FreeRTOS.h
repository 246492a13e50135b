#ifndef CHECK_FREERTOS_H
#define CHECK_FREERTOS_H
#include <stdint.h>
typedef uint32_t TickType_t;
#define M2T(MILLISECONDS) ((TickType_t)(MILLISECONDS))
#endif
