/// The last faults of all axes, in flash: what a board had before it was switched off. The task alone.
///
/// A fault is noted as soon as it is there and written once every motor is off, one a second at most: a page each, in
/// two sectors, of which the older is erased where the newer is full. So 16 to 32 are kept, and power that goes
/// meanwhile loses the one that was being written, or the oldest 16. A page is the frame of tl_wire.h's `logged`, with
/// its CRC.
#ifndef TAUTLINE_TL_FAULT_LOG_H
#define TAUTLINE_TL_FAULT_LOG_H

#include "tautline/tl_axis.h"

#define TL_FAULT_LOG_PENDING 8U

typedef struct {
    const tl_port_t *port;
    const tl_axis_t *axes;
    uint32_t next;   ///< page that is written next
    uint32_t number; ///< of the newest one; 0: none
    uint32_t run;    ///< of this start: counts those in which something was logged
    uint32_t kept;   ///< that flash holds
    tl_us_t seen_us[TL_WIRE_AXES_MAX];
    bool seen[TL_WIRE_AXES_MAX];
    tl_wire_logged_t pending[TL_FAULT_LOG_PENDING]; ///< the oldest first
    uint32_t waiting;                               ///< of these
    bool wrote;
    tl_us_t wrote_us;
} tl_fault_log_t;

/// Finds the end of the log. Ports that keep none have none.
void tl_fault_log_init(tl_fault_log_t *log, const tl_port_t *port, const tl_axis_t *axes);

/// Once a millisecond: notes new faults, and writes where that is safe. `may_write`: nothing else writes flash just
/// now.
void tl_fault_log_task(tl_fault_log_t *log, tl_us_t now_us, bool may_write);

/// The index-th newest, those first that are not written yet; `*out` with number 0: there are not as many.
void tl_fault_log_read(const tl_fault_log_t *log, uint8_t index, tl_wire_logged_t *out);

#endif
