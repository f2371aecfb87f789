#include "tautline/tl_app.h"

#include <string.h>

#define POLL_US       1000U
#define FRAME_IDLE_US 20000U // after which the rest of a frame does not come any more
#define REBOOT_US     50000U // for the acknowledgement to leave
#define NOBODY_READS  500000U
#define REST_MOST_US  10000000U // for axes that do not come to rest

// -- tables -----------------------------------------------------------------------------------------------------

static bool all_off(const tl_app_t *app) {
    for (uint8_t i = 0; i < app->port->axes; i++) {
        if (app->axes[i].mode != TL_WIRE_MODE_OFF) {
            return false;
        }
    }
    return true;
}

// Loads the best table that flash holds. The motor is off: nothing else looks at the axis' table meanwhile.
static void load_table(tl_app_t *app, uint8_t index) {
    tl_axis_t *axis = &app->axes[index];
    tl_table_in_use_t *table = &app->tables[index];
    tl_slot_t slots[TL_STORE_SLOTS];
    tl_store_order(app->port, index, slots);
    const uint32_t state = app->port->lock(app->port->context);
    axis->has_table = false; // keeps the control step away from the look-up
    app->port->unlock(app->port->context, state);
    *table = (tl_table_in_use_t){.state = TL_WIRE_TABLE_NONE, .reason = table->reason};
    bool found = false;
    for (unsigned i = 0; i < TL_STORE_SLOTS && !found; i++) {
        if (slots[i].blank) {
            continue;
        }
        uint8_t reason = TL_TABLE_BAD_CRC;
        if (slots[i].whole) {
            reason = (uint8_t)tl_lookup_load(&axis->lookup, slots[i].blob, slots[i].size, index);
        }
        found = reason == TL_TABLE_OK;
        if (found) {
            // A damaged slot of unknown age may have been the newer one.
            const tl_slot_t *other = &slots[1U - i];
            const bool newest = other->blank || (other->dated && (int32_t)(slots[i].sequence - other->sequence) > 0);
            *table = (tl_table_in_use_t){.state = newest ? TL_WIRE_TABLE_NEWEST : TL_WIRE_TABLE_OLDER,
                                         .reason = table->reason,
                                         .sequence = slots[i].sequence,
                                         .crc = slots[i].crc,
                                         .size = slots[i].size,
                                         .blob = slots[i].blob};
        } else {
            table->state = TL_WIRE_TABLE_BAD;
            table->reason = reason;
        }
    }
    const uint32_t again = app->port->lock(app->port->context);
    tl_axis_use_table(axis, found);
    app->port->unlock(app->port->context, again);
}

size_t tl_app_table_read(const tl_app_t *app, uint8_t axis, uint32_t offset, uint8_t *out, size_t room) {
    if (axis >= app->port->axes || app->tables[axis].blob == NULL || offset >= app->tables[axis].size) {
        return 0;
    }
    const size_t left = app->tables[axis].size - offset;
    const size_t size = left < room ? left : room;
    memcpy(out, app->tables[axis].blob + offset, size);
    return size;
}

uint8_t tl_app_table_clear(tl_app_t *app, uint8_t axis) {
    if (!all_off(app)) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    const bool done = tl_store_clear(app->port, axis);
    app->tables[axis].reason = TL_TABLE_OK;
    load_table(app, axis);
    return done ? 0 : TL_WIRE_REASON_FLASH;
}

// -- to the host ------------------------------------------------------------------------------------------------

bool tl_app_send(tl_app_t *app, uint8_t type, uint16_t sequence, const void *message) {
    const size_t size = TL_WIRE_HEADER_SIZE + tl_wire_size(type) + TL_WIRE_CRC_SIZE;
    const bool may = app->bus || type == TL_WIRE_ERROR; // who has no session is told so
    if (!may || size > TL_APP_QUEUE - (app->queue_head - app->queue_tail)) {
        return false;
    }
    uint8_t frame[TL_WIRE_FRAME_MAX];
    tl_wire_frame(frame, type, sequence, message);
    for (size_t i = 0; i < size; i++) {
        app->queue[(app->queue_head + i) % TL_APP_QUEUE] = frame[i];
    }
    app->queue_head += (uint32_t)size;
    app->counters.frames_out++;
    return true;
}

size_t tl_app_transmit(tl_app_t *app, uint8_t *out, size_t room) {
    size_t size = 0;
    while (size < room && app->queue_tail != app->queue_head) {
        out[size++] = app->queue[app->queue_tail++ % TL_APP_QUEUE];
    }
    return size;
}

// Unasked frames carry a sequence of their own; one that finds no room leaves a gap in it.
static void tell(tl_app_t *app, uint8_t type, const void *message, uint32_t *dropped, uint32_t worth) {
    if (!tl_app_send(app, type, app->unasked++, message)) {
        *dropped += worth;
    }
}

static void send_samples(tl_app_t *app, tl_axis_t *axis, tl_us_t now_us) {
    const uint32_t divider = axis->divider == 0 ? 1U : axis->divider;
    while (axis->sample_head - axis->sample_tail >= TL_WIRE_BATCH_SAMPLES) {
        // The control step may have come since now_us was read: the difference has a sign.
        const int32_t ago_us = (int32_t)((uint32_t)now_us - axis->samples[axis->sample_tail % TL_AXIS_SAMPLES].t_us);
        tl_wire_batch_t batch = {
            .axis = axis->index,
            .count = TL_WIRE_BATCH_SAMPLES,
            .period_us = (uint16_t)(divider * 1000U),
            .t_us = now_us - (tl_us_t)(int64_t)ago_us,
        };
        for (unsigned i = 0; i < TL_WIRE_BATCH_SAMPLES; i++) {
            const tl_sample_t *sample = &axis->samples[(axis->sample_tail + i) % TL_AXIS_SAMPLES];
            batch.q_q8[i] = sample->q;
            batch.q_ref_q8[i] = sample->q_ref;
            batch.p_q8[i] = sample->p;
            batch.c_ref_q16[i] = sample->c_ref;
            batch.c_est_q16[i] = sample->c_est;
            batch.duty_q15[i] = sample->duty;
            batch.flags[i] = sample->flags;
        }
        axis->sample_tail = axis->sample_tail + TL_WIRE_BATCH_SAMPLES;
        tell(app, TL_WIRE_BATCH, &batch, &app->counters.telemetry_dropped, TL_WIRE_BATCH_SAMPLES);
    }
}

static void send_events(tl_app_t *app, tl_axis_t *axis, tl_us_t now_us) {
    const uint32_t state = app->port->lock(app->port->context);
    const uint8_t events = axis->events;
    axis->events = 0;
    const tl_wire_event_t now = {.axis = axis->index, .fault = axis->fault, .mode = axis->mode, .t_us = now_us};
    app->port->unlock(app->port->context, state);
    for (uint8_t code = 1; code < 8U; code++) {
        if ((events >> code & 1U) != 0) {
            tl_wire_event_t message = now;
            message.event = code;
            app->counters.silences += code == TL_WIRE_EVENT_SILENT ? 1U : 0U;
            tell(app, TL_WIRE_EVENT, &message, &app->counters.events_dropped, 1U);
        }
    }
}

static void send_onset(tl_app_t *app, const tl_onset_t *onset, tl_us_t now_us) {
    tl_calibration_t *calibration = &app->calibration;
    if (onset->started) { // else the stroke goes on, so that the tip is on an envelope again at its end
        const uint32_t state = app->port->lock(app->port->context);
        tl_motion_onset(&calibration->motion, onset->direction);
        app->port->unlock(app->port->context, state);
    }
    tl_wire_onset_t message;
    tl_calibration_onset_message(calibration, onset, &message);
    tell(app, TL_WIRE_ONSET, &message, &app->counters.onsets_dropped, 1U);
    tl_wire_progress_t progress;
    tl_calibration_progress_message(calibration, calibration->axis, TL_WIRE_MOTION_RUNNING, now_us, &progress);
    tell(app, TL_WIRE_PROGRESS, &progress, &app->counters.events_dropped, 1U);
}

// -- calibration ------------------------------------------------------------------------------------------------

static void poll_calibration(tl_app_t *app, tl_us_t now_us) {
    tl_calibration_t *calibration = &app->calibration;
    tl_axis_t *axis = calibration->axis;
    if (axis == NULL) {
        return;
    }
    tl_onset_t onset;
    if (tl_calibration_poll(calibration, now_us, &onset)) {
        send_onset(app, &onset, now_us);
    }
    uint8_t how = 0;
    const uint32_t state = app->port->lock(app->port->context);
    const bool ended = tl_calibration_ended(calibration, now_us, &how);
    app->port->unlock(app->port->context, state);
    if (ended) {
        tl_wire_progress_t progress;
        tl_calibration_progress_message(calibration, axis, how, now_us, &progress);
        tell(app, TL_WIRE_PROGRESS, &progress, &app->counters.events_dropped, 1U);
    }
}

uint8_t tl_app_marker(tl_app_t *app, const tl_wire_marker_t *marker, tl_us_t now_us) {
    tl_calibration_t *calibration = &app->calibration;
    if (calibration->axis == NULL) {
        app->counters.markers_dropped++;
        return TL_WIRE_REASON_NOT_CALIBRATING;
    }
    if (marker->arrival_us > now_us) {
        app->counters.markers_dropped++;
        return TL_WIRE_REASON_RANGE;
    }
    const uint32_t state = app->port->lock(app->port->context);
    tl_motion_frame(&calibration->motion);
    app->port->unlock(app->port->context, state);
    const uint32_t ignored = calibration->detector.ignored;
    tl_onset_t onset;
    if (tl_calibration_marker(calibration, marker, &onset)) {
        send_onset(app, &onset, now_us);
    }
    const bool dropped = calibration->detector.ignored != ignored;
    app->counters.markers_dropped += dropped ? 1U : 0U;
    app->counters.markers += dropped ? 0U : 1U;
    return 0;
}

// -- a table from the host ---------------------------------------------------------------------------------------

tl_upload_t tl_app_table_data(tl_app_t *app, uint8_t axis, uint32_t offset, const uint8_t *bytes, size_t size) {
    if (axis >= app->port->axes) {
        return TL_UPLOAD_AXIS;
    }
    poll_calibration(app, app->port->time_us(app->port->context)); // one that an axis' fault has ended is over now
    if (app->calibration.axis != NULL) {
        return TL_UPLOAD_NOT_OFF;
    }
    if (offset == 0) {
        app->upload_size = 0;
        app->upload_axis = axis;
    }
    if (axis != app->upload_axis || offset != app->upload_size || size > TL_TABLE_SIZE_MAX - app->upload_size) {
        app->upload_size = 0;
        return TL_UPLOAD_SIZE;
    }
    memcpy(app->calibration.upload + offset, bytes, size);
    app->upload_size += (uint32_t)size;
    return TL_UPLOAD_OK;
}

void tl_app_table_abort(tl_app_t *app) {
    app->upload_size = 0;
}

tl_upload_t tl_app_table_end(tl_app_t *app, uint8_t axis) {
    if (axis >= app->port->axes) {
        return TL_UPLOAD_AXIS;
    }
    const uint16_t size = (uint16_t)app->upload_size;
    app->upload_size = 0;
    if (!all_off(app)) {
        return TL_UPLOAD_NOT_OFF;
    }
    if (size == 0 || axis != app->upload_axis) {
        return TL_UPLOAD_SIZE;
    }
    // Checked in the axis' own look-up, which is loaded from flash again below whatever comes of it.
    const uint32_t state = app->port->lock(app->port->context);
    app->axes[axis].has_table = false;
    app->port->unlock(app->port->context, state);
    const tl_table_reason_t reason = tl_lookup_load(&app->axes[axis].lookup, app->calibration.upload, size, axis);
    const bool written = reason == TL_TABLE_OK && tl_store_write(app->port, axis, app->calibration.upload, size);
    app->tables[axis].reason = (uint8_t)reason;
    load_table(app, axis);
    if (reason != TL_TABLE_OK) {
        return TL_UPLOAD_REFUSED;
    }
    if (!written) {
        return TL_UPLOAD_FLASH;
    }
    app->axes[axis].events = (uint8_t)(app->axes[axis].events | (1U << TL_WIRE_EVENT_TABLE));
    return TL_UPLOAD_OK;
}

// -- session ----------------------------------------------------------------------------------------------------

static void begin_session(tl_app_t *app) {
    app->bus = true;
    app->queue_tail = app->queue_head;
    app->upload_size = 0;
}

static void end_session(tl_app_t *app) {
    if (app->bus) {
        app->counters.bus_losses++;
    }
    app->bus = false;
    app->queue_tail = app->queue_head;
    app->upload_size = 0;
    const uint32_t state = app->port->lock(app->port->context);
    for (uint8_t i = 0; i < app->port->axes; i++) {
        tl_axis_t *axis = &app->axes[i];
        axis->divider = 0;
        axis->sample_tail = axis->sample_head;
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

// -- task -------------------------------------------------------------------------------------------------------

static void take_frames(tl_app_t *app, const uint8_t *bytes, size_t size) {
    tl_wire_frame_t frame;
    while (tl_wire_parse(&app->parser, &bytes, &size, &frame)) {
        app->counters.frames_in++;
        if (app->line && frame.type == TL_WIRE_HELLO) {
            end_session(app);
            begin_session(app);
        }
        tl_command(app, &frame);
    }
    app->counters.bytes_bad = app->parser.bytes_bad;
}

void tl_app_receive(tl_app_t *app, const uint8_t *bytes, size_t size) {
    app->received_us = app->port->time_us(app->port->context);
    take_frames(app, bytes, size);
}

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
            tl_axis_fail(&app->axes[i], TL_WIRE_FAULT_EDGES, now_us);
            app->port->unlock(app->port->context, state);
        }
    }
}

void tl_app_task(tl_app_t *app) {
    const tl_us_t now_us = app->port->time_us(app->port->context);
    if (now_us - app->polled_us >= POLL_US) {
        app->polled_us = now_us;
        poll_calibration(app, now_us);
        poll_encoders(app, now_us);
        poll_half_frame(app, now_us);
        if (app->steps != app->steps_fed) {
            app->steps_fed = app->steps;
            app->port->watchdog_feed(app->port->context);
        }
    }
    for (uint8_t i = 0; i < app->port->axes; i++) {
        if (app->axes[i].events != 0) {
            send_events(app, &app->axes[i], now_us);
        }
        send_samples(app, &app->axes[i], now_us);
    }
    const tl_us_t since_us = now_us - app->reboot_us;
    const bool sent = app->queue_tail == app->queue_head && since_us >= REBOOT_US;
    const bool rests = all_off(app) || since_us >= REST_MOST_US;
    if (app->reboot != 0 && rests && (sent || since_us >= NOBODY_READS)) {
        app->port->reboot(app->port->context, app->reboot == 2U);
    }
}

// -- start and control ------------------------------------------------------------------------------------------

void tl_app_init(tl_app_t *app, const tl_port_t *port) {
    memset(app, 0, sizeof(*app));
    app->port = port;
    app->control_us = port->time_us(port->context);
    for (uint8_t i = 0; i < port->axes; i++) {
        tl_axis_init(&app->axes[i], port, i);
        load_table(app, i);
        if (port->boot == TL_WIRE_BOOT_WATCHDOG) {
            tl_axis_fail(&app->axes[i], TL_WIRE_FAULT_WATCHDOG, app->control_us);
        }
        if (app->tables[i].state == TL_WIRE_TABLE_BAD) {
            tl_axis_fail(&app->axes[i], TL_WIRE_FAULT_TABLE, app->control_us);
        }
    }
}
