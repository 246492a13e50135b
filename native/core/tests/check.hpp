// The native test harness: a check that reports and counts failures.
#pragma once

#include <cstdio>

inline int alula_failures = 0;

#define CHECK(condition)                                                                 \
  do {                                                                                   \
    if (!(condition)) {                                                                  \
      std::fprintf(stderr, "%s:%d: CHECK(%s) failed\n", __FILE__, __LINE__, #condition); \
      ++alula_failures;                                                                  \
    }                                                                                    \
  } while (false)
