/// Two slots for firmware, and which of them runs. The loader, the application and the desktop board share this; it
/// needs no more than flash to read.
///
/// A slot's first sector says what the rest is: a *record* (size and CRC-32 of the image, a sequence number), written
/// last, without which there is no image; a mark that the image is *confirmed*, one that it has *failed*; and the page
/// that it came with (tl_update.h). Marks are pages that are programmed once, the same bytes each time: power that goes
/// meanwhile leaves no mark, and the next attempt completes it. The image begins with the second sector.
///
/// The newest whole image that has not failed runs. It is on trial until it is confirmed: if it is restarted by a
/// watchdog before, the other one runs. A cut of power says nothing against it: it is tried again.
#ifndef TAUTLINE_TL_BOOT_H
#define TAUTLINE_TL_BOOT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define TL_BOOT_SLOTS     2U
#define TL_BOOT_NONE      0xFFU ///< in place of a slot
#define TL_BOOT_PAGE      256U
#define TL_BOOT_SECTOR    4096U
#define TL_BOOT_RECORD    0U ///< offsets in a slot
#define TL_BOOT_CONFIRMED TL_BOOT_PAGE
#define TL_BOOT_FAILED    (2U * TL_BOOT_PAGE)
#define TL_BOOT_HEAD      (3U * TL_BOOT_PAGE)
#define TL_BOOT_IMAGE     TL_BOOT_SECTOR

/// How to read a slot.
typedef struct {
    void (*read)(void *context, uint8_t slot, uint32_t offset, uint8_t *out, size_t size);
    void *context;
    uint32_t room; ///< bytes of a slot
} tl_boot_flash_t;

typedef struct {
    bool whole;     ///< record and image are as they were written; else the rest is not known
    bool confirmed; ///< it has shown that it can be replaced
    bool failed;
    uint32_t sequence; ///< rises by one with each update
    uint32_t size;     ///< bytes of the image
} tl_boot_slot_t;

/// O(size), about 30 cycles a byte on a Cortex-M0+.
tl_boot_slot_t tl_boot_slot(const tl_boot_flash_t *flash, uint8_t slot);

typedef struct {
    uint8_t slot; ///< TL_BOOT_NONE: there is no image that may run
    bool trial;
} tl_boot_choice_t;

/// `failed`: the slot whose trial has just ended by a watchdog, TL_BOOT_NONE: none.
tl_boot_choice_t tl_boot_choose(const tl_boot_flash_t *flash, uint8_t failed);

/// CRC-32 of the first `size` bytes of a slot's image.
uint32_t tl_boot_crc(const tl_boot_flash_t *flash, uint8_t slot, uint32_t size);

/// The pages: TL_BOOT_PAGE bytes to program.
void tl_boot_make_record(uint8_t *page, uint32_t sequence, uint32_t size, uint32_t crc);
void tl_boot_make_mark(uint8_t *page);

#endif
