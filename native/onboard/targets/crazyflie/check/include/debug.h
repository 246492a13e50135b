#ifndef CHECK_DEBUG_H
#define CHECK_DEBUG_H
__attribute__((format(printf, 1, 2))) void check_print(const char* format, ...);
#define DEBUG_PRINT(...) check_print(__VA_ARGS__)
#endif
