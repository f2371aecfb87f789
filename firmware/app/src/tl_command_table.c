#include "tautline/tl_command_table.h"

#include <string.h>

static uint8_t reason_of(tl_upload_t result) {
    switch (result) {
    case TL_UPLOAD_OK:
        return 0;
    case TL_UPLOAD_AXIS:
        return TL_WIRE_REASON_AXIS;
    case TL_UPLOAD_SIZE:
        return TL_WIRE_REASON_TABLE_SIZE;
    case TL_UPLOAD_NOT_OFF:
        return TL_WIRE_REASON_NOT_OFF;
    case TL_UPLOAD_REFUSED:
        return TL_WIRE_REASON_TABLE_REFUSED;
    case TL_UPLOAD_FLASH:
    default:
        return TL_WIRE_REASON_FLASH;
    }
}

static uint8_t write_part(tl_tables_t *tables, const tl_wire_table_write_t *part) {
    if (part->count == 0 || part->count > TL_WIRE_PART) {
        return TL_WIRE_REASON_RANGE;
    }
    return reason_of(tl_tables_data(tables, part->axis, part->offset, part->bytes, part->count));
}

static uint8_t store(tl_tables_t *tables, const tl_wire_table_store_t *request) {
    if (request->axis < tables->port->axes && request->size != tables->upload_size) {
        tl_tables_abort(tables); // a part was lost
        return TL_WIRE_REASON_TABLE_SIZE;
    }
    return reason_of(tl_tables_end(tables, request->axis));
}

uint8_t tl_command_table(tl_tables_t *tables, uint8_t type, const tl_wire_message_t *request, tl_wire_message_t *out,
                         uint8_t *answer) {
    *answer = TL_WIRE_ACK;
    switch (type) {
    case TL_WIRE_TABLE_WRITE:
        return write_part(tables, &request->table_write);
    case TL_WIRE_TABLE_STORE:
        return store(tables, &request->table_store);
    case TL_WIRE_TABLE_READ:
    default:
        break;
    }
    const tl_wire_table_read_t read = request->table_read;
    if (read.axis >= tables->port->axes) {
        return TL_WIRE_REASON_AXIS;
    }
    *answer = TL_WIRE_TABLE_PART;
    memset(&out->table_part, 0, sizeof(out->table_part));
    out->table_part.axis = read.axis;
    out->table_part.offset = read.offset;
    out->table_part.count =
        (uint8_t)tl_tables_read(tables, read.axis, read.offset, out->table_part.bytes, TL_WIRE_PART);
    return 0;
}
