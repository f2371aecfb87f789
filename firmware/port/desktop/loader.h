// What the chip and its loader are on a real board: two slots of firmware behind the tables in flash, and the choice of
// one at each start. There is no machine code in an image for the desktop board: its first word says what the firmware
// in it would do, "hangs" or "mute" (it never comes up on its bus); anything else runs.
#ifndef LOADER_H
#define LOADER_H

#include <stdbool.h>
#include <stdint.h>

#include "tautline/tl_port.h"

#define LOADER_ROOM 65536U // bytes of a slot

typedef enum { LOADER_RUNS, LOADER_HANGS, LOADER_MUTE } loader_image_t;

// 64 hexadecimal digits: whose updates the board takes. False: they are none.
bool loader_key(const char *digits);

// At each start, with its reason: what runs from now on, and what it does.
loader_image_t loader_start(tl_wire_boot_t reason);

// For tl_port_t's update, NULL without a key. `erase` and `program` are the port's own, which count and may be cut.
const tl_port_update_t *loader_update(bool (*erase)(void *context, uint32_t offset),
                                      bool (*program)(void *context, uint32_t offset, const uint8_t *page));

// Whether the firmware has asked for a restart into the other slot.
bool loader_gave_up(void);

#endif
