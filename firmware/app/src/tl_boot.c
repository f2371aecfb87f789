#include "tautline/tl_boot.h"

#include "tautline/tl_crc.h"

// A record: four words (magic, sequence, size, CRC of the image) and the CRC of these.
#define MAGIC       0x544F4F42U // "BOOT"
#define RECORD_SIZE 20U
#define MARK        0x5AU
#define MARK_SIZE   16U
#define PIECE       64U // of an image at a time: not every flash is mapped

static uint32_t get_word(const uint8_t *in) {
    return in[0] | ((uint32_t)in[1] << 8) | ((uint32_t)in[2] << 16) | ((uint32_t)in[3] << 24);
}

static void put_word(uint8_t *out, uint32_t word) {
    for (unsigned i = 0; i < 4U; i++) {
        out[i] = (uint8_t)(word >> (8U * i));
    }
}

uint32_t tl_boot_crc(const tl_boot_flash_t *flash, uint8_t slot, uint32_t size) {
    uint8_t piece[PIECE];
    uint32_t crc = 0U;
    for (uint32_t at = 0; at < size; at += PIECE) {
        const uint32_t count = size - at < PIECE ? size - at : PIECE;
        flash->read(flash->context, slot, TL_BOOT_IMAGE + at, piece, count);
        crc = tl_crc32(crc, piece, count);
    }
    return crc;
}

static bool is_marked(const tl_boot_flash_t *flash, uint8_t slot, uint32_t offset) {
    uint8_t mark[MARK_SIZE];
    flash->read(flash->context, slot, offset, mark, sizeof(mark));
    for (uint32_t i = 0; i < MARK_SIZE; i++) {
        if (mark[i] != MARK) {
            return false;
        }
    }
    return true;
}

// What the first sector says; `whole` is not known yet: *crc is what the image has to have.
static bool look_at_slot(const tl_boot_flash_t *flash, uint8_t slot, tl_boot_slot_t *found, uint32_t *crc) {
    uint8_t record[RECORD_SIZE];
    flash->read(flash->context, slot, TL_BOOT_RECORD, record, sizeof(record));
    const uint32_t size = get_word(record + 8);
    if (get_word(record) != MAGIC || get_word(record + 16) != tl_crc32(0U, record, RECORD_SIZE - 4U) || size == 0U ||
        size > flash->room - TL_BOOT_IMAGE) {
        return false;
    }
    found->sequence = get_word(record + 4);
    found->size = size;
    found->confirmed = is_marked(flash, slot, TL_BOOT_CONFIRMED);
    found->failed = is_marked(flash, slot, TL_BOOT_FAILED);
    *crc = get_word(record + 12);
    return true;
}

tl_boot_slot_t tl_boot_slot(const tl_boot_flash_t *flash, uint8_t slot) {
    tl_boot_slot_t found = {.whole = false};
    uint32_t crc;
    if (!look_at_slot(flash, slot, &found, &crc) || tl_boot_crc(flash, slot, found.size) != crc) {
        return (tl_boot_slot_t){.whole = false};
    }
    found.whole = true;
    return found;
}

// A slot that may run, if it is whole.
static bool may_run(const tl_boot_flash_t *flash, uint8_t slot, uint8_t failed, tl_boot_slot_t *found) {
    uint32_t crc;
    return look_at_slot(flash, slot, found, &crc) && !found->failed && (slot != failed || found->confirmed);
}

tl_boot_choice_t tl_boot_choose(const tl_boot_flash_t *flash, uint8_t failed) {
    tl_boot_slot_t slots[TL_BOOT_SLOTS] = {{.whole = false}, {.whole = false}};
    const bool first = may_run(flash, 0U, failed, &slots[0]), second = may_run(flash, 1U, failed, &slots[1]);
    // Sequence numbers may wrap: the newer one is ahead by less than half their range.
    const uint8_t newer = second && (!first || (int32_t)(slots[1].sequence - slots[0].sequence) > 0) ? 1U : 0U;
    const bool may[TL_BOOT_SLOTS] = {first, second};
    for (uint8_t i = 0; i < TL_BOOT_SLOTS;
         i++) { // an image's checksum takes long: the older one's only where it counts
        const uint8_t slot = i == 0U ? newer : (uint8_t)(1U - newer);
        if (may[slot] && tl_boot_slot(flash, slot).whole) {
            return (tl_boot_choice_t){.slot = slot, .trial = !slots[slot].confirmed};
        }
    }
    return (tl_boot_choice_t){.slot = TL_BOOT_NONE};
}

void tl_boot_make_record(uint8_t *page, uint32_t sequence, uint32_t size, uint32_t crc) {
    for (uint32_t i = 0; i < TL_BOOT_PAGE; i++) {
        page[i] = 0xFFU;
    }
    put_word(page, MAGIC);
    put_word(page + 4, sequence);
    put_word(page + 8, size);
    put_word(page + 12, crc);
    put_word(page + 16, tl_crc32(0U, page, RECORD_SIZE - 4U));
}

void tl_boot_make_mark(uint8_t *page) {
    for (uint32_t i = 0; i < TL_BOOT_PAGE; i++) {
        page[i] = i < MARK_SIZE ? MARK : 0xFFU;
    }
}
