// Where firmware is on this board, and what loader and application tell each other over a restart: words that the
// watchdog keeps and a power cut does not.
#ifndef SLOTS_H
#define SLOTS_H

#include <stddef.h>
#include <stdint.h>

#include "hardware/structs/watchdog.h"
#include "tautline/tl_port.h"

// SLOT_0, SLOT_1, SLOT_ROOM: offsets in flash and bytes, from CMakeLists.txt, where images are linked for them.
#define SLOTS_BEGIN(slot) ((slot) == 0U ? (uint32_t)(SLOT_0) : (uint32_t)(SLOT_1))
#define SLOTS_VECTORS     0x100U // in an image, behind a second stage that is not used

// The slot whose image is on trial and has been started: to be cleared when it is confirmed, or restarts on request.
#define SLOTS_TRIAL    0x7472690AU
#define SLOTS_TRIAL_OF (watchdog_hw->scratch[0])
// The slot whose trial a watchdog has ended.
#define SLOTS_FAILED    0x6661690AU
#define SLOTS_FAILED_OF (watchdog_hw->scratch[1])

#define SLOTS_WATCHDOG_MAGIC 0x6AB73121U // the SDK's, in scratch[4]: the restart is the watchdog's, nobody asked for it

// main.c's, for both.
/// Erases the sector at an offset in flash, or programs a page there; whether that was done. With every motor off.
bool board_flash_safely(uint32_t offset, const uint8_t *page);
/// Sets the watchdog; 0: as usual.
void board_watch(uint32_t ms);

#ifdef SLOT_0
/// What a port takes updates with, by what the loader chose.
const tl_port_update_t *slots_update(const tl_port_t *port);
/// A restart that was asked for says nothing against what runs.
void slots_end_trial(void);
#else // a chip without slots: its firmware does not come over USB
static inline const tl_port_update_t *slots_update(const tl_port_t *port) {
    (void)port;
    return NULL;
}
static inline void slots_end_trial(void) {}
#endif

#endif
