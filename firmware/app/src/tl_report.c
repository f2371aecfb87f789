#include "tautline/tl_report.h"

#include <stdatomic.h>

// What finds no room is counted: `worth` things.
static void tell(tl_app_t *app, uint8_t type, const void *message, uint32_t *dropped, uint32_t worth) {
    if (tl_outbox_tell(&app->outbox, type, message)) {
        app->counters.frames_out++;
    } else {
        *dropped += worth;
    }
}

static void tell_samples(tl_app_t *app, tl_axis_t *axis, tl_us_t now_us) {
    tl_axis_telemetry_t *telemetry = &axis->telemetry;
    const uint32_t divider = telemetry->divider == 0 ? 1U : telemetry->divider;
    while (telemetry->head - telemetry->tail >= TL_WIRE_BATCH_SAMPLES &&
           tl_outbox_has_room(&app->outbox, TL_WIRE_BATCH)) { // what has to wait does so here
        atomic_signal_fence(memory_order_acquire);            // no sample is read before head says that it is there,
        // The control step may have come since now_us was read: the difference has a sign.
        const uint32_t first_us = telemetry->samples[telemetry->tail % TL_AXIS_SAMPLES].t_us;
        const int32_t ago_us = (int32_t)((uint32_t)now_us - first_us);
        tl_wire_batch_t batch = {
            .axis = axis->index,
            .count = TL_WIRE_BATCH_SAMPLES,
            .period_us = (uint16_t)(divider * 1000U),
            .supply_mv = axis->guard.supply_mv,
            .t_us = now_us - (tl_us_t)(int64_t)ago_us,
        };
        for (unsigned i = 0; i < TL_WIRE_BATCH_SAMPLES; i++) {
            const tl_sample_t *sample = &telemetry->samples[(telemetry->tail + i) % TL_AXIS_SAMPLES];
            batch.q_q8[i] = sample->q;
            batch.q_ref_q8[i] = sample->q_ref;
            batch.p_q8[i] = sample->p;
            batch.c_ref_q16[i] = sample->c_ref;
            batch.c_est_q16[i] = sample->c_est;
            batch.duty_q15[i] = sample->duty;
            batch.flags[i] = sample->flags;
        }
        atomic_signal_fence(memory_order_release); // nor after its place was given back
        telemetry->tail = telemetry->tail + TL_WIRE_BATCH_SAMPLES;
        tell(app, TL_WIRE_BATCH, &batch, &app->counters.telemetry_dropped, TL_WIRE_BATCH_SAMPLES);
    }
}

static void tell_events(tl_app_t *app, tl_axis_t *axis, tl_us_t now_us) {
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

void tl_report_axes(tl_app_t *app, tl_us_t now_us) {
    for (uint8_t i = 0; i < app->port->axes; i++) {
        if (app->axes[i].events != 0) {
            tell_events(app, &app->axes[i], now_us);
        }
        tell_samples(app, &app->axes[i], now_us);
    }
}

static void tell_progress(tl_app_t *app, const tl_axis_t *axis, uint8_t how, tl_us_t now_us) {
    tl_wire_progress_t progress;
    tl_calibration_progress_message(&app->calibration, axis, how, now_us, &progress);
    tell(app, TL_WIRE_PROGRESS, &progress, &app->counters.events_dropped, 1U);
}

static void tell_onset(tl_app_t *app, const tl_onset_t *onset, tl_us_t now_us) {
    tl_calibration_t *calibration = &app->calibration;
    const uint32_t state = app->port->lock(app->port->context);
    tl_calibration_turn(calibration, onset);
    app->port->unlock(app->port->context, state);
    tl_wire_onset_t message;
    tl_calibration_onset_message(calibration, onset, &message);
    tell(app, TL_WIRE_ONSET, &message, &app->counters.onsets_dropped, 1U);
    tell_progress(app, calibration->axis, TL_WIRE_MOTION_RUNNING, now_us);
}

void tl_report_calibration(tl_app_t *app, tl_us_t now_us) {
    tl_calibration_t *calibration = &app->calibration;
    const tl_axis_t *axis = calibration->axis;
    if (axis == NULL) {
        return;
    }
    tl_onset_t onset;
    if (tl_calibration_poll(calibration, now_us, &onset)) {
        tell_onset(app, &onset, now_us);
    }
    uint8_t how = 0;
    const uint32_t state = app->port->lock(app->port->context);
    const bool ended = tl_calibration_ended(calibration, now_us, &how);
    app->port->unlock(app->port->context, state);
    if (ended) {
        tell_progress(app, axis, how, now_us);
    }
}

uint8_t tl_report_marker(tl_app_t *app, const tl_wire_marker_t *marker, tl_us_t now_us) {
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
    tl_calibration_frame(calibration);
    app->port->unlock(app->port->context, state);
    const uint32_t ignored = calibration->work.detector.ignored;
    tl_onset_t onset;
    if (tl_calibration_marker(calibration, marker, &onset)) {
        tell_onset(app, &onset, now_us);
    }
    const bool dropped = calibration->work.detector.ignored != ignored;
    app->counters.markers_dropped += dropped ? 1U : 0U;
    app->counters.markers += dropped ? 0U : 1U;
    return 0;
}
