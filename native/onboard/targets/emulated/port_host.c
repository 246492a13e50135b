/* The platform interface on a host: reads the map from map.bin and counts nanoseconds. */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include <time.h>

#include "port.h"

static FILE *inputs, *outputs;
static uint8_t map[1U << 24];
static struct timespec begin;

int port_open(void) {
  inputs = fopen("inputs.bin", "rb");
  outputs = fopen("outputs.bin", "wb");
  return inputs && outputs;
}

int port_read(void* to, uint32_t bytes) { return fread(to, 1, bytes, inputs) == bytes; }

int port_write(const void* from, uint32_t bytes) {
  return fwrite(from, 1, bytes, outputs) == bytes && fflush(outputs) == 0;
}

const uint8_t* port_map(uint32_t* bytes) {
  FILE* file = fopen("map.bin", "rb");
  *bytes = file ? (uint32_t)fread(map, 1, sizeof map, file) : 0U;
  return map;
}

void port_start(void) { (void)clock_gettime(CLOCK_MONOTONIC, &begin); }

uint32_t port_stop(void) {
  struct timespec end;
  (void)clock_gettime(CLOCK_MONOTONIC, &end);
  const long long passed = (end.tv_sec - begin.tv_sec) * 1000000000LL + (end.tv_nsec - begin.tv_nsec);
  return passed < UINT32_MAX ? (uint32_t)passed : UINT32_MAX;
}

uint32_t port_stack(void) { return 0U; }
