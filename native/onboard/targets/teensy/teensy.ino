// Teensy 4.1 between a receiver and a flight controller: SBUS in, SBUS out, navigation on a serial line.
//
//   receiver's SBUS          -> pin 0 (RX1), without an external inverter: the port inverts
//   pin 8 (TX2)              -> SBUS of the flight controller
//   navigation, 921,600 baud -> pin 15 (RX3)
//   ground of all three      -> GND
//
// teensy_config.h has the fence and the vehicle, teensy_loop.h the rules for the sent frames. docs/guide/firmware.md
// explains the build and the bench tests.
#include "teensy_config.h"
#include "teensy_loop.h"

static constexpr uint32_t kReceiverBaud = 100000, kNavigationBaud = 921600, kReportUs = 100000;
static constexpr uint32_t kBitsOfByte = 12;  // with start, parity and two stop bits
static constexpr uint32_t kChunk = 64, kPauseUs = 500;  // between two frames

static alula_teensy_loop loop_state;
static alula_teensy_status status = ALULA_TEENSY_NO_RECEIVER;
static bool is_ready = false;
static uint8_t navigation_buffer[512];
static uint32_t next_us, report_us, slowest_us, period_us, late_frames;

// 0.5 s without service restart the board; the flight controller sees no frames meanwhile, which is its failsafe.
static void start_watchdog() {
  WDOG1_WMCR = 0;
  WDOG1_WCR = WDOG_WCR_WDE | WDOG_WCR_SRS | WDOG_WCR_WDA | WDOG_WCR_WT(0);
}

static void serve_watchdog() {
  WDOG1_WSR = 0x5555;
  WDOG1_WSR = 0xAAAA;
}

static uint32_t take(HardwareSerial& port, uint8_t* bytes) {
  uint32_t count = 0;
  while (count < kChunk && port.available() > 0) bytes[count++] = static_cast<uint8_t>(port.read());
  return count;
}

static void report() {
  const char* const names[] = {"no receiver", "override", "override lost", "locked",    "passed",
                               "blended",     "backup",   "no pilot",      "hand over", "lost",     "guided"};
  if (!is_ready) {
    Serial.println("fence or parameters refused: no frames");
    return;
  }
  Serial.printf("%s h_I %.2f m, %lu us at most, %lu late, frames %lu, packets %lu, bytes skipped %lu\n", names[status],
                static_cast<double>(loop_state.result.h_i), static_cast<unsigned long>(slowest_us),
                static_cast<unsigned long>(late_frames), static_cast<unsigned long>(loop_state.receiver.frames),
                static_cast<unsigned long>(loop_state.link.packets),
                static_cast<unsigned long>(loop_state.receiver.skipped + loop_state.link.skipped));
}

void setup() {
  Serial.begin(115200);
  Serial1.begin(kReceiverBaud, SERIAL_8E2_RXINV_TXINV);
  Serial2.begin(kControllerBaud, SERIAL_8E2_RXINV_TXINV);
  Serial3.begin(kNavigationBaud, SERIAL_8N1);
  Serial3.addStorageForRead(navigation_buffer, sizeof navigation_buffer);
  const alula_teensy_config config = vehicle_config();
  period_us = static_cast<uint32_t>(config.geofence.tick_s * 1e6F + 0.5F);
  const uint32_t frame_us = ALULA_SBUS_BYTES * kBitsOfByte * 1000000U / kControllerBaud;
  is_ready = frame_us + kPauseUs <= period_us && alula_teensy_init(&loop_state, vehicle_fence(), &config) == ALULA_READY;
  next_us = micros() + period_us;
  start_watchdog();
}

void loop() {
  uint8_t bytes[kChunk], out[ALULA_SBUS_BYTES];
  serve_watchdog();
  if (is_ready) {
    alula_teensy_receive(&loop_state, micros(), bytes, take(Serial1, bytes));
    alula_teensy_navigate(&loop_state, micros(), bytes, take(Serial3, bytes));
    const uint32_t now = micros();
    if (static_cast<int32_t>(now - next_us) >= 0) {
      status = alula_teensy_tick(&loop_state, now, out);
      Serial2.write(out, sizeof out);
      const uint32_t took = micros() - now;
      if (took > slowest_us) slowest_us = took;
      next_us += period_us;
      if (static_cast<int32_t>(now - next_us) >= 0) {  // a period late: continue from now
        ++late_frames;
        next_us = now + period_us;
      }
    }
  }
  if (micros() - report_us >= kReportUs && Serial.availableForWrite() > 200) {
    report_us = micros();
    report();
  }
}
