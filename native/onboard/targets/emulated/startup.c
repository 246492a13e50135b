/* Reset of a Cortex-M with a floating-point unit: from the vector table to main(). */
#include <stdint.h>

#define CPACR (*(volatile uint32_t*)0xE000ED88U)
#define FULL_ACCESS_TO_CP10_AND_CP11 (0xFU << 20)

extern uint32_t data_begin[], data_end[], data_image[], bss_begin[], bss_end[], stack_top[];
int main(void);
void reset(void);
void stop(int code);
void count_round(void);

static void fault(void) { stop(99); }

__attribute__((section(".vectors"), used)) static const struct {
  uint32_t* stack;
  void (*handler[15])(void);
} VECTORS = {stack_top, {reset, fault, fault, fault, fault, fault, [14] = count_round}};

/* No float instruction may run before the coprocessor is enabled, so nothing is inlined here. */
__attribute__((noinline)) static void run(void) { stop(main()); }

void reset(void) {
  CPACR |= FULL_ACCESS_TO_CP10_AND_CP11;
  __asm volatile("dsb\n isb" ::: "memory");
  const uint32_t* from = data_image;
  for (uint32_t* to = data_begin; to < data_end; ++to) *to = *from++;
  for (uint32_t* to = bss_begin; to < bss_end; ++to) *to = 0U;
  run();
}
