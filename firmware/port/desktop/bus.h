// The desktop board's USB bus: tokens as a host controller sends them to a full-speed device. The device's side is
// TinyUSB's driver interface (dcd_*), in the same file.
#ifndef BUS_H
#define BUS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define BUS_PACKET 64
#define BUS_NAK    (-1) // not now
#define BUS_STALL  (-2)

void bus_reset(void);
void bus_unplug(void);

// Each runs the device's USB task after it. Endpoint numbers without direction.
void bus_setup(const uint8_t setup[8]);
int bus_in(unsigned endpoint, uint8_t packet[BUS_PACKET]); // bytes of the packet, NAK or STALL
int bus_out(unsigned endpoint, const uint8_t *packet, size_t size);

#endif
