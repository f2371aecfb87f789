#include "tautline/tl_command.h"

#include <string.h>

#include "tautline/tl_axis_ask.h"
#include "tautline/tl_axis_rest.h"
#include "tautline/tl_axis_watch.h"
#include "tautline/tl_command_table.h"
#include "tautline/tl_fast.h"
#include "tautline/tl_report.h"
#include "tautline/tl_settings.h"

// A handler's answer: a message to send back (type), an acknowledgement, nothing, or a reason to refuse.
typedef struct {
    uint8_t type; // of `message`; TL_WIRE_ACK, or 0: no answer unless refused
    uint8_t reason;
} answer_t;

static answer_t refuse(uint8_t reason) {
    return (answer_t){.reason = reason};
}
static answer_t done(uint8_t reason) {
    return (answer_t){.type = TL_WIRE_ACK, .reason = reason};
}
static answer_t with(uint8_t type) {
    return (answer_t){.type = type};
}

static void copy_text(char *out, size_t room, const char *text) {
    for (size_t i = 0; i < room && text[i] != '\0'; i++) {
        out[i] = text[i];
    }
}

static void identity(const tl_app_t *app, tl_us_t now_us, tl_wire_identity_t *out) {
    static const uint8_t version[3] = TL_APP_VERSION;
    *out = (tl_wire_identity_t){
        .protocol_major = TL_WIRE_MAJOR,
        .protocol_minor = TL_WIRE_MINOR,
        .axes = app->port->axes,
        .table_version = TL_TABLE_FORMAT,
        .table_nodes_max = TL_TABLE_NODES_MAX,
        .control_hz = app->port->control_hz,
        .t_us = now_us,
        .boot = app->port->boot,
        .driver_ma = app->port->driver_ma,
    };
    memcpy(out->firmware, version, sizeof(version));
    copy_text(out->port, sizeof(out->port), app->port->name);
    copy_text(out->serial, sizeof(out->serial), app->port->serial);
    copy_text(out->build, sizeof(out->build), TL_APP_BUILD);
}

// What the control step writes: all of one moment, and no half of a 64-bit value. Returns p.
static TL_FAST_LOCKED tl_count_q8_t look_at_axis(const tl_axis_t *axis, tl_wire_status_t *out) {
    const tl_port_t *port = axis->port;
    const uint32_t state = port->lock(port->context);
    out->mode = axis->mode;
    out->fault = axis->fault;
    out->flags = tl_axis_flags(axis);
    out->fault_us = axis->guard.fault_us;
    out->q_q8 = axis->q;
    out->q_ref_q8 = axis->path.q;
    out->c_ref_q16 = axis->tip.c_ref;
    out->duty_q15 = axis->motor.duty;
    out->current_ma = axis->guard.current_ma;
    out->supply_mv = axis->guard.supply_mv;
    out->fault_value = axis->guard.fault_value;
    const tl_count_q8_t p = axis->tip.play.p;
    port->unlock(port->context, state);
    return p;
}

static void status(const tl_app_t *app, uint8_t index, tl_us_t now_us, tl_wire_status_t *out) {
    const tl_axis_t *axis = &app->axes[index];
    const tl_table_in_use_t *table = &app->tables.in_use[index];
    *out = (tl_wire_status_t){
        .axis = index,
        .table = table->state,
        .table_reason = table->reason,
        .table_sequence = table->sequence,
        .table_crc = table->crc,
        .t_us = now_us,
        .strength_q15 = axis->tip.strength_q15,
        .settings = app->settings,
    };
    const tl_count_q8_t p = look_at_axis(axis, out);
    out->flags = (uint16_t)(out->flags | (axis->settings.commissioned != 0U ? TL_WIRE_FLAG_COMMISSIONED : 0U));
    if (axis->has_table) {
        uint32_t ends = 0;
        out->c_est_q16 = tl_lookup_angle(&axis->tip.lookup, p, &ends);
    }
}

static void counters(tl_app_t *app, bool clear, tl_us_t now_us, tl_wire_counters_t *out) {
    *out = app->counters;
    out->t_us = now_us;
    for (uint8_t i = 0; i < app->port->axes; i++) {
        out->telemetry_dropped += app->axes[i].telemetry.dropped;
    }
    if (clear) {
        memset(&app->counters, 0, sizeof(app->counters));
        app->parser.bytes_bad = 0;
        for (uint8_t i = 0; i < app->port->axes; i++) {
            app->axes[i].telemetry.dropped = 0;
        }
    }
}

static TL_FAST uint8_t set_point(tl_app_t *app, const tl_wire_set_point_t *request, tl_us_t now_us) {
    bool late = false;
    const uint8_t reason = tl_axis_set_point(&app->axes[request->axis], request, now_us, &late);
    app->counters.set_points += reason == 0 ? 1U : 0U;
    app->counters.set_points_dropped += reason == 0 ? 0U : 1U;
    app->counters.set_points_late += late ? 1U : 0U;
    return reason;
}

static void get_servo(const tl_axis_t *axis, tl_wire_servo_t *out) {
    const tl_servo_gains_t *gains = &axis->motor.servo.gains;
    *out = (tl_wire_servo_t){
        .axis = axis->index,
        .proportional = gains->proportional,
        .integral = gains->integral,
        .derivative = gains->derivative,
        .feed_forward = gains->feed_forward,
        .inertia = gains->inertia,
        .friction_q15 = gains->friction,
    };
}

static TL_FAST uint8_t enable(tl_axis_t *axis, uint8_t on) {
    if (on > 1U) {
        return TL_WIRE_REASON_RANGE;
    }
    if (on == 1U) {
        return tl_axis_enable(axis);
    }
    tl_axis_stop(axis, true);
    return 0;
}

static TL_FAST uint8_t telemetry(tl_axis_t *axis, uint8_t divider) {
    if (divider > TL_WIRE_DIVIDER_MAX) {
        return TL_WIRE_REASON_RANGE;
    }
    axis->telemetry.divider = divider;
    axis->telemetry.skipped = 0;
    axis->telemetry.tail = axis->telemetry.head; // a batch holds samples of one period
    return 0;
}

// Requests that name one axis or all, with the control step kept out. `of` is the request, known to be decoded.
static TL_FAST uint8_t of_one_moment(tl_app_t *app, uint8_t type, const tl_wire_message_t *of, tl_axis_t *axis,
                                     tl_us_t now_us) {
    switch (type) {
    case TL_WIRE_ENABLE:
        return enable(axis, of->enable.on);
    case TL_WIRE_TELEMETRY:
        return telemetry(axis, of->telemetry.divider);
    case TL_WIRE_SAFE_STOP:
        tl_axis_fail(axis, TL_WIRE_FAULT_STOPPED, 0, now_us);
        return 0;
    case TL_WIRE_CLEAR_FAULT:
        return tl_axis_clear_fault(axis, now_us);
    case TL_WIRE_MOVE:
        return tl_axis_move(axis, &of->move);
    case TL_WIRE_JOG:
        return tl_axis_jog(axis, &of->jog);
    case TL_WIRE_HOME:
        return tl_axis_home(axis, &of->home);
    case TL_WIRE_CHECK:
        return tl_axis_check(axis);
    case TL_WIRE_STRENGTH:
        return tl_axis_set_strength(axis, of->strength.strength_q15);
    case TL_WIRE_ADAPT:
        return tl_axis_adapt(axis, &of->adapt);
    case TL_WIRE_LOAD:
        return tl_axis_load(axis, &of->load);
    case TL_WIRE_ANY_TABLE:
        app->tables.in_use[axis->index].any = true;
        return 0;
    case TL_WIRE_SET_POINT:
        return set_point(app, &of->set_point, now_us);
    case TL_WIRE_MOTION_STOP:
        if (app->calibration.axis != axis) {
            return TL_WIRE_REASON_NOT_CALIBRATING;
        }
        tl_calibration_stop(&app->calibration, false);
        return 0;
    default:
        return TL_WIRE_REASON_UNKNOWN_TYPE;
    }
}

static TL_FAST_LOCKED uint8_t at_once(tl_app_t *app, uint8_t type, const tl_wire_message_t *of, tl_axis_t *axis,
                                      tl_us_t now_us) {
    const tl_port_t *port = app->port;
    const uint32_t state = port->lock(port->context);
    const uint8_t reason = of_one_moment(app, type, of, axis, now_us);
    port->unlock(port->context, state);
    return reason;
}

// The same; what has to be worked out for some of them is, before the control step is kept out.
static uint8_t for_axis(tl_app_t *app, uint8_t type, const tl_wire_message_t *of, tl_axis_t *axis, tl_us_t now_us) {
    switch (type) {
    case TL_WIRE_FOLLOW:
        return tl_axis_follow(axis, &of->follow, now_us);
    case TL_WIRE_SET_POSITION:
        return tl_axis_set_position(axis, of->set_position.q_q8);
    case TL_WIRE_LIMITS:
        return tl_axis_set_limits(axis, &of->limits);
    case TL_WIRE_SERVO:
        return tl_axis_set_servo(axis, &of->servo);
    case TL_WIRE_MOTION_START:
        return tl_calibration_start(&app->calibration, axis, &of->motion_start);
    default:
        return at_once(app, type, of, axis, now_us);
    }
}

static bool takes_all(uint8_t type, const tl_wire_message_t *of) {
    return (type == TL_WIRE_ENABLE && of->enable.on == 0U) || type == TL_WIRE_TELEMETRY || type == TL_WIRE_SAFE_STOP ||
           type == TL_WIRE_CLEAR_FAULT;
}

static answer_t handle_axis(tl_app_t *app, uint8_t type, const tl_wire_message_t *of, tl_us_t now_us) {
    const uint8_t index = of->get_status.axis; // every such request begins with it
    const bool all = index == TL_WIRE_ALL_AXES && takes_all(type, of);
    if (!all && index >= app->port->axes) {
        return refuse(TL_WIRE_REASON_AXIS);
    }
    uint8_t reason = 0;
    for (uint8_t i = 0; i < app->port->axes; i++) {
        if (all || i == index) {
            const uint8_t one = for_axis(app, type, of, &app->axes[i], now_us);
            reason = reason == 0 ? one : reason;
        }
    }
    return (answer_t){.type = type == TL_WIRE_SET_POINT ? 0U : TL_WIRE_ACK, .reason = reason};
}

static answer_t get(const tl_app_t *app, uint8_t type, uint8_t index, tl_us_t now_us, tl_wire_message_t *out) {
    const tl_axis_t *axis = &app->axes[index];
    switch (type) {
    case TL_WIRE_GET_LIMITS:
        out->limits = axis->limits;
        return with(TL_WIRE_LIMITS);
    case TL_WIRE_GET_SERVO:
        get_servo(axis, &out->servo);
        return with(TL_WIRE_SERVO);
    case TL_WIRE_GET_SETTINGS:
        out->settings = axis->settings;
        return with(TL_WIRE_SETTINGS);
    default:
        status(app, index, now_us, &out->status);
        return with(TL_WIRE_STATUS);
    }
}

// Requests that write flash.
static uint8_t write(tl_app_t *app, uint8_t type, const tl_wire_message_t *of) {
    if (!tl_tables_all_off(app->port, app->axes)) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    if (type == TL_WIRE_CLEAR_TABLE) {
        return tl_tables_clear(&app->tables, of->clear_table.axis);
    }
    if (of->settings.key != TL_WIRE_KEY) {
        return TL_WIRE_REASON_KEY;
    }
    tl_tables_abort(&app->tables);
    const uint8_t reason = tl_settings_store(app->port, app->axes, &of->settings, app->upload);
    app->settings = reason == 0 ? TL_WIRE_STORE_NEWEST : app->settings;
    return reason;
}

static answer_t handle(tl_app_t *app, uint8_t type, const tl_wire_message_t *of, tl_us_t now_us,
                       tl_wire_message_t *out) {
    switch (type) {
    case TL_WIRE_HELLO:
        app->update.heard = true;
        identity(app, now_us, &out->identity);
        return with(TL_WIRE_IDENTITY);
    case TL_WIRE_GET_FIRMWARE:
        tl_update_tell(&app->update, &out->firmware);
        return with(TL_WIRE_FIRMWARE);
    case TL_WIRE_GET_LOGGED:
        tl_fault_log_read(&app->fault_log, of->get_logged.index, &out->logged);
        return with(TL_WIRE_LOGGED);
    case TL_WIRE_ANY_FIRMWARE:
        app->update.any = of->any_firmware.key == TL_WIRE_KEY;
        return done(app->update.any ? 0U : TL_WIRE_REASON_KEY);
    case TL_WIRE_PING:
        out->pong = (tl_wire_pong_t){.host_us = of->ping.host_us, .t_us = now_us};
        return with(TL_WIRE_PONG);
    case TL_WIRE_GET_COUNTERS:
        counters(app, of->get_counters.clear != 0U, now_us, &out->counters);
        return with(TL_WIRE_COUNTERS);
    case TL_WIRE_REBOOT:
        if (of->reboot.key != TL_WIRE_KEY) {
            return refuse(TL_WIRE_REASON_KEY);
        }
        for (uint8_t i = 0; i < app->port->axes; i++) {
            const uint32_t state = app->port->lock(app->port->context);
            tl_axis_stop(&app->axes[i], true);
            app->port->unlock(app->port->context, state);
        }
        app->reboot = of->reboot.bootloader != 0U ? 2U : 1U;
        app->reboot_us = now_us;
        return done(0);
    case TL_WIRE_GET_STATUS:
    case TL_WIRE_GET_LIMITS:
    case TL_WIRE_GET_SERVO:
    case TL_WIRE_GET_SETTINGS:
        return of->get_status.axis < app->port->axes ? get(app, type, of->get_status.axis, now_us, out)
                                                     : refuse(TL_WIRE_REASON_AXIS);
    case TL_WIRE_TABLE_WRITE:
    case TL_WIRE_TABLE_STORE:
    case TL_WIRE_TABLE_READ: {
        uint8_t answer = TL_WIRE_ACK;
        const uint8_t reason = tl_command_table(&app->tables, type, of, out, &answer);
        return reason != 0 ? refuse(reason) : with(answer);
    }
    case TL_WIRE_CLEAR_TABLE:
    case TL_WIRE_SETTINGS:
        return of->get_status.axis < app->port->axes ? done(write(app, type, of)) : refuse(TL_WIRE_REASON_AXIS);
    default:
        return handle_axis(app, type, of, now_us);
    }
}

// A marker has its own way: below it comes the onset detector, and messages of any size need not be on the stack then.
static __attribute__((noinline)) bool decode_marker(const tl_wire_frame_t *frame, tl_wire_marker_t *marker) {
    tl_wire_message_t request;
    const bool decoded = tl_wire_decode(frame->type, frame->payload, frame->size, &request);
    if (decoded) {
        *marker = request.marker;
    }
    return decoded;
}

static uint8_t take_marker(tl_app_t *app, const tl_wire_frame_t *frame, tl_us_t now_us) {
    tl_wire_marker_t marker;
    return decode_marker(frame, &marker) ? tl_report_marker(app, &marker, now_us) : TL_WIRE_REASON_SHORT;
}

static __attribute__((noinline)) void answer_request(tl_app_t *app, const tl_wire_frame_t *frame, uint8_t reason,
                                                     tl_us_t now_us) {
    tl_wire_message_t request;
    tl_wire_message_t out;
    answer_t answer = refuse(reason);
    if (reason == TL_WIRE_REASON_UNKNOWN_TYPE && frame->type != TL_WIRE_MARKER && frame->type < TL_WIRE_ACK &&
        tl_wire_size(frame->type) != 0U) {
        answer = tl_wire_decode(frame->type, frame->payload, frame->size, &request)
                     ? handle(app, frame->type, &request, now_us, &out)
                     : refuse(TL_WIRE_REASON_SHORT);
    }
    if (answer.reason != 0) {
        app->counters.requests_refused++;
        out.error = (tl_wire_error_t){.request = frame->type, .reason = answer.reason};
        answer.type = TL_WIRE_ERROR;
    } else if (answer.type == TL_WIRE_ACK) {
        out.ack.request = frame->type;
    }
    if (answer.type != 0U) {
        const bool sent = tl_outbox_send(&app->outbox, answer.type, frame->sequence, &out);
        app->counters.frames_out += sent ? 1U : 0U;
        app->counters.replies_dropped += sent ? 0U : 1U;
    }
}

void tl_command(tl_app_t *app, const tl_wire_frame_t *frame) {
    const tl_us_t now_us = app->port->time_us(app->port->context);
    uint8_t reason = TL_WIRE_REASON_UNKNOWN_TYPE;
    if (!app->outbox.open) {
        answer_request(app, frame, TL_WIRE_REASON_SESSION, now_us);
        return;
    }
    if (frame->type == TL_WIRE_MARKER) {
        reason = take_marker(app, frame, now_us);
    }
    if (reason != 0) {
        answer_request(app, frame, reason, now_us);
    }
}
