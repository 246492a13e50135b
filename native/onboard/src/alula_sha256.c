#include "alula_sha256.h"

static const uint32_t START[8] = {0x6A09E667U, 0xBB67AE85U, 0x3C6EF372U, 0xA54FF53AU,
                                  0x510E527FU, 0x9B05688CU, 0x1F83D9ABU, 0x5BE0CD19U};
static const uint32_t ROUND[64] = {
    0x428A2F98U, 0x71374491U, 0xB5C0FBCFU, 0xE9B5DBA5U, 0x3956C25BU, 0x59F111F1U, 0x923F82A4U, 0xAB1C5ED5U,
    0xD807AA98U, 0x12835B01U, 0x243185BEU, 0x550C7DC3U, 0x72BE5D74U, 0x80DEB1FEU, 0x9BDC06A7U, 0xC19BF174U,
    0xE49B69C1U, 0xEFBE4786U, 0x0FC19DC6U, 0x240CA1CCU, 0x2DE92C6FU, 0x4A7484AAU, 0x5CB0A9DCU, 0x76F988DAU,
    0x983E5152U, 0xA831C66DU, 0xB00327C8U, 0xBF597FC7U, 0xC6E00BF3U, 0xD5A79147U, 0x06CA6351U, 0x14292967U,
    0x27B70A85U, 0x2E1B2138U, 0x4D2C6DFCU, 0x53380D13U, 0x650A7354U, 0x766A0ABBU, 0x81C2C92EU, 0x92722C85U,
    0xA2BFE8A1U, 0xA81A664BU, 0xC24B8B70U, 0xC76C51A3U, 0xD192E819U, 0xD6990624U, 0xF40E3585U, 0x106AA070U,
    0x19A4C116U, 0x1E376C08U, 0x2748774CU, 0x34B0BCB5U, 0x391C0CB3U, 0x4ED8AA4AU, 0x5B9CCA4FU, 0x682E6FF3U,
    0x748F82EEU, 0x78A5636FU, 0x84C87814U, 0x8CC70208U, 0x90BEFFFAU, 0xA4506CEBU, 0xBEF9A3F7U, 0xC67178F2U};

static uint32_t turned(uint32_t x, uint32_t by) { return x >> by | x << (32U - by); }

static uint32_t big_endian(const uint8_t* p) {
  return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | (uint32_t)p[3];
}

/* Mixes one block in. The schedule is a ring of the last 16 words. */
static void mix(uint32_t state[8], const uint8_t* block) {
  uint32_t w[16], s[8];
  for (uint32_t i = 0; i < 16U; ++i) w[i] = big_endian(block + 4U * i);
  for (uint32_t i = 0; i < 8U; ++i) s[i] = state[i];
  for (uint32_t t = 0; t < 64U; ++t) {
    if (t >= 16U) {
      const uint32_t a = w[(t + 1U) & 15U], b = w[(t + 14U) & 15U];
      w[t & 15U] +=
          (turned(a, 7U) ^ turned(a, 18U) ^ a >> 3) + w[(t + 9U) & 15U] + (turned(b, 17U) ^ turned(b, 19U) ^ b >> 10);
    }
    const uint32_t one = s[7] + (turned(s[4], 6U) ^ turned(s[4], 11U) ^ turned(s[4], 25U)) +
                         ((s[4] & s[5]) ^ (~s[4] & s[6])) + ROUND[t] + w[t & 15U];
    const uint32_t two =
        (turned(s[0], 2U) ^ turned(s[0], 13U) ^ turned(s[0], 22U)) + ((s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]));
    for (uint32_t i = 7U; i > 0U; --i) s[i] = s[i - 1U];
    s[4] += one;
    s[0] = one + two;
  }
  for (uint32_t i = 0; i < 8U; ++i) state[i] += s[i];
}

void alula_sha256_begin(alula_sha256* hash) {
  for (uint32_t i = 0; i < 8U; ++i) hash->word[i] = START[i];
  hash->length = 0U;
}

void alula_sha256_add(alula_sha256* hash, const uint8_t* data, uint32_t length) {
  uint32_t filled = (uint32_t)(hash->length % ALULA_SHA256_BLOCK);
  hash->length += length;
  for (uint32_t i = 0; i < length; ++i) {
    hash->block[filled++] = data[i];
    if (filled < ALULA_SHA256_BLOCK) continue;
    mix(hash->word, hash->block);
    filled = 0U;
  }
}

void alula_sha256_end(alula_sha256* hash, uint8_t digest[ALULA_SHA256_BYTES]) {
  static const uint8_t PADDING[ALULA_SHA256_BLOCK] = {0x80U};
  const uint64_t bits = 8U * hash->length;
  const uint32_t filled = (uint32_t)(hash->length % ALULA_SHA256_BLOCK);
  uint8_t size[8];
  for (uint32_t i = 0; i < 8U; ++i) size[i] = (uint8_t)(bits >> (56U - 8U * i) & 0xFFU);
  alula_sha256_add(hash, PADDING, (filled < 56U ? 56U : 120U) - filled);
  alula_sha256_add(hash, size, 8U);
  for (uint32_t i = 0; i < ALULA_SHA256_BYTES; ++i)
    digest[i] = (uint8_t)(hash->word[i / 4U] >> (24U - 8U * (i % 4U)) & 0xFFU);
}

void alula_hmac_sha256(const uint8_t* key, uint32_t key_length, const uint8_t* data, uint32_t length,
                       uint8_t code[ALULA_SHA256_BYTES]) {
  alula_sha256 hash;
  uint8_t padded[ALULA_SHA256_BLOCK] = {0U};
  if (key_length > ALULA_SHA256_BLOCK) {
    alula_sha256_begin(&hash);
    alula_sha256_add(&hash, key, key_length);
    alula_sha256_end(&hash, padded);
  } else {
    for (uint32_t i = 0; i < key_length; ++i) padded[i] = key[i];
  }
  for (uint32_t i = 0; i < ALULA_SHA256_BLOCK; ++i) padded[i] ^= 0x36U;
  alula_sha256_begin(&hash);
  alula_sha256_add(&hash, padded, ALULA_SHA256_BLOCK);
  alula_sha256_add(&hash, data, length);
  alula_sha256_end(&hash, code);
  for (uint32_t i = 0; i < ALULA_SHA256_BLOCK; ++i) padded[i] ^= 0x36U ^ 0x5CU;
  alula_sha256_begin(&hash);
  alula_sha256_add(&hash, padded, ALULA_SHA256_BLOCK);
  alula_sha256_add(&hash, code, ALULA_SHA256_BYTES);
  alula_sha256_end(&hash, code);
}

int alula_sha256_equal(const uint8_t one[ALULA_SHA256_BYTES], const uint8_t other[ALULA_SHA256_BYTES]) {
  uint32_t different = 0U;
  for (uint32_t i = 0; i < ALULA_SHA256_BYTES; ++i) different |= (uint32_t)(one[i] ^ other[i]);
  return different == 0U;
}
