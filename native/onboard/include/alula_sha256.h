/* SHA-256 (FIPS 180-4) and HMAC-SHA-256 (RFC 2104), in freestanding C99. No heap, no tables beside 256 bytes of
 * constants; about 20 operations per byte. */
#ifndef ALULA_SHA256_H
#define ALULA_SHA256_H

#include "alula_onboard.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_SHA256_BYTES 32U
#define ALULA_SHA256_BLOCK 64U

/* A hash of the bytes so far; the fields are private. */
typedef struct {
  uint32_t word[8];
  uint64_t length; /* bytes so far */
  uint8_t block[ALULA_SHA256_BLOCK];
} alula_sha256;

void alula_sha256_begin(alula_sha256* hash);
void alula_sha256_add(alula_sha256* hash, const uint8_t* data, uint32_t length);
void alula_sha256_end(alula_sha256* hash, uint8_t digest[ALULA_SHA256_BYTES]);

/* The code of `length` bytes under a key of any length. */
void alula_hmac_sha256(const uint8_t* key, uint32_t key_length, const uint8_t* data, uint32_t length,
                       uint8_t code[ALULA_SHA256_BYTES]);

/* Nonzero if two digests are equal; takes the same time wherever they differ. */
ALULA_MUST_USE int alula_sha256_equal(const uint8_t one[ALULA_SHA256_BYTES], const uint8_t other[ALULA_SHA256_BYTES]);

#ifdef __cplusplus
}
#endif
#endif
