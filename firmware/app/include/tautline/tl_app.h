/// The board's application: axes, calibration, tables, settings and the host's requests. Knows its hardware by
/// tl_port.h alone.
///
/// Use: tl_app_init() once; then tl_app_control() at port->control_hz from a timer, and in the main loop tl_app_task()
/// with whatever moves bytes (tl_usb_task). All but tl_app_control() belong to the task. One structure holds
/// everything; it must stay where it is. No function blocks but those that write flash (up to 0.5 s, motors off).
#ifndef TAUTLINE_TL_APP_H
#define TAUTLINE_TL_APP_H

#include "tautline/tl_state.h"

/// Loads settings and tables; a board that the watchdog restarted, or of whose stored tables or settings none is whole,
/// starts with that fault.
void tl_app_init(tl_app_t *app, const tl_port_t *port);

/// The control step of all axes.
void tl_app_control(tl_app_t *app);

/// Telemetry, events, calibration, watchdog.
void tl_app_task(tl_app_t *app);

/// A host has configured the device (true), or left it: replies that were not read are dropped, telemetry is off, a
/// calibration ends as host lost, and so does any motion; a follower comes to rest.
void tl_app_bus(tl_app_t *app, bool configured);

/// The host is on a serial line, which tells nobody that it comes or goes: each hello ends the session before it, as
/// leaving the bus does, and begins one. Without a session (after a restart) every other request is refused. Once,
/// after tl_app_init().
void tl_app_line(tl_app_t *app);

/// Bytes from the host, in any pieces. A frame whose rest does not come for 20 ms is given up.
void tl_app_receive(tl_app_t *app, const uint8_t *bytes, size_t size);

/// At most `room` bytes for the host; returns how many.
size_t tl_app_transmit(tl_app_t *app, uint8_t *out, size_t room);

/// A table from the host, as tl_tables.h has it: it may come while an axis moves, but is taken into use with all off.
tl_upload_t tl_app_table_data(tl_app_t *app, uint8_t axis, uint32_t offset, const uint8_t *bytes, size_t size);
tl_upload_t tl_app_table_end(tl_app_t *app, uint8_t axis);
void tl_app_table_abort(tl_app_t *app);
size_t tl_app_table_read(const tl_app_t *app, uint8_t axis, uint32_t offset, uint8_t *out, size_t room);

/// New firmware from the host, as tl_update.h has it: a tl_wire_update_t, 0 is done.
uint8_t tl_app_update_data(tl_app_t *app, uint32_t offset, const uint8_t *bytes, size_t size);
uint8_t tl_app_update_end(tl_app_t *app);

#endif
