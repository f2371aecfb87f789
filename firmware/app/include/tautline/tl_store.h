/// What outlives the power: two slots of one flash sector each for every axis' table, and two for the settings of all
/// axes; the newer whole one counts.
///
/// A write goes to the slot that is not in use: erase, the blob's pages, and last the page with the slot's header
/// (sequence number, size, CRC-32 of header and blob). Power lost at any moment therefore leaves the old table or the
/// new one. All functions are for the task; the motors must be off while one writes.
#ifndef TAUTLINE_TL_STORE_H
#define TAUTLINE_TL_STORE_H

#include "tautline/tl_port.h"
#include "tautline/tl_table.h"

#define TL_STORE_SLOTS    2U
#define TL_STORE_SETTINGS TL_WIRE_AXES_MAX ///< in place of an axis

/// One slot as found in flash.
typedef struct {
    bool blank;        ///< nothing was ever written, or it was cleared
    bool dated;        ///< its header is as it was written: the following are known
    bool whole;        ///< header and blob are as they were written
    uint32_t sequence; ///< rises by one with each write
    uint32_t crc;      ///< of the blob
    uint16_t size;     ///< of the blob
    uint32_t blob;     ///< offset in the flash region
} tl_slot_t;

/// Looks at a slot of an axis' table or of TL_STORE_SETTINGS, as all that follow: O(size), about 0.5 ms.
tl_slot_t tl_store_slot(const tl_port_t *port, uint8_t axis, uint8_t slot);

/// Both slots, the one to be tried first in `order[0]`: whole before damaged, newer before older.
void tl_store_order(const tl_port_t *port, uint8_t axis, tl_slot_t order[TL_STORE_SLOTS]);

/// Writes a blob of at most TL_TABLE_SIZE_MAX bytes as the newest one and reads it back. `kept`: the blob in flash
/// that stays, whatever the other slot holds; 0: the newest whole one. False: flash failed, what was kept is still
/// there. One erase and up to ten programs.
bool tl_store_write(const tl_port_t *port, uint8_t axis, uint32_t kept, const uint8_t *blob, uint16_t size);

/// Erases both slots, the older first.
bool tl_store_clear(const tl_port_t *port, uint8_t axis);

#endif
