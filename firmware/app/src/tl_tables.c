#include "tautline/tl_tables.h"

#include <string.h>

#include "tautline/tl_axis_ask.h"

bool tl_tables_all_off(const tl_port_t *port, const tl_axis_t *axes) {
    for (uint8_t i = 0; i < port->axes; i++) {
        if (axes[i].mode != TL_WIRE_MODE_OFF) {
            return false;
        }
    }
    return true;
}

// Keeps the control step and the watch away from the look-up, into which a table is then read. The motor is off.
static tl_lookup_t *leave(tl_tables_t *tables, uint8_t index) {
    const tl_port_t *port = tables->port;
    tl_axis_t *axis = &tables->axes[index];
    const uint32_t state = port->lock(port->context);
    axis->has_table = false;
    port->unlock(port->context, state);
    return &axis->tip.lookup;
}

static void use(tl_tables_t *tables, uint8_t index, bool found, bool is_new) {
    const tl_port_t *port = tables->port;
    const uint32_t state = port->lock(port->context);
    tl_axis_use_table(&tables->axes[index], found);
    if (is_new) {
        tl_axis_event(&tables->axes[index], TL_WIRE_EVENT_TABLE);
    }
    port->unlock(port->context, state);
}

// `blob`: what the slot holds. Its own CRC, at its end: that of a whole that ends with its CRC is the same for all.
static void note(tl_table_in_use_t *table, uint8_t state, const tl_slot_t *slot, const uint8_t *blob) {
    const uint8_t *crc = blob + slot->size - 4U;
    table->state = state;
    table->sequence = slot->sequence;
    table->crc = crc[0] | (uint32_t)crc[1] << 8 | (uint32_t)crc[2] << 16 | (uint32_t)crc[3] << 24;
    table->size = slot->size;
    table->blob = slot->blob;
    table->readable = true;
}

// The best table that flash holds. Motors off.
static void load(tl_tables_t *tables, uint8_t index) {
    tl_table_in_use_t *table = &tables->in_use[index];
    tl_slot_t slots[TL_STORE_SLOTS];
    tl_store_order(tables->port, index, slots);
    const uint8_t before = table->reason;
    *table = (tl_table_in_use_t){.state = TL_WIRE_TABLE_NONE, .reason = before};
    tl_lookup_t *lookup = leave(tables, index);
    bool found = false;
    for (unsigned i = 0; i < TL_STORE_SLOTS && !found; i++) {
        if (slots[i].blank) {
            continue;
        }
        uint8_t reason = TL_TABLE_BAD_CRC;
        uint8_t *blob = tables->upload;
        if (slots[i].whole) {
            tables->port->flash_read(tables->port->context, slots[i].blob, blob, slots[i].size);
            reason = (uint8_t)tl_lookup_load(lookup, blob, slots[i].size, index);
        }
        found = reason == TL_TABLE_OK;
        if (found) {
            // A damaged slot of unknown age may have been the newer one.
            const tl_slot_t *other = &slots[1U - i];
            const bool newest = other->blank || (other->dated && (int32_t)(slots[i].sequence - other->sequence) > 0);
            note(table, newest ? TL_WIRE_TABLE_NEWEST : TL_WIRE_TABLE_OLDER, &slots[i], blob);
            table->reason = before;
        } else {
            table->state = TL_WIRE_TABLE_BAD;
            table->reason = reason;
        }
    }
    use(tables, index, found, false);
}

void tl_tables_init(tl_tables_t *tables, const tl_port_t *port, tl_axis_t *axes, uint8_t *upload) {
    memset(tables, 0, sizeof(*tables));
    tables->port = port;
    tables->axes = axes;
    tables->upload = upload;
    for (uint8_t i = 0; i < port->axes; i++) {
        load(tables, i);
    }
}

size_t tl_tables_read(const tl_tables_t *tables, uint8_t axis, uint32_t offset, uint8_t *out, size_t room) {
    const tl_port_t *port = tables->port;
    if (axis >= port->axes || !tables->in_use[axis].readable || offset >= tables->in_use[axis].size) {
        return 0;
    }
    const size_t left = tables->in_use[axis].size - offset;
    const size_t size = left < room ? left : room;
    port->flash_read(port->context, tables->in_use[axis].blob + offset, out, size);
    return size;
}

uint8_t tl_tables_clear(tl_tables_t *tables, uint8_t axis) {
    if (!tl_tables_all_off(tables->port, tables->axes)) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    const bool done = tl_store_clear(tables->port, axis);
    tl_tables_abort(tables);
    tables->in_use[axis].reason = TL_TABLE_OK;
    load(tables, axis);
    return done ? 0 : TL_WIRE_REASON_FLASH;
}

tl_upload_t tl_tables_data(tl_tables_t *tables, uint8_t axis, uint32_t offset, const uint8_t *bytes, size_t size) {
    if (axis >= tables->port->axes) {
        return TL_UPLOAD_AXIS;
    }
    if (offset == 0) {
        tables->upload_size = 0;
        tables->upload_axis = axis;
    }
    if (axis != tables->upload_axis || offset != tables->upload_size ||
        size > TL_TABLE_SIZE_MAX - tables->upload_size) {
        tables->upload_size = 0;
        return TL_UPLOAD_SIZE;
    }
    memcpy(tables->upload + offset, bytes, size);
    tables->upload_size += (uint32_t)size;
    return TL_UPLOAD_OK;
}

void tl_tables_abort(tl_tables_t *tables) {
    tables->upload_size = 0;
}

// A table that names its instrument is for that one; where either does not say, nothing is known against it.
static bool is_for(const tl_table_t *table, const tl_wire_settings_t *settings) {
    _Static_assert(sizeof(table->instrument) == sizeof(settings->instrument), "one serial for both");
    return table->instrument[0] == 0 || settings->instrument[0] == 0 ||
           memcmp(table->instrument, settings->instrument, sizeof(table->instrument)) == 0;
}

tl_upload_t tl_tables_end(tl_tables_t *tables, uint8_t axis) {
    if (axis >= tables->port->axes) {
        return TL_UPLOAD_AXIS;
    }
    const uint16_t size = (uint16_t)tables->upload_size;
    tl_table_in_use_t *table = &tables->in_use[axis];
    tl_tables_abort(tables);
    if (!tl_tables_all_off(tables->port, tables->axes)) {
        return TL_UPLOAD_NOT_OFF;
    }
    if (size == 0 || axis != tables->upload_axis) {
        return TL_UPLOAD_SIZE;
    }
    const uint8_t *blob = tables->upload;
    tl_table_reason_t reason = tl_table_check_blob(blob, size, axis);
    if (reason != TL_TABLE_OK) {
        table->reason = (uint8_t)reason;
        table->any = false;
        return TL_UPLOAD_REFUSED; // the one in use was not touched
    }
    tl_lookup_t *lookup = leave(tables, axis);
    reason = tl_lookup_load(lookup, blob, size, axis);
    if (reason == TL_TABLE_OK && !table->any && !is_for(&lookup->table, &tables->axes[axis].settings)) {
        reason = TL_TABLE_BAD_INSTRUMENT;
    }
    table->any = false;
    const uint32_t kept = table->readable ? table->blob : 0U; // not the newest one where that was refused
    if (reason != TL_TABLE_OK || !tl_store_write(tables->port, axis, kept, blob, size)) {
        load(tables, axis); // what flash has: the one that was in use
        table->reason = (uint8_t)reason;
        return reason != TL_TABLE_OK ? TL_UPLOAD_REFUSED : TL_UPLOAD_FLASH;
    }
    table->reason = TL_TABLE_OK;
    tl_slot_t slots[TL_STORE_SLOTS];
    tl_store_order(tables->port, axis, slots);
    note(table, TL_WIRE_TABLE_NEWEST, &slots[0], blob);
    use(tables, axis, true, true);
    return TL_UPLOAD_OK;
}
