/// The tables of all axes: which are in use, and new ones from the host. The task alone.
///
/// A table comes in pieces, is checked when it is whole, then stored, then used. One that is damaged or for another
/// axis leaves the one in use alone; content is checked where that one is, with all motors off: whatever is wrong with
/// it, that one is read from flash again.
#ifndef TAUTLINE_TL_TABLES_H
#define TAUTLINE_TL_TABLES_H

#include "tautline/tl_axis.h"
#include "tautline/tl_store.h"
#include "tautline/tl_table.h"

/// What became of a table that the host sent.
typedef enum {
    TL_UPLOAD_OK,
    TL_UPLOAD_AXIS,    ///< no such axis
    TL_UPLOAD_SIZE,    ///< too long, out of order, or nothing at all
    TL_UPLOAD_NOT_OFF, ///< an axis is enabled: writing flash may hold the control step
    TL_UPLOAD_REFUSED, ///< tl_table.h's reason is in the axis' status
    TL_UPLOAD_FLASH,
} tl_upload_t;

/// What is known of an axis' table besides its content.
typedef struct {
    uint8_t state;  ///< tl_wire_table_t
    uint8_t reason; ///< tl_table_reason_t of the last one refused
    bool any;       ///< the next one may be for another instrument
    uint16_t size;
    uint32_t sequence;
    uint32_t crc;
    uint32_t blob; ///< offset in the flash region
    bool readable; ///< there it is
} tl_table_in_use_t;

typedef struct {
    const tl_port_t *port;
    tl_axis_t *axes;
    uint8_t
        *upload; ///< TL_TABLE_SIZE_MAX bytes for what comes, shared; whoever takes them says tl_tables_abort() first
    tl_table_in_use_t in_use[TL_WIRE_AXES_MAX];
    uint32_t upload_size; ///< bytes that have come
    uint8_t upload_axis;
} tl_tables_t;

/// Loads what flash holds. Motors off.
void tl_tables_init(tl_tables_t *tables, const tl_port_t *port, tl_axis_t *axes, uint8_t *upload);

/// Pieces from offset 0 in order; tl_tables_end() checks, stores and uses the whole, with every motor off.
tl_upload_t tl_tables_data(tl_tables_t *tables, uint8_t axis, uint32_t offset, const uint8_t *bytes, size_t size);
tl_upload_t tl_tables_end(tl_tables_t *tables, uint8_t axis);
void tl_tables_abort(tl_tables_t *tables);

/// Reads from the blob in use; returns the bytes given, 0 at its end or without one.
size_t tl_tables_read(const tl_tables_t *tables, uint8_t axis, uint32_t offset, uint8_t *out, size_t room);

/// Erases both slots of an axis: a tl_wire_reason_t, or 0.
uint8_t tl_tables_clear(tl_tables_t *tables, uint8_t axis);

/// Whether every motor is off: flash may be written.
bool tl_tables_all_off(const tl_port_t *port, const tl_axis_t *axes);

#endif
