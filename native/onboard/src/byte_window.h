/* The last bytes of a stream, for finding frames of fixed length. Private. */
#ifndef ALULA_ONBOARD_BYTE_WINDOW_H
#define ALULA_ONBOARD_BYTE_WINDOW_H

#include <stdint.h>

/* Drops at least `least` bytes, until `first` leads. Returns the number of dropped bytes. */
static inline uint32_t drop_until(uint8_t* bytes, uint32_t* count, uint8_t first, uint32_t least) {
  uint32_t gone = least;
  while (gone < *count && bytes[gone] != first) ++gone;
  for (uint32_t i = gone; i < *count; ++i) bytes[i - gone] = bytes[i];
  *count -= gone;
  return gone;
}

/* Adds a byte to a window of `size` bytes for frames that begin with `first`; nonzero when it is full. */
static inline int add_byte(uint8_t* bytes, uint32_t* count, uint32_t size, uint8_t first, uint8_t byte,
                           uint32_t* skipped) {
  if (*count == 0U && byte != first) {
    ++*skipped;
    return 0;
  }
  bytes[(*count)++] = byte;
  return *count == size;
}

#endif
