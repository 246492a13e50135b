// The fence and the vehicle of the sketch: change this file.
#pragma once

#include "teensy_loop.h"

// SBUS carries 200 frames a second at 100,000 baud, and 400 at 200,000: Betaflight's `set sbus_baud_fast = ON`.
constexpr uint32_t kControllerBaud = 100000;

// A box of 80 x 80 x 40 m around the origin of the navigation's frame; the ground, 2 m below it, is not a fence.
inline const alula_fence* vehicle_fence() {
  static alula_fence fence;
  fence.has_box = 1;
  const float lower[3] = {-40.0F, -40.0F, -2.0F}, upper[3] = {40.0F, 40.0F, 40.0F};
  for (int i = 0; i < 3; ++i) {
    fence.lower[i] = lower[i];
    fence.upper[i] = upper[i];
  }
  return &fence;
}

// The 7-inch racer of examples/vehicles/racer7.toml with Betaflight and the rates of alula_rates_defaults().
inline alula_teensy_config vehicle_config() {
  alula_teensy_config config = alula_teensy_defaults();
  config.geofence.tick_s = kControllerBaud == 200000 ? 0.0025F : 0.005F;
  config.geofence.radius_m = 0.25F;
  config.geofence.reserve_m = 2.5F;
  return config;
}
