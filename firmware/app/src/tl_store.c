#include "tautline/tl_store.h"

#include <string.h>

#include "tautline/tl_crc.h"

// A slot: one page that begins with five words (magic, sequence, size, CRC of the blob, CRC of the words), then the
// blob.
#define MAGIC       0x544F4C53U // "SLOT"
#define WORDS       5U
#define HEADER_SIZE (4U * WORDS)

_Static_assert(TL_PORT_FLASH_PAGE + TL_TABLE_SIZE_MAX <= TL_PORT_FLASH_SECTOR, "a table must fit its slot");

static uint32_t offset_of(uint8_t axis, uint8_t slot) {
    return (uint32_t)(axis * TL_STORE_SLOTS + slot) * TL_PORT_FLASH_SECTOR;
}

static uint32_t get_word(const uint8_t *in) {
    return in[0] | ((uint32_t)in[1] << 8) | ((uint32_t)in[2] << 16) | ((uint32_t)in[3] << 24);
}

static void put_word(uint8_t *out, uint32_t word) {
    for (unsigned i = 0; i < 4U; i++) {
        out[i] = (uint8_t)(word >> (8U * i));
    }
}

// What flash holds is looked at in pieces of this size: not every chip is mapped.
#define PIECE 64U

static uint32_t read_piece(const tl_port_t *port, uint32_t offset, uint32_t left, uint8_t piece[PIECE]) {
    const uint32_t size = left < PIECE ? left : PIECE;
    port->flash_read(port->context, offset, piece, size);
    return size;
}

static bool is_blank(const tl_port_t *port, uint32_t offset, uint32_t size) {
    uint8_t piece[PIECE];
    for (uint32_t at = 0; at < size; at += PIECE) {
        const uint32_t count = read_piece(port, offset + at, size - at, piece);
        for (uint32_t i = 0; i < count; i++) {
            if (piece[i] != 0xFFU) {
                return false;
            }
        }
    }
    return true;
}

static bool holds(const tl_port_t *port, uint32_t offset, const uint8_t *bytes, uint32_t size) {
    uint8_t piece[PIECE];
    for (uint32_t at = 0; at < size; at += PIECE) {
        const uint32_t count = read_piece(port, offset + at, size - at, piece);
        if (memcmp(piece, bytes + at, count) != 0) {
            return false;
        }
    }
    return true;
}

static uint32_t crc_of(const tl_port_t *port, uint32_t offset, uint32_t size) {
    uint8_t piece[PIECE];
    uint32_t crc = 0U;
    for (uint32_t at = 0; at < size; at += PIECE) {
        const uint32_t count = read_piece(port, offset + at, size - at, piece);
        crc = tl_crc32(crc, piece, count);
    }
    return crc;
}

tl_slot_t tl_store_slot(const tl_port_t *port, uint8_t axis, uint8_t slot) {
    const uint32_t offset = offset_of(axis, slot);
    tl_slot_t found = {.blank = is_blank(port, offset, TL_PORT_FLASH_PAGE)};
    uint8_t page[HEADER_SIZE];
    port->flash_read(port->context, offset, page, sizeof(page));
    const uint32_t size = get_word(page + 8);
    if (get_word(page) != MAGIC || size > TL_TABLE_SIZE_MAX ||
        get_word(page + 16) != tl_crc32(0U, page, HEADER_SIZE - 4U)) {
        return found;
    }
    found.dated = true;
    found.sequence = get_word(page + 4);
    found.size = (uint16_t)size;
    found.crc = get_word(page + 12);
    found.blob = offset + TL_PORT_FLASH_PAGE;
    found.whole = crc_of(port, found.blob, found.size) == found.crc;
    return found;
}

// Sequence numbers may wrap: the newer one is ahead by less than half their range.
static bool newer(const tl_slot_t *a, const tl_slot_t *b) {
    return (int32_t)(a->sequence - b->sequence) > 0;
}

void tl_store_order(const tl_port_t *port, uint8_t axis, tl_slot_t order[TL_STORE_SLOTS]) {
    const tl_slot_t a = tl_store_slot(port, axis, 0);
    const tl_slot_t b = tl_store_slot(port, axis, 1);
    const bool b_first = b.whole && (!a.whole || newer(&b, &a)); // of two damaged ones neither will be used
    order[0] = b_first ? b : a;
    order[1] = b_first ? a : b;
}

static bool program_page(const tl_port_t *port, uint32_t offset, const uint8_t *bytes, size_t size) {
    uint8_t page[TL_PORT_FLASH_PAGE];
    memset(page, 0xFF, sizeof(page));
    memcpy(page, bytes, size);
    port->watchdog_feed(port->context);
    return port->flash_program(port->context, offset, page) && holds(port, offset, page, sizeof(page));
}

static bool erase(const tl_port_t *port, uint32_t offset) {
    port->watchdog_feed(port->context);
    return port->flash_erase(port->context, offset) && is_blank(port, offset, TL_PORT_FLASH_SECTOR);
}

bool tl_store_write(const tl_port_t *port, uint8_t axis, uint32_t kept, const uint8_t *blob, uint16_t size) {
    const tl_slot_t a = tl_store_slot(port, axis, 0);
    const tl_slot_t b = tl_store_slot(port, axis, 1);
    const uint8_t older = a.whole && (!b.whole || newer(&a, &b)) ? 1U : 0U;
    const uint8_t target = kept == 0U ? older : kept < offset_of(axis, 1U) ? 1U : 0U;
    const tl_slot_t *before = target == 1U ? &a : &b;
    const uint32_t offset = offset_of(axis, target);
    if (size > TL_TABLE_SIZE_MAX || !erase(port, offset)) {
        return false;
    }
    for (uint32_t at = 0; at < size; at += TL_PORT_FLASH_PAGE) {
        const uint32_t left = size - at;
        const uint32_t count = left < TL_PORT_FLASH_PAGE ? left : TL_PORT_FLASH_PAGE;
        if (!program_page(port, offset + TL_PORT_FLASH_PAGE + at, blob + at, count)) {
            return false;
        }
    }
    uint8_t header[HEADER_SIZE];
    put_word(header, MAGIC);
    put_word(header + 4, before->whole ? before->sequence + 1U : 1U);
    put_word(header + 8, size);
    put_word(header + 12, tl_crc32(0U, blob, size));
    put_word(header + 16, tl_crc32(0U, header, HEADER_SIZE - 4U));
    return program_page(port, offset, header, sizeof(header));
}

bool tl_store_clear(const tl_port_t *port, uint8_t axis) {
    const tl_slot_t a = tl_store_slot(port, axis, 0);
    const tl_slot_t b = tl_store_slot(port, axis, 1);
    const uint8_t older = a.whole && (!b.whole || newer(&a, &b)) ? 1U : 0U;
    return erase(port, offset_of(axis, older)) && erase(port, offset_of(axis, 1U - older));
}
