/* As in the firmware, the format is joined to the module's name: it must be a literal. */
#ifndef CHECK_DEBUG_H
#define CHECK_DEBUG_H
__attribute__((format(printf, 1, 2))) void check_print(const char* format, ...);
#define DEBUG_PRINT(FORMAT, ...) check_print(DEBUG_MODULE ": " FORMAT, ##__VA_ARGS__)
#endif
