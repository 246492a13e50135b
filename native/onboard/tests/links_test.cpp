// SBUS and the navigation link: bits against a reference that shifts them one by one, and arbitrary bytes on a line.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <random>
#include <vector>

#include "alula_navigation_link.h"
#include "alula_sbus.h"
#include "check.hpp"

namespace {

using Bytes = std::vector<std::uint8_t>;

alula_sbus_frame random_frame(std::mt19937& random) {
  alula_sbus_frame frame{};
  for (std::uint16_t& c : frame.channel) c = static_cast<std::uint16_t>(random() & 2047U);
  frame.flags = static_cast<std::uint8_t>(random() & 15U);
  return frame;
}

bool is_same(const alula_sbus_frame& a, const alula_sbus_frame& b) {
  return std::equal(a.channel, a.channel + 16, b.channel) && a.flags == b.flags;
}

void append(Bytes& stream, const alula_sbus_frame& frame) {
  std::uint8_t bytes[ALULA_SBUS_BYTES];
  alula_sbus_encode(&frame, bytes);
  stream.insert(stream.end(), bytes, bytes + ALULA_SBUS_BYTES);
}

std::vector<alula_sbus_frame> frames_in(const Bytes& stream) {
  alula_sbus_parser parser;
  alula_sbus_begin(&parser);
  std::vector<alula_sbus_frame> found;
  alula_sbus_frame frame;
  for (const std::uint8_t byte : stream)
    if (alula_sbus_push(&parser, byte, &frame)) found.push_back(frame);
  CHECK(parser.frames == found.size());
  CHECK(parser.skipped + parser.count + ALULA_SBUS_BYTES * parser.frames == stream.size());
  return found;
}

void test_every_bit_of_a_channel_is_where_it_belongs() {
  std::mt19937 random(1);
  for (int k = 0; k < 2000; ++k) {
    const alula_sbus_frame frame = random_frame(random);
    Bytes bytes;
    append(bytes, frame);
    CHECK(bytes[0] == 0x0F && bytes[24] == 0 && bytes[23] == frame.flags);
    for (unsigned bit = 0; bit < 176; ++bit) {
      const unsigned sent = frame.channel[bit / 11] >> bit % 11 & 1U;
      CHECK((bytes[1 + bit / 8] >> bit % 8 & 1U) == sent);
    }
    alula_sbus_frame read{};
    CHECK(alula_sbus_decode(bytes.data(), &read) && is_same(frame, read));
  }
  alula_sbus_frame beyond{};
  beyond.channel[3] = 65535, beyond.flags = 255;
  Bytes bytes;
  append(bytes, beyond);
  alula_sbus_frame read{};
  CHECK(alula_sbus_decode(bytes.data(), &read) && read.channel[3] == 2047 && read.channel[4] == 0 &&
        read.flags == 15);
}

void test_bytes_that_are_no_frame_are_none() {
  std::mt19937 random(2);
  Bytes good;
  append(good, random_frame(random));
  for (unsigned value = 0; value < 256; ++value) {
    alula_sbus_frame frame;
    for (const std::size_t at : {0U, 23U, 24U}) {
      Bytes bytes = good;
      bytes[at] = static_cast<std::uint8_t>(value);
      const bool is_good = at == 0    ? value == 0x0F
                           : at == 23 ? value < 16
                                      : value == 0 || value == 4 || value == 0x14 || value == 0x24 || value == 0x34;
      CHECK((alula_sbus_decode(bytes.data(), &frame) != 0) == is_good);
    }
  }
}

void test_a_stream_is_found_again_after_anything() {
  std::mt19937 random(3);
  for (int k = 0; k < 300; ++k) {
    Bytes stream;
    for (unsigned i = random() % 60; i > 0; --i) stream.push_back(static_cast<std::uint8_t>(random()));
    std::vector<alula_sbus_frame> sent;
    for (int i = 0; i < 8; ++i) append(stream, sent.emplace_back(random_frame(random)));
    const std::vector<alula_sbus_frame> found = frames_in(stream);
    CHECK(!found.empty() && is_same(found.back(), sent.back()));
    int good = 0;
    for (const auto& frame : found)
      good += std::any_of(sent.begin(), sent.end(), [&](const auto& s) { return is_same(s, frame); }) ? 1 : 0;
    CHECK(good >= 6);
  }
}

// Equal frames with channels that look like a start and an end: without pauses a reader can stay misaligned
// permanently, with pauses for one frame only.
void test_a_pause_ends_what_only_looks_like_a_frame() {
  alula_sbus_frame frame{};
  Bytes one;
  append(one, frame);
  one[10] = 0x0F, one[9] = 0x00, one[8] = 0x00;
  Bytes stream(one.begin() + 10, one.end());
  for (int i = 0; i < 4; ++i) stream.insert(stream.end(), one.begin(), one.end());
  alula_sbus_parser parser;
  alula_sbus_begin(&parser);
  int askew = 0, straight = 0;
  for (std::size_t at = 0; at < stream.size(); ++at) {
    if (at >= 15 && (at - 15) % 25 == 0) alula_sbus_idle(&parser);
    if (!alula_sbus_push(&parser, stream[at], &frame)) continue;
    Bytes again;
    append(again, frame);
    (again == one ? straight : askew) += 1;
  }
  CHECK(askew == 0 && straight == 4);
  CHECK(frames_in(stream).size() == 4);
}

alula_navigation random_navigation(std::mt19937& random) {
  std::uniform_real_distribution<float> unit(-1, 1);
  alula_navigation n{};
  float square = 0;
  for (int i = 0; i < 3; ++i) {
    n.state.position[i] = 900 * unit(random);
    n.state.velocity[i] = 60 * unit(random);
    n.state.rates[i] = 30 * unit(random);
  }
  for (float& q : n.state.attitude) q = unit(random), square += q * q;
  for (float& q : n.state.attitude) q /= std::sqrt(square);
  n.time_us = static_cast<std::uint32_t>(random());
  n.sequence = static_cast<std::uint16_t>(random());
  n.flags = ALULA_NAVIGATION_VALID;
  return n;
}

Bytes packet_of(const alula_navigation& n) {
  Bytes bytes(ALULA_NAVIGATION_BYTES);
  CHECK(alula_navigation_encode(&n, bytes.data()));
  return bytes;
}

// By division of polynomials, a bit at a time, over the message with 16 zeros behind it.
unsigned crc_by_division(const std::uint8_t* bytes, std::size_t length) {
  std::vector<bool> bits;
  for (std::size_t i = 0; i < length; ++i)
    for (int b = 7; b >= 0; --b) bits.push_back((bytes[i] >> b & 1U) != 0);
  for (int i = 0; i < 16; ++i) bits[static_cast<std::size_t>(i)] = !bits[static_cast<std::size_t>(i)];
  bits.resize(bits.size() + 16, false);
  for (std::size_t i = 0; i + 16 < bits.size(); ++i) {
    if (!bits[i]) continue;
    for (const std::size_t j : {0U, 4U, 11U, 16U}) bits[i + j] = !bits[i + j];
  }
  unsigned rest = 0;
  for (std::size_t i = bits.size() - 16; i < bits.size(); ++i) rest = rest << 1 | (bits[i] ? 1U : 0U);
  return rest;
}

void test_a_packet_comes_back_within_what_it_rounds() {
  const std::uint8_t digits[] = {'1', '2', '3', '4', '5', '6', '7', '8', '9'};
  CHECK(crc_by_division(digits, sizeof digits) == 0x29B1U);
  std::mt19937 random(4);
  for (int k = 0; k < 2000; ++k) {
    const alula_navigation sent = random_navigation(random);
    const Bytes bytes = packet_of(sent);
    CHECK(bytes[0] == 0xA1 && bytes[1] == 0x5A && bytes[2] == 1);
    CHECK(static_cast<unsigned>(bytes[42] | bytes[43] << 8) == crc_by_division(bytes.data(), 42));
    alula_navigation read{};
    CHECK(alula_navigation_decode(bytes.data(), &read));
    CHECK(read.sequence == sent.sequence && read.time_us == sent.time_us && read.flags == sent.flags);
    for (int i = 0; i < 3; ++i) {
      CHECK(std::fabs(read.state.position[i] - sent.state.position[i]) <= 0.00062F);
      CHECK(std::fabs(read.state.velocity[i] - sent.state.velocity[i]) <= 0.00501F);
      CHECK(std::fabs(read.state.rates[i] - sent.state.rates[i]) <= 0.00101F);
    }
    for (int i = 0; i < 4; ++i) CHECK(std::fabs(read.state.attitude[i] - sent.state.attitude[i]) <= 1.6e-5F);
    CHECK(alula_racer_state_is_valid(&read.state));
  }
}

void test_what_does_not_fit_is_not_sent() {
  std::mt19937 random(5);
  const alula_navigation good = random_navigation(random);
  const float bad[] = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), -3e9F};
  for (std::size_t at = 0; at < sizeof good.state / sizeof(float); ++at) {
    for (const float value : bad) {
      alula_navigation n = good;
      std::memcpy(reinterpret_cast<char*>(&n.state) + at * sizeof(float), &value, sizeof value);
      Bytes bytes(ALULA_NAVIGATION_BYTES, 7);
      CHECK(!alula_navigation_encode(&n, bytes.data()));
      CHECK(bytes == Bytes(ALULA_NAVIGATION_BYTES, 7));
    }
  }
}

void test_a_damaged_packet_is_refused() {
  std::mt19937 random(6);
  alula_navigation read;
  for (int k = 0; k < 4; ++k) {
    const Bytes good = packet_of(random_navigation(random));
    const auto flipped = [&](std::initializer_list<unsigned> bits) {
      Bytes bytes = good;
      for (const unsigned bit : bits) bytes[bit / 8] = static_cast<std::uint8_t>(bytes[bit / 8] ^ 1U << bit % 8);
      return bytes;
    };
    for (unsigned a = 0; a < 8 * ALULA_NAVIGATION_BYTES; ++a) {
      CHECK(!alula_navigation_decode(flipped({a}).data(), &read));
      for (unsigned b = 0; b < a; ++b) CHECK(!alula_navigation_decode(flipped({a, b}).data(), &read));
    }
    for (int i = 0; i < 20000; ++i) {
      const unsigned a = random() % 352, b = random() % 352, c = random() % 352;
      if (a != b && b != c && a != c) CHECK(!alula_navigation_decode(flipped({a, b, c}).data(), &read));
    }
  }
}

// Flipped bits, lost bytes and noise between packets: every packet found was sent, and after the noise all are found.
void test_packets_are_found_in_a_bad_stream() {
  std::mt19937 random(7);
  int found = 0, foreign = 0, total = 0;
  for (int k = 0; k < 200; ++k) {
    std::vector<Bytes> sent;
    Bytes stream;
    for (int i = 0; i < 30; ++i) {
      sent.push_back(packet_of(random_navigation(random)));
      Bytes bytes = sent.back();
      if (i < 20 && random() % 3 == 0) {
        const unsigned bit = static_cast<unsigned>(random() % 352);
        bytes[bit / 8] = static_cast<std::uint8_t>(bytes[bit / 8] ^ 1U << bit % 8);
      }
      if (i < 20 && random() % 5 == 0) bytes.erase(bytes.begin() + static_cast<std::ptrdiff_t>(random() % 44));
      for (unsigned noise = i < 20 ? random() % 20 : 0; noise > 0; --noise) bytes.push_back(0xA1);
      stream.insert(stream.end(), bytes.begin(), bytes.end());
    }
    alula_navigation_parser parser;
    alula_navigation_begin(&parser);
    alula_navigation n;
    int tail = 0;
    for (const std::uint8_t byte : stream) {
      if (!alula_navigation_push(&parser, byte, &n)) continue;
      const Bytes again(parser.bytes, parser.bytes + ALULA_NAVIGATION_BYTES);
      const auto at = std::find(sent.begin(), sent.end(), again);
      (at == sent.end() ? foreign : found) += 1;
      if (at != sent.end() && at - sent.begin() >= 21) ++tail;
    }
    total += 30;
    CHECK(tail == 9);
    CHECK(parser.skipped + parser.count + ALULA_NAVIGATION_BYTES * parser.packets == stream.size());
  }
  CHECK(foreign == 0);
  CHECK(found > total / 2);
}

void test_noise_is_never_more_than_noise() {
  std::mt19937 random(8);
  alula_sbus_parser sbus;
  alula_navigation_parser link;
  alula_sbus_begin(&sbus);
  alula_navigation_begin(&link);
  alula_sbus_frame frame;
  alula_navigation n;
  int packets = 0;
  const std::uint8_t likely[] = {0x0F, 0x00, 0x04, 0xA1, 0x5A, 0x01};
  for (int k = 0; k < 2000000; ++k) {
    const std::uint32_t r = static_cast<std::uint32_t>(random());
    const std::uint8_t byte = r % 3 == 0 ? likely[r / 3 % 6] : static_cast<std::uint8_t>(r >> 8);
    if (alula_sbus_push(&sbus, byte, &frame)) CHECK(frame.flags < 16);
    if (alula_navigation_push(&link, byte, &n)) ++packets;
    CHECK(sbus.count < ALULA_SBUS_BYTES && link.count < ALULA_NAVIGATION_BYTES);
  }
  CHECK(packets < 10);
}

}  // namespace

int main() {
  test_every_bit_of_a_channel_is_where_it_belongs();
  test_bytes_that_are_no_frame_are_none();
  test_a_stream_is_found_again_after_anything();
  test_a_pause_ends_what_only_looks_like_a_frame();
  test_a_packet_comes_back_within_what_it_rounds();
  test_what_does_not_fit_is_not_sent();
  test_a_damaged_packet_is_refused();
  test_packets_are_found_in_a_bad_stream();
  test_noise_is_never_more_than_noise();
  return alula_failures == 0 ? 0 : 1;
}
