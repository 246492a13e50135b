// The devices at both ends of the Teensy's lines: a radio and a flight controller; and the yard of the flights.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "alula/dynamics/racer.hpp"
#include "teensy_loop.h"

inline alula_fence onboard_yard() {
  alula_fence fence{};
  fence.has_box = 1;
  const float lower[3] = {-150, -150, 0}, upper[3] = {40, 150, 90};
  std::copy(lower, lower + 3, fence.lower), std::copy(upper, upper + 3, fence.upper);
  return fence;
}

inline std::uint16_t channel_of(float us) { return static_cast<std::uint16_t>(std::lround((us - 880) * 1.6F)); }

// The command that a flight controller decodes from a frame.
inline alula::flight::RacerCommand heard_by_controller(const alula_teensy_config& c, const alula_sbus_frame& frame,
                                                       bool truncates = false) {
  const auto us = [&](std::uint8_t channel) {
    const float exact = 880 + 0.625F * static_cast<float>(frame.channel[channel]);
    return truncates ? std::floor(exact) : exact;
  };
  const auto rate = [&](int axis, std::uint8_t channel) {
    const float x = (us(channel) - c.rates.middle_us) / 500;
    return static_cast<double>((axis == 2 ? -1.0F : 1.0F) * alula_rates_at(&c.rates.axis[axis], x));
  };
  const float span = c.rates.throttle_high_us - c.rates.throttle_low_us;
  const float throttle = std::clamp((us(c.throttle) - c.rates.throttle_low_us) / span, 0.0F, 1.0F);
  return {static_cast<double>(throttle), {rate(0, c.roll), rate(1, c.pitch), rate(2, c.yaw)}};
}

inline alula_sbus_frame radio_frame(const alula_teensy_config& c, const alula::flight::RacerCommand& u) {
  alula_sbus_frame frame{};
  for (std::size_t i = 0; i < 16; ++i) frame.channel[i] = static_cast<std::uint16_t>(200 + 97 * i);
  const auto deflection = [&](int axis) {
    const float x = alula_rates_deflection(&c.rates.axis[axis], static_cast<float>(u.rates[axis]));
    return channel_of(c.rates.middle_us + (axis == 2 ? -500 : 500) * x);
  };
  frame.channel[c.roll] = deflection(0), frame.channel[c.pitch] = deflection(1), frame.channel[c.yaw] = deflection(2);
  frame.channel[c.throttle] =
      channel_of(c.rates.throttle_low_us +
                 static_cast<float>(u.throttle) * (c.rates.throttle_high_us - c.rates.throttle_low_us));
  frame.channel[c.override_channel] = 172;
  return frame;
}
