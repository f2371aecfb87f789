#include "tautline/tl_update.h"

#include <string.h>

#include "tautline/tl_tables.h"

#define FORMAT     1U
#define CONFIRM_US 2000000U  // of control steps, after which firmware that a host has talked to is confirmed
#define EXPIRE_US  60000000U // without a word of a host, after which firmware on trial is given up
#define PIECE      64U

enum {
    IDLE,
    BEFORE,
    TAKING,
    PASSING
}; // of an image: none yet; this one; one that is not for the free slot, or one more

static uint8_t free_slot(const tl_update_t *update) {
    return update->port->update->slot == 0U ? 1U : 0U;
}

static tl_boot_flash_t flash_of(const tl_port_t *port) {
    return (tl_boot_flash_t){.read = port->update->read, .context = port->context, .room = port->update->room};
}

// -- flash ------------------------------------------------------------------------------------------------------

static bool holds(const tl_port_t *port, uint8_t slot, uint32_t offset, const uint8_t *page) {
    uint8_t piece[PIECE];
    for (uint32_t at = 0; at < TL_BOOT_PAGE; at += PIECE) {
        port->update->read(port->context, slot, offset + at, piece, PIECE);
        if (memcmp(piece, page + at, PIECE) != 0) {
            return false;
        }
    }
    return true;
}

static bool erase(const tl_port_t *port, uint8_t slot, uint32_t offset) {
    port->watchdog_feed(port->context);
    return port->update->erase(port->context, slot, offset); // programming shows whether it did
}

static bool program(const tl_port_t *port, uint8_t slot, uint32_t offset, const uint8_t *page) {
    port->watchdog_feed(port->context);
    return port->update->program(port->context, slot, offset, page) && holds(port, slot, offset, page);
}

static bool mark(const tl_port_t *port, uint8_t slot, uint32_t offset) {
    uint8_t page[TL_BOOT_PAGE];
    tl_boot_make_mark(page);
    return program(port, slot, offset, page);
}

// -- what an image says of itself ---------------------------------------------------------------------------------

// Its payload is signed[0] on, in the parser.
static bool read_head(tl_wire_parser_t *parser, const uint8_t *page, tl_wire_image_t *image, const uint8_t **payload) {
    tl_wire_frame_t frame;
    size_t size = TL_BOOT_PAGE;
    memset(parser, 0, sizeof(*parser));
    if (!tl_wire_parse(parser, &page, &size, &frame) || frame.type != TL_WIRE_IMAGE ||
        !tl_wire_decode(frame.type, frame.payload, frame.size, image)) {
        return false;
    }
    *payload = frame.payload;
    return image->format == FORMAT && image->size % TL_BOOT_PAGE == 0U && image->size > 0U;
}

static bool stored_version(const tl_port_t *port, uint8_t slot, uint8_t version[3]) {
    uint8_t page[TL_BOOT_PAGE];
    tl_wire_parser_t parser;
    tl_wire_image_t image;
    const uint8_t *payload;
    port->update->read(port->context, slot, TL_BOOT_HEAD, page, sizeof(page));
    if (!read_head(&parser, page, &image, &payload)) {
        return false;
    }
    memcpy(version, image.version, sizeof(image.version));
    return true;
}

// -- the file ---------------------------------------------------------------------------------------------------

static uint8_t refuse(tl_update_t *update, uint8_t why) {
    update->refused = why;
    update->any = false;
    update->stage = IDLE;
    return why;
}

// Images of fewer axes than there may be have "-" and their number behind the port's name.
static bool is_for(const tl_port_t *port, const tl_wire_image_t *image) {
    const char axes[] = {'-', (char)('0' + port->axes)};
    const size_t most = sizeof(image->port), length = strlen(port->name);
    const size_t size = length + (port->axes < TL_WIRE_AXES_MAX ? sizeof(axes) : 0U);
    return size <= most && memcmp(image->port, port->name, length) == 0 &&
           memcmp(image->port + length, axes, size - length) == 0 && (size == most || image->port[size] == '\0');
}

// Everything that can be known before a byte of the old image is lost.
static uint8_t check_head(const tl_update_t *update, const tl_wire_image_t *image, const uint8_t *payload) {
    const tl_port_t *port = update->port;
    if (image->size > port->update->room - TL_BOOT_IMAGE) {
        return TL_WIRE_UPDATE_SIZE;
    }
    if (!update->any && memcmp(image->version, update->version, sizeof(update->version)) < 0) {
        return TL_WIRE_UPDATE_OLDER;
    }
    port->watchdog_feed(port->context);
    const bool is_signed = port->update->is_signed(port->context, image->signature, payload, TL_WIRE_IMAGE_SIGNED);
    return is_signed ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_SIGNATURE;
}

static uint8_t take_head(tl_update_t *update, const uint8_t *page) {
    tl_wire_parser_t parser;
    tl_wire_image_t image;
    const uint8_t *payload;
    if (!read_head(&parser, page, &image, &payload)) {
        return TL_WIRE_UPDATE_DAMAGED;
    }
    if (!is_for(update->port, &image)) {
        return TL_WIRE_UPDATE_PORT;
    }
    update->next = update->come + TL_BOOT_PAGE + image.size;
    const uint8_t slot = free_slot(update);
    if (update->size != 0U || (image.slot != slot && image.slot != TL_BOOT_NONE)) {
        update->stage = PASSING;
        return TL_WIRE_UPDATE_NONE;
    }
    const uint8_t why = check_head(update, &image, payload);
    if (why != TL_WIRE_UPDATE_NONE) {
        return why;
    }
    // From here on the slot does not count.
    if (!erase(update->port, slot, TL_BOOT_RECORD)) {
        return TL_WIRE_UPDATE_FLASH;
    }
    update->stage = TAKING;
    update->size = image.size;
    memcpy(update->hash, image.hash, sizeof(update->hash));
    memcpy(update->head, page, sizeof(update->head));
    return TL_WIRE_UPDATE_NONE;
}

static uint8_t take_page(const tl_update_t *update, const uint8_t *page) {
    const uint32_t offset = TL_BOOT_IMAGE + update->come + update->size - update->next;
    const uint8_t slot = free_slot(update);
    const bool blank = offset % TL_BOOT_SECTOR != 0U || erase(update->port, slot, offset);
    return blank && program(update->port, slot, offset, page) ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_FLASH;
}

static uint8_t may_write(const tl_update_t *update) {
    if (update->port->update == NULL) {
        return TL_WIRE_UPDATE_NO_SLOT;
    }
    if (update->trial) {
        return TL_WIRE_UPDATE_TRIAL; // the other one is what there is to go back to
    }
    return tl_tables_all_off(update->port, update->axes) ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_NOT_OFF;
}

uint8_t tl_update_data(tl_update_t *update, uint32_t offset, const uint8_t *bytes, size_t size) {
    if (offset == 0U) {
        update->stage = BEFORE;
        update->refused = TL_WIRE_UPDATE_NONE;
        update->come = update->next = update->size = 0U;
    }
    uint8_t why = may_write(update);
    if (why == TL_WIRE_UPDATE_NONE && (update->stage == IDLE || offset != update->come || size != TL_BOOT_PAGE)) {
        why = TL_WIRE_UPDATE_DAMAGED;
    }
    if (why == TL_WIRE_UPDATE_NONE) {
        if (update->come == update->next) {
            why = take_head(update, bytes);
        } else if (update->stage == TAKING) {
            why = take_page(update, bytes);
        }
    }
    update->come += TL_BOOT_PAGE;
    return why == TL_WIRE_UPDATE_NONE ? why : refuse(update, why);
}

// What flash holds, not what was sent.
static uint8_t commit(const tl_update_t *update) {
    const tl_port_t *port = update->port;
    const tl_boot_flash_t flash = flash_of(port);
    const uint8_t slot = free_slot(update);
    uint8_t hash[32];
    port->watchdog_feed(port->context);
    port->update->hash(port->context, slot, update->size, hash);
    if (memcmp(hash, update->hash, sizeof(hash)) != 0) {
        return TL_WIRE_UPDATE_HASH;
    }
    const tl_boot_slot_t runs = port->update->slot == TL_BOOT_NONE ? (tl_boot_slot_t){.whole = false}
                                                                   : tl_boot_slot(&flash, port->update->slot);
    uint8_t record[TL_BOOT_PAGE];
    tl_boot_make_record(record, runs.sequence + 1U, update->size, tl_boot_crc(&flash, slot, update->size));
    const bool done = program(port, slot, TL_BOOT_HEAD, update->head) && program(port, slot, TL_BOOT_RECORD, record);
    return done ? TL_WIRE_UPDATE_NONE : TL_WIRE_UPDATE_FLASH;
}

uint8_t tl_update_end(tl_update_t *update) {
    uint8_t why = may_write(update);
    if (why == TL_WIRE_UPDATE_NONE && (update->stage == IDLE || update->come != update->next)) {
        why = TL_WIRE_UPDATE_DAMAGED;
    }
    if (why == TL_WIRE_UPDATE_NONE) {
        why = update->size == 0U ? TL_WIRE_UPDATE_LINKED : commit(update);
    }
    refuse(update, why);
    return why;
}

void tl_update_abort(tl_update_t *update) {
    update->stage = IDLE;
}

bool tl_update_is_coming(const tl_update_t *update) {
    return update->stage != IDLE;
}

// -- the trial ----------------------------------------------------------------------------------------------------

void tl_update_init(tl_update_t *update, const tl_port_t *port, const tl_axis_t *axes, const uint8_t version[3]) {
    memset(update, 0, sizeof(*update));
    update->port = port;
    update->axes = axes;
    update->started_us = port->time_us(port->context);
    memcpy(update->version, version, sizeof(update->version));
    if (port->update == NULL) {
        return;
    }
    update->trial = port->update->trial;
    if (port->update->slot != TL_BOOT_NONE) {
        stored_version(port, port->update->slot, update->version);
    }
    if (port->update->failed) {
        mark(port, free_slot(update), TL_BOOT_FAILED); // where that fails it is tried again, and falls back again
    }
}

void tl_update_task(tl_update_t *update, tl_us_t now_us) {
    if (!update->trial || !tl_tables_all_off(update->port, update->axes)) {
        return;
    }
    const tl_port_t *port = update->port;
    const tl_us_t since_us = now_us - update->started_us;
    if (update->heard && since_us >= CONFIRM_US) {
        update->trial = !mark(port, port->update->slot, TL_BOOT_CONFIRMED);
        if (!update->trial) {
            port->update->trial_ends(port->context, true);
        }
    } else if (!update->heard && since_us >= EXPIRE_US) {
        port->update->trial_ends(port->context, false);
    }
}

void tl_update_tell(const tl_update_t *update, tl_wire_firmware_t *out) {
    const tl_port_t *port = update->port;
    *out = (tl_wire_firmware_t){.state = TL_WIRE_FIRMWARE_STATE_CONFIRMED,
                                .slot = TL_BOOT_NONE,
                                .refused = port->update == NULL ? TL_WIRE_UPDATE_NO_SLOT : update->refused};
    memcpy(out->version, update->version, sizeof(out->version));
    if (port->update == NULL) {
        return;
    }
    const tl_boot_flash_t flash = flash_of(port);
    const tl_boot_slot_t other = tl_boot_slot(&flash, free_slot(update));
    out->slot = port->update->slot;
    out->state = update->trial ? TL_WIRE_FIRMWARE_STATE_TRIAL : TL_WIRE_FIRMWARE_STATE_CONFIRMED;
    if (other.whole) {
        out->other_state = other.failed      ? TL_WIRE_FIRMWARE_STATE_FAILED
                           : other.confirmed ? TL_WIRE_FIRMWARE_STATE_CONFIRMED
                                             : TL_WIRE_FIRMWARE_STATE_TRIAL;
        stored_version(port, free_slot(update), out->other_version);
    }
    out->room = port->update->room - TL_BOOT_IMAGE;
    memcpy(out->key, port->update->key, sizeof(out->key));
}
