/* The platform interface of a replay: files, a counter, the map. */
#ifndef ALULA_EMULATED_PORT_H
#define ALULA_EMULATED_PORT_H

#include <stdint.h>

/* Opens inputs.bin and outputs.bin of the working folder; 0 when that fails. */
int port_open(void);

/* Reads the next bytes of the inputs; 0 when too few remain. */
int port_read(void* to, uint32_t bytes);

/* Appends to the outputs; 0 when that fails. */
int port_write(const void* from, uint32_t bytes);

/* The map image, and the number of bytes of memory from there on. */
const uint8_t* port_map(uint32_t* bytes);

/* port_start starts the counter and port_stop returns it: ticks of a clock that counts instructions under emulation,
 * nanoseconds on a host. UINT32_MAX when the counter overflowed. */
void port_start(void);
uint32_t port_stop(void);

/* Maximum number of bytes of the stack used so far; 0 on a host. */
uint32_t port_stack(void);

#endif
