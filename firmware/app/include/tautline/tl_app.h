/// The board's application: axes, calibration, tables and the host's requests. Knows its hardware by tl_port.h alone.
///
/// Use: tl_app_init() once; then tl_app_control() at port->control_hz from a timer, and in the main loop tl_app_task()
/// with whatever moves bytes (tl_usb_task). All but tl_app_control() belong to the task. One structure holds
/// everything; it must stay where it is. No function blocks but those that write flash (up to 0.5 s, motors off).
#ifndef TAUTLINE_TL_APP_H
#define TAUTLINE_TL_APP_H

#include "tautline/tl_calibration.h"
#include "tautline/tl_store.h"

#ifndef TL_APP_QUEUE
#define TL_APP_QUEUE 4096U ///< bytes on their way to the host; whole frames that do not fit are dropped and counted
#endif
#if TL_APP_QUEUE < 1024U || TL_APP_QUEUE > 65536U
#error "TL_APP_QUEUE must be 1024 to 65536"
#endif

#ifndef TL_APP_BUILD
#define TL_APP_BUILD "release" ///< shown in the identity, at most 31 characters
#endif
#define TL_APP_VERSION {0, 1, 0} ///< the host package's too: pyproject.toml reads it here

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
    uint32_t sequence;
    uint32_t crc;
    uint16_t size;
    const uint8_t *blob; ///< in flash; NULL without one
} tl_table_in_use_t;

typedef struct {
    const tl_port_t *port;
    tl_axis_t axes[TL_WIRE_AXES_MAX];
    tl_table_in_use_t tables[TL_WIRE_AXES_MAX];
    tl_calibration_t calibration;
    tl_wire_counters_t counters;
    tl_wire_parser_t parser;
    uint16_t unasked; ///< sequence of frames that no request asked for
    bool bus;         ///< a host has configured the device, or said hello on a serial line: a session
    bool line;        ///< a serial line: only hello begins a session
    uint8_t reboot;   ///< 0 no, 1 restart, 2 boot loader: after the queue is empty
    tl_us_t reboot_us;

    uint8_t queue[TL_APP_QUEUE];
    uint32_t queue_head, queue_tail;

    uint32_t upload_size; ///< bytes in calibration.upload; 0 while an axis calibrates
    uint8_t upload_axis;

    volatile uint32_t steps; ///< control steps, so that the task feeds the watchdog only while they go on
    uint32_t steps_fed;
    uint32_t slot;      ///< tick of axis 0's millisecond that comes next
    tl_us_t control_us; ///< time of the last control step
    tl_us_t polled_us;
    tl_us_t received_us; ///< when bytes came last
} tl_app_t;

/// Loads the tables; a board that the watchdog restarted, or whose stored tables are all damaged, starts with that
/// fault.
void tl_app_init(tl_app_t *app, const tl_port_t *port);

/// The control step of all axes.
void tl_app_control(tl_app_t *app);

/// Telemetry, events, calibration, watchdog.
void tl_app_task(tl_app_t *app);

/// A host has configured the device (true), or left it: replies that were not read are dropped, telemetry is off, a
/// calibration ends as host lost, a follower comes to rest.
void tl_app_bus(tl_app_t *app, bool configured);

/// The host is on a serial line, which tells nobody that it comes or goes: each hello ends the session before it, as
/// leaving the bus does, and begins one. Without a session (after a restart) every other request is refused. Once,
/// after tl_app_init().
void tl_app_line(tl_app_t *app);

/// Bytes from the host, in any pieces. A frame whose rest does not come for 20 ms is given up.
void tl_app_receive(tl_app_t *app, const uint8_t *bytes, size_t size);

/// At most `room` bytes for the host; returns how many.
size_t tl_app_transmit(tl_app_t *app, uint8_t *out, size_t room);

/// A table in pieces, from offset 0 in order; tl_app_table_end() checks, stores and uses it. It shares memory with a
/// calibration: none is taken during one, and a request to start one drops what has come.
tl_upload_t tl_app_table_data(tl_app_t *app, uint8_t axis, uint32_t offset, const uint8_t *bytes, size_t size);
tl_upload_t tl_app_table_end(tl_app_t *app, uint8_t axis);
void tl_app_table_abort(tl_app_t *app);
/// Reads from the blob in use; returns the bytes given, 0 at its end or without one.
size_t tl_app_table_read(const tl_app_t *app, uint8_t axis, uint32_t offset, uint8_t *out, size_t room);

/// Erases both slots of an axis: a tl_wire_reason_t, or 0.
uint8_t tl_app_table_clear(tl_app_t *app, uint8_t axis);

/// Takes in a frame's marker during a calibration: a tl_wire_reason_t, or 0.
uint8_t tl_app_marker(tl_app_t *app, const tl_wire_marker_t *marker, tl_us_t now_us);

/// Queues a frame for the host; false where there is no room.
bool tl_app_send(tl_app_t *app, uint8_t type, uint16_t sequence, const void *message);

/// Answers one of the messages that carry a table (tl_command_table.c): a tl_wire_reason_t, or 0 with the type of the
/// answer in *answer.
uint8_t tl_command_table(tl_app_t *app, uint8_t type, const tl_wire_message_t *request, tl_wire_message_t *out,
                         uint8_t *answer);

/// Answers one request (tl_command.c).
void tl_command(tl_app_t *app, const tl_wire_frame_t *frame);

#endif
