// Where firmware is on this board, and what loader and application tell each other over a restart: words that the
// watchdog keeps and a power cut does not.
#ifndef SLOTS_H
#define SLOTS_H

#include <stdint.h>

#include "hardware/structs/watchdog.h"

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

#endif
