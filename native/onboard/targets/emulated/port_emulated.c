/* Semihosting and SysTick of a Cortex-M under QEMU. */
#include "port.h"

#define SYS_OPEN 0x01U
#define SYS_WRITE 0x05U
#define SYS_READ 0x06U
#define SYS_EXIT_EXTENDED 0x20U
#define STOPPED_APPLICATION_EXIT 0x20026U
#define MODE_READ_BINARY 1U
#define MODE_WRITE_BINARY 5U

#define SYSTICK_CONTROL (*(volatile uint32_t*)0xE000E010U)
#define SYSTICK_RELOAD (*(volatile uint32_t*)0xE000E014U)
#define SYSTICK_VALUE (*(volatile uint32_t*)0xE000E018U)
#define SYSTICK_MOST 0xFFFFFFU
#define SYSTICK_ON_CORE_CLOCK 5U
#define SYSTICK_INTERRUPTS 2U

#define PAINT 0xA5C3F00DU

extern uint32_t stack_bottom[], stack_top[];
extern const uint8_t map_begin[], map_end[];
void stop(int code);
void count_round(void);

static volatile uint32_t rounds; /* overflows of the counter, which has 24 bits */
static uint32_t inputs, outputs;

static uint32_t call(uint32_t operation, const uint32_t* arguments) {
  register uint32_t r0 __asm("r0") = operation;
  register const uint32_t* r1 __asm("r1") = arguments;
  __asm volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
  return r0;
}

void stop(int code) {
  const uint32_t arguments[2] = {STOPPED_APPLICATION_EXIT, (uint32_t)code};
  (void)call(SYS_EXIT_EXTENDED, arguments);
  for (;;) {
  }
}

static uint32_t open_file(const char* name, uint32_t length, uint32_t mode) {
  const uint32_t arguments[3] = {(uint32_t)(uintptr_t)name, mode, length};
  return call(SYS_OPEN, arguments);
}

static void paint_stack(void) {
  const uint32_t* const here = __builtin_frame_address(0);
  for (volatile uint32_t* p = stack_bottom; p + 16 < here; ++p) *p = PAINT;
}

int port_open(void) {
  paint_stack();
  inputs = open_file("inputs.bin", 10U, MODE_READ_BINARY);
  outputs = open_file("outputs.bin", 11U, MODE_WRITE_BINARY);
  return inputs != UINT32_MAX && outputs != UINT32_MAX;
}

int port_read(void* to, uint32_t bytes) {
  const uint32_t arguments[3] = {inputs, (uint32_t)(uintptr_t)to, bytes};
  return call(SYS_READ, arguments) == 0U;
}

int port_write(const void* from, uint32_t bytes) {
  const uint32_t arguments[3] = {outputs, (uint32_t)(uintptr_t)from, bytes};
  return call(SYS_WRITE, arguments) == 0U;
}

const uint8_t* port_map(uint32_t* bytes) {
  *bytes = (uint32_t)(map_end - map_begin);
  return map_begin;
}

void count_round(void) { ++rounds; }

void port_start(void) {
  SYSTICK_CONTROL = 0U;
  rounds = 0U;
  SYSTICK_RELOAD = SYSTICK_MOST;
  SYSTICK_VALUE = 0U; /* any write clears it and the flag */
  SYSTICK_CONTROL = SYSTICK_ON_CORE_CLOCK | SYSTICK_INTERRUPTS;
  while (SYSTICK_VALUE == 0U) { /* the counter reloads with the first tick */
  }
}

uint32_t port_stop(void) {
  uint32_t value, before;
  do {
    before = rounds;
    value = SYSTICK_VALUE;
  } while (before != rounds);
  SYSTICK_CONTROL = 0U;
  return before < 256U ? before * (SYSTICK_MOST + 1U) + (SYSTICK_MOST - value) : UINT32_MAX;
}

uint32_t port_stack(void) {
  const uint32_t* p = stack_bottom;
  while (p < stack_top && *p == PAINT) ++p;
  return (uint32_t)(stack_top - p) * 4U;
}
