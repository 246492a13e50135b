/* The lines of receiver and navigation with any bytes, and pauses. */
#include "alula_navigation_link.h"
#include "alula_sbus.h"
#include "fuzz.h"

static void check_frame(const alula_sbus_parser* parser, const alula_sbus_frame* frame) {
  uint8_t again[ALULA_SBUS_BYTES];
  alula_sbus_encode(frame, again);
  CHECK(memcmp(again, parser->bytes, ALULA_SBUS_BYTES - 1U) == 0); /* the last byte has more than one form */
}

static void check_packet(const alula_navigation* packet) {
  for (int i = 0; i < 3; ++i) {
    CHECK(fabsf(packet->state.position[i]) <= 2147484.0F && fabsf(packet->state.velocity[i]) <= 327.69F);
    CHECK(fabsf(packet->state.rates[i]) <= 65.54F);
  }
  for (int i = 0; i < 4; ++i) CHECK(fabsf(packet->state.attitude[i]) <= 1.0001F);
}

/* Sends a packet; the input decides whether its checksum is right, because mutation alone finds no right one. */
static void send_packet(bytes* in, alula_navigation_parser* parser) {
  alula_navigation sent = {.flags = (uint8_t)take(in, 1)}, found;
  uint8_t packet[ALULA_NAVIGATION_BYTES];
  take_floats(in, 1.0e6F, sent.state.position, 3);
  take_floats(in, 300.0F, sent.state.velocity, 3);
  take_floats(in, 1.0F, sent.state.attitude, 4);
  take_floats(in, 60.0F, sent.state.rates, 3);
  if (!alula_navigation_encode(&sent, packet)) return;
  CHECK(alula_navigation_decode(packet, &found));
  const uint32_t at = take(in, 1) % ALULA_NAVIGATION_BYTES, by = take(in, 1);
  packet[at] = (uint8_t)(packet[at] ^ by);
  CHECK((alula_navigation_decode(packet, &found) != 0) == (by == 0U)); /* detects any damage of one byte */
  for (uint32_t i = 0; i < ALULA_NAVIGATION_BYTES; ++i) {
    if (alula_navigation_push(parser, packet[i], &found)) check_packet(&found);
  }
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  bytes in = {data, size};
  alula_sbus_parser receiver;
  alula_navigation_parser link;
  alula_sbus_frame frame;
  alula_navigation packet;
  alula_sbus_begin(&receiver);
  alula_navigation_begin(&link);
  uint32_t received = 0U;
  while (in.left > 0U) {
    const uint32_t what = take(&in, 1);
    if (what == 0xEEU) alula_sbus_idle(&receiver);
    if (what == 0xEFU) send_packet(&in, &link);
    if (what == 0xEEU || what == 0xEFU) continue;
    ++received;
    if (alula_sbus_push(&receiver, (uint8_t)what, &frame)) check_frame(&receiver, &frame);
    if (alula_navigation_push(&link, (uint8_t)what, &packet)) check_packet(&packet);
    CHECK(receiver.count < ALULA_SBUS_BYTES && link.count < ALULA_NAVIGATION_BYTES);
  }
  CHECK(receiver.skipped + receiver.count + ALULA_SBUS_BYTES * receiver.frames == received);
  return 0;
}
