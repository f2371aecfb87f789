// What tl_store.h says of a slot in flash, and of two which is to be tried first.
#ifndef SLOT_MODEL_H
#define SLOT_MODEL_H

#include "tautline/tl_store.h"
#include "words.h"

#include <string.h>

static inline bool is_blank(const uint8_t *bytes, size_t size) {
    size_t i = 0;
    while (i < size && bytes[i] == 0xFFU) {
        i++;
    }
    return i == size;
}

// `bytes`: the slot's sector, `offset` of the region.
static inline tl_slot_t slot_in(const uint8_t *bytes, uint32_t offset) {
    const bool dated =
        memcmp(bytes, "SLOT", 4) == 0 && word(bytes, 4) == crc_of(bytes, 16) && word(bytes, 2) <= TL_TABLE_SIZE_MAX;
    tl_slot_t slot = {.blank = is_blank(bytes, TL_PORT_FLASH_PAGE), .dated = dated};
    if (dated) {
        slot.sequence = word(bytes, 1);
        slot.size = (uint16_t)word(bytes, 2);
        slot.crc = word(bytes, 3);
        slot.blob = offset + TL_PORT_FLASH_PAGE;
        slot.whole = crc_of(bytes + TL_PORT_FLASH_PAGE, slot.size) == slot.crc;
    }
    return slot;
}

static inline bool is_same(const tl_slot_t *a, const tl_slot_t *b) {
    return a->blank == b->blank && a->dated == b->dated && a->whole == b->whole && a->sequence == b->sequence &&
           a->crc == b->crc && a->size == b->size && a->blob == b->blob;
}

// The slot of two, 0 or 1, that is to be tried first; 2: it does not matter.
static inline unsigned best_of(const tl_slot_t *a, const tl_slot_t *b) {
    if (a->whole != b->whole) {
        return a->whole ? 0U : 1U;
    }
    const uint32_t ahead = b->sequence - a->sequence;
    return !a->whole || ahead == 0U || ahead == 0x80000000U ? 2U : (ahead < 0x80000000U ? 1U : 0U);
}

#endif
