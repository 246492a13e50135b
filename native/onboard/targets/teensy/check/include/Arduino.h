// Declarations of Teensy's core that the sketch uses, for compiling without it. Not Teensy's headers:
// written from its documentation, with only the names and types that the sketch needs.
#pragma once

#include <stddef.h>
#include <stdint.h>

constexpr uint16_t SERIAL_8N1 = 0x00, SERIAL_8E2_RXINV_TXINV = 0x136;

class HardwareSerial {
 public:
  void begin(uint32_t baud, uint16_t format = 0);
  int available();
  int read();
  size_t write(const uint8_t* bytes, size_t count);
  void addStorageForRead(void* buffer, size_t length);
};
extern HardwareSerial Serial1, Serial2, Serial3;

class usb_serial_class {
 public:
  void begin(long baud);
  size_t println(const char* text);
  int printf(const char* format, ...) __attribute__((format(printf, 2, 3)));
  int availableForWrite();
};
extern usb_serial_class Serial;

uint32_t micros();

extern volatile uint16_t WDOG1_WCR, WDOG1_WSR, WDOG1_WMCR;
constexpr uint16_t WDOG_WCR_WDE = 1U << 2, WDOG_WCR_SRS = 1U << 4, WDOG_WCR_WDA = 1U << 5;
constexpr uint16_t WDOG_WCR_WT(unsigned halfSeconds) { return static_cast<uint16_t>(halfSeconds << 8); }

void setup();
void loop();
