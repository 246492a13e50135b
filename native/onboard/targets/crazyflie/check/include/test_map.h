/* The map of tests on a host: a program that links the app must define alula_test_map. */
#ifndef CHECK_TEST_MAP_H
#define CHECK_TEST_MAP_H
#include <stdint.h>
extern uint8_t alula_test_map[];
extern uint32_t alula_test_map_bytes;
#define cover_map alula_test_map
#define COVER_MAP_BYTES alula_test_map_bytes
#endif
