/// All that the application knows: data alone. tl_app.h runs it, tl_command.h answers requests with it, tl_report.h
/// tells of it unasked.
#ifndef TAUTLINE_TL_STATE_H
#define TAUTLINE_TL_STATE_H

#include "tautline/tl_calibration.h"
#include "tautline/tl_fault_log.h"
#include "tautline/tl_outbox.h"
#include "tautline/tl_tables.h"
#include "tautline/tl_update.h"

#ifndef TL_APP_AXES
#define TL_APP_AXES TL_WIRE_AXES_MAX ///< most that a port of this build has
#endif
_Static_assert(TL_APP_AXES >= 1 && TL_APP_AXES <= TL_WIRE_AXES_MAX, "axes of the app");

typedef struct {
    const tl_port_t *port;
    tl_axis_t axes[TL_APP_AXES];
    tl_tables_t tables;
    tl_update_t update;
    tl_fault_log_t fault_log;
    tl_calibration_t calibration;
    uint8_t upload[TL_TABLE_SIZE_MAX]; ///< of a table that comes, or what the settings are put together in
    uint8_t settings;                  ///< tl_wire_store_t
    tl_wire_counters_t counters;
    tl_wire_parser_t parser;
    tl_outbox_t outbox;
    bool line;      ///< a serial line: only hello begins a session
    uint8_t reboot; ///< 0 no, 1 restart, 2 boot loader: after the outbox is empty and the axes rest
    tl_us_t reboot_us;
    tl_us_t received_us; ///< when bytes came last

    volatile uint32_t steps; ///< control steps, so that the task feeds the watchdog only while they go on
    uint32_t steps_fed;
    uint32_t slot;      ///< tick of axis 0's millisecond that comes next
    uint32_t late_us;   ///< since the last control step: two periods, after which one has come late
    tl_us_t control_us; ///< time of the last control step
    tl_us_t polled_us;
} tl_app_t;

#endif
