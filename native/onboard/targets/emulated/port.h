/* What a replay needs of where it runs: files, a counter, the map. */
#ifndef ALULA_EMULATED_PORT_H
#define ALULA_EMULATED_PORT_H

#include <stdint.h>

/* Opens inputs.bin and outputs.bin of the working folder; 0 when that fails. */
int port_open(void);

/* The next bytes of the inputs; 0 when there are not as many. */
int port_read(void* to, uint32_t bytes);

/* Appends to the outputs; 0 when that fails. */
int port_write(const void* from, uint32_t bytes);

/* The map image, and how many bytes of memory begin there. */
const uint8_t* port_map(uint32_t* bytes);

/* Start counting, and what was counted: ticks of a clock that counts instructions under emulation,
 * nanoseconds on a host. UINT32_MAX when the counter ran over. */
void port_start(void);
uint32_t port_stop(void);

/* Bytes of the stack that were ever used; 0 on a host. */
uint32_t port_stack(void);

#endif
