#include "tautline/tl_app.h"

#include <string.h>

#include "tautline/tl_axis_ask.h"
#include "tautline/tl_axis_guard.h"
#include "tautline/tl_axis_rest.h"
#include "tautline/tl_axis_step.h"
#include "tautline/tl_axis_watch.h"
#include "tautline/tl_command.h"
#include "tautline/tl_fast.h"
#include "tautline/tl_report.h"
#include "tautline/tl_settings.h"
#include "tautline/tl_stop.h"

#define POLL_US       1000U
#define FRAME_IDLE_US 20000U // after which the rest of a frame does not come any more
#define REBOOT_US     50000U // for the acknowledgement to leave
#define NOBODY_READS  500000U
#define REST_MOST_US  10000000U // for axes that do not come to rest
#define LATE_FAULT    20000U    // us without a control step that a driven motor may not see
#define GUARD_LATER   1U        // ticks from an axis' watch to its guard

// -- tables -----------------------------------------------------------------------------------------------------

tl_upload_t tl_app_table_data(tl_app_t *app, uint8_t axis, uint32_t offset, const uint8_t *bytes, size_t size) {
    return tl_tables_data(&app->tables, axis, offset, bytes, size);
}

tl_upload_t tl_app_table_end(tl_app_t *app, uint8_t axis) {
    return tl_tables_end(&app->tables, axis);
}

void tl_app_table_abort(tl_app_t *app) {
    tl_tables_abort(&app->tables);
    tl_update_abort(&app->update);
}

size_t tl_app_table_read(const tl_app_t *app, uint8_t axis, uint32_t offset, uint8_t *out, size_t room) {
    return tl_tables_read(&app->tables, axis, offset, out, room);
}

uint8_t tl_app_update_data(tl_app_t *app, uint32_t offset, const uint8_t *bytes, size_t size) {
    return tl_update_data(&app->update, offset, bytes, size);
}

uint8_t tl_app_update_end(tl_app_t *app) {
    return tl_update_end(&app->update);
}

// -- bytes ------------------------------------------------------------------------------------------------------

static void begin_session(tl_app_t *app) {
    tl_outbox_open(&app->outbox, true);
    tl_app_table_abort(app);
}

static void end_session(tl_app_t *app) {
    app->counters.bus_losses += app->outbox.open ? 1U : 0U;
    tl_outbox_open(&app->outbox, false);
    tl_app_table_abort(app);
    const uint32_t state = app->port->lock(app->port->context);
    for (uint8_t i = 0; i < app->port->axes; i++) {
        tl_axis_t *axis = &app->axes[i];
        axis->telemetry.divider = 0;
        axis->telemetry.tail = axis->telemetry.head;
        tl_axis_silence(axis);
    }
    if (app->calibration.axis != NULL) {
        tl_calibration_stop(&app->calibration, true);
    }
    app->port->unlock(app->port->context, state);
}

void tl_app_bus(tl_app_t *app, bool configured) {
    if (configured) {
        begin_session(app);
    } else {
        end_session(app);
    }
    const uint32_t bad = app->parser.bytes_bad;
    memset(&app->parser, 0, sizeof(app->parser));
    app->parser.bytes_bad = bad;
}

void tl_app_line(tl_app_t *app) {
    app->line = true;
}

static void take_frames(tl_app_t *app, const uint8_t *bytes, size_t size) {
    tl_wire_frame_t frame;
    while (tl_wire_parse(&app->parser, &bytes, &size, &frame)) {
        app->counters.frames_in++;
        if (app->line && frame.type == TL_WIRE_HELLO) {
            end_session(app);
            begin_session(app);
        }
        for (uint8_t i = 0; i < app->port->axes; i++) {
            tl_axis_hear(&app->axes[i]);
        }
        tl_command(app, &frame);
    }
    app->counters.bytes_bad = app->parser.bytes_bad;
}

void tl_app_receive(tl_app_t *app, const uint8_t *bytes, size_t size) {
    app->received_us = app->port->time_us(app->port->context);
    take_frames(app, bytes, size);
}

size_t tl_app_transmit(tl_app_t *app, uint8_t *out, size_t room) {
    return tl_outbox_take(&app->outbox, out, room);
}

// -- task -------------------------------------------------------------------------------------------------------

// A host that died in the middle of a frame, or bytes lost on the line: what comes next is not taken for the rest of
// it.
static void poll_half_frame(tl_app_t *app, tl_us_t now_us) {
    if (now_us - app->received_us >= FRAME_IDLE_US) {
        while (tl_wire_skip(&app->parser)) {
            take_frames(app, NULL, 0);
        }
    }
}

// The task asks every POLL_US, later where it was busy (a new table, flash): then the position has not been trusted
// wrongly for longer than the axis was without a new command.
static void poll_encoders(tl_app_t *app, tl_us_t now_us) {
    for (uint8_t i = 0; i < app->port->axes; i++) {
        if (app->port->edges_lost(app->port->context, i)) {
            const uint32_t state = app->port->lock(app->port->context);
            tl_axis_fail(&app->axes[i], TL_WIRE_FAULT_EDGES, tl_actuator_speed(&app->axes[i].motor), now_us);
            app->port->unlock(app->port->context, state);
        }
    }
}

static void poll_reboot(tl_app_t *app, tl_us_t now_us) {
    if (app->reboot == 0) {
        return;
    }
    const tl_us_t since_us = now_us - app->reboot_us;
    const bool told = tl_outbox_is_empty(&app->outbox) && since_us >= REBOOT_US;
    const bool rests = tl_tables_all_off(app->port, app->axes) || since_us >= REST_MOST_US;
    if (rests && (told || since_us >= NOBODY_READS)) {
        app->port->reboot(app->port->context, app->reboot == 2U);
    }
}

void tl_app_task(tl_app_t *app) {
    const tl_us_t now_us = app->port->time_us(app->port->context);
    if (now_us - app->polled_us >= POLL_US) {
        app->polled_us = now_us;
        tl_report_calibration(app, now_us);
        poll_encoders(app, now_us);
        poll_half_frame(app, now_us);
        tl_update_task(&app->update, now_us);
        tl_fault_log_task(&app->fault_log, now_us, !tl_update_is_coming(&app->update));
        if (app->steps != app->steps_fed) {
            app->steps_fed = app->steps;
            app->port->watchdog_feed(app->port->context);
        }
    }
    tl_report_axes(app, now_us);
    poll_reboot(app, now_us);
}

void tl_app_init(tl_app_t *app, const tl_port_t *port) {
    memset(app, 0, sizeof(*app));
    app->port = port;
    app->control_us = port->time_us(port->context);
    app->late_us = 2U * (1000000U / port->control_hz);
    for (uint8_t i = 0; i < port->axes; i++) {
        tl_axis_init(&app->axes[i], port, i);
    }
    app->settings = tl_settings_load(port, app->axes);
    tl_tables_init(&app->tables, port, app->axes, app->upload);
    static const uint8_t version[3] = TL_APP_VERSION;
    tl_update_init(&app->update, port, app->axes, version);
    tl_fault_log_init(&app->fault_log, port, app->axes);
    for (uint8_t i = 0; i < port->axes; i++) {
        if (port->boot == TL_WIRE_BOOT_WATCHDOG) {
            tl_axis_fail(&app->axes[i], TL_WIRE_FAULT_WATCHDOG, 0, app->control_us);
        }
        if (app->settings == TL_WIRE_STORE_BAD) {
            tl_axis_fail(&app->axes[i], TL_WIRE_FAULT_SETTINGS, 0, app->control_us);
        }
        if (app->tables.in_use[i].state == TL_WIRE_TABLE_BAD) {
            tl_axis_fail(&app->axes[i], TL_WIRE_FAULT_TABLE, 0, app->control_us);
        }
    }
}

// -- control step -----------------------------------------------------------------------------------------------

// A step that is late: what the motors did meanwhile is taken in first.
static __attribute__((noinline)) TL_FAST void come_late(tl_app_t *app, uint32_t since_us, tl_us_t now_us) {
    app->counters.overruns++;
    for (uint8_t i = 0; i < app->port->axes; i++) {
        tl_axis_t *axis = &app->axes[i];
        if (since_us > LATE_FAULT && axis->mode != TL_WIRE_MODE_OFF) {
            tl_axis_fail(axis, TL_WIRE_FAULT_OVERRUN, (int32_t)since_us, now_us);
        }
        tl_axis_catch_up(axis, since_us, now_us);
    }
}

TL_FAST void tl_app_control(tl_app_t *app) {
    const tl_port_t *port = app->port;
    const tl_us_t now_us = port->time_us(port->context);
    const uint32_t since_us = (uint32_t)(now_us - app->control_us);
    app->control_us = now_us;
    if (since_us > app->late_us) {
        come_late(app, since_us, now_us);
    }
    const uint32_t axes = port->axes;
    for (tl_axis_t *axis = app->axes, *end = axis + axes; axis != end; axis++) {
        tl_axis_step(axis);
    }
    // Each axis after the last tick of its millisecond: tl_axis_init() begins axis i with a tick less than axis i - 1.
    const uint32_t ticks = app->axes[0].ticks, slot = app->slot + 1U;
    app->slot = slot < ticks ? slot : 0U;
    for (uint32_t i = app->slot; i < axes; i += ticks) {
        tl_axis_watch(&app->axes[i], now_us);
    }
    const uint32_t later = app->slot + (app->slot < GUARD_LATER ? ticks : 0U);
    for (uint32_t i = ticks > GUARD_LATER ? later - GUARD_LATER : app->slot; i < axes; i += ticks) {
        tl_axis_guard(&app->axes[i], now_us);
    }
    if (app->slot + 1U == ticks) { // with four axes the only tick in which none is watched
        tl_stop_watch(app->axes, now_us);
    }
    app->steps = app->steps + 1U;
}
