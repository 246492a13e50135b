// The Crazyflie's app with a stand-in for its firmware: set-points in, set-points out.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <semaphore>
#include <thread>
#include <vector>

#include "box_map.hpp"
#include "check.hpp"

extern "C" {
#include "FreeRTOS.h"
#include "controller.h"
#include "controller_pid.h"
#include "log.h"
#include "task.h"
#include "usec_time.h"
void appMain(void);
extern std::uint8_t alula_test_map[];
extern std::uint32_t alula_test_map_bytes;
std::uint8_t alula_test_map[1 << 16];
std::uint32_t alula_test_map_bytes = 0;
}

namespace {

using Vector = std::array<double, 3>;
constexpr double kStep = 0.001;
const float kNaN = std::numeric_limits<float>::quiet_NaN();

std::binary_semaphore turn_of_app{0}, turn_of_loop{0};
setpoint_t flown_setpoint;
int pid_calls = 0;
float variances[3] = {1e-4F, 1e-4F, 1e-4F};

void let_app_run() {
  turn_of_app.release();
  turn_of_loop.acquire();
}

void test_the_app_flies_the_filtered_set_point() {
  const std::vector<std::uint8_t> image = box_map(obstacles());
  std::copy(image.begin(), image.end(), alula_test_map);
  alula_test_map_bytes = static_cast<std::uint32_t>(image.size());
  controllerOutOfTreeInit();
  CHECK(controllerOutOfTreeTest());
  controllerOutOfTreeInit();  // selected again: unchanged
  CHECK(controllerOutOfTreeTest());
  std::thread(appMain).detach();
  turn_of_loop.acquire();

  setpoint_t request{};
  state_t state{};
  const sensorData_t sensors{};
  control_t control{};
  Vector p{-5.3, -5.3, 1};
  stabilizerStep_t step = 1;
  const auto run = [&](int count) {
    double least = 1e9;
    for (int k = 0; k < count; ++k, ++step) {
      state.position.x = static_cast<float>(p[0]), state.position.y = static_cast<float>(p[1]);
      state.position.z = static_cast<float>(p[2]);
      controllerOutOfTree(&control, &request, &sensors, &state, step);
      if (flown_setpoint.mode.x == modeVelocity) {
        p[0] += kStep * static_cast<double>(flown_setpoint.velocity.x);
        p[1] += kStep * static_cast<double>(flown_setpoint.velocity.y);
        p[2] += kStep * static_cast<double>(flown_setpoint.velocity.z);
      }
      least = std::min(least, distance(p));
      let_app_run();
    }
    return least;
  };
  state.attitudeQuaternion.w = state.attitudeQuaternion.z = 0.70710678F;  // to the left
  run(20);
  CHECK(pid_calls == 20 && flown_setpoint.mode.x == modeDisable && flown_setpoint.thrust == 0.0F);

  request.mode.x = request.mode.y = request.mode.z = modeVelocity;
  request.mode.yaw = modeVelocity, request.attitudeRate.yaw = 10;
  request.velocity_body = true, request.velocity.x = 0.5F;  // ahead, which is to the left
  run(30);
  CHECK(!flown_setpoint.velocity_body && flown_setpoint.mode.yaw == modeVelocity);
  CHECK(flown_setpoint.attitudeRate.yaw == 10.0F);
  CHECK(std::fabs(flown_setpoint.velocity.x) < 1e-6F && std::fabs(flown_setpoint.velocity.y - 0.5F) < 1e-6F);

  request.velocity_body = false, request.velocity.x = 1, request.velocity.y = 0.3F;  // into the pillars
  const double least = run(8000);
  CHECK(least >= 0.15 - 1e-5 && least < 0.3);

  request.mode.roll = request.mode.pitch = modeVelocity;  // rates as well: they do not override the velocity
  run(1);
  CHECK(flown_setpoint.mode.roll == modeDisable && flown_setpoint.mode.pitch == modeDisable);
  request.mode.roll = request.mode.pitch = modeDisable;

  const auto is_still = [] {
    return flown_setpoint.mode.z == modeVelocity && flown_setpoint.velocity.x == 0.0F &&
           flown_setpoint.velocity.y == 0.0F && flown_setpoint.velocity.z == 0.0F;
  };
  request.velocity.x = request.velocity.y = 0, request.velocity.z = 0.2F;
  run(30);
  CHECK(!is_still());
  variances[1] = 0.1F;
  run(1);
  CHECK(is_still());
  variances[1] = kNaN;
  run(30);
  CHECK(is_still());
  variances[1] = 1e-4F;
  run(30);
  CHECK(!is_still());

  setpoint_t by_hand{};
  by_hand.thrust = 40000, by_hand.attitude.pitch = 20;
  request = by_hand;
  run(5);
  CHECK(is_still());
  request.thrust = 0;  // cut
  run(1);
  CHECK(flown_setpoint.mode.z == modeDisable && flown_setpoint.thrust == 0.0F);
}

}  // namespace

extern "C" {
void controllerPidInit(void) {}
bool controllerPidTest(void) { return true; }
void controllerPid(control_t*, const setpoint_t* setpoint, const sensorData_t*, const state_t*, stabilizerStep_t) {
  flown_setpoint = *setpoint;
  ++pid_calls;
}
logVarId_t logGetVarId(const char*, const char* name) { return static_cast<logVarId_t>(name[3] - 'X'); }
float logGetFloat(logVarId_t id) { return variances[id]; }
void vTaskDelay(TickType_t) {
  turn_of_loop.release();
  turn_of_app.acquire();
}
std::uint64_t usecTimestamp(void) { return 0; }
void check_print(const char*, ...) {}
}

int main() {
  test_the_app_flies_the_filtered_set_point();
  std::fflush(nullptr);
  std::_Exit(alula_failures == 0 ? 0 : 1);  // the app's task never ends
}
