#include "tautline/tl_calibration.h"

#include "tautline/tl_axis_ask.h"
#include "tautline/tl_axis_rest.h"
#include "tautline/tl_fast.h"

// The wire names the motion's states and errors by the estimator's own numbers.
_Static_assert((int)TL_WIRE_MOTION_IDLE == (int)TL_MOTION_IDLE, "motion states");
_Static_assert((int)TL_WIRE_MOTION_RUNNING == (int)TL_MOTION_RUNNING, "motion states");
_Static_assert((int)TL_WIRE_MOTION_STOPPING == (int)TL_MOTION_STOPPING, "motion states");
_Static_assert((int)TL_WIRE_MOTION_COMPLETE == (int)TL_MOTION_COMPLETE, "motion states");
_Static_assert((int)TL_WIRE_MOTION_STOPPED == (int)TL_MOTION_STOPPED, "motion states");
_Static_assert((int)TL_WIRE_MOTION_HOST_LOST == (int)TL_MOTION_HOST_LOST, "motion states");

static uint8_t reason_of(tl_motion_error_t error) {
    switch (error) {
    case TL_MOTION_OK:
        return 0;
    case TL_MOTION_BAD_RANGE:
        return TL_WIRE_REASON_MOTION_RANGE;
    case TL_MOTION_BAD_SPEED:
        return TL_WIRE_REASON_MOTION_SPEED;
    case TL_MOTION_BAD_ACCELERATION:
        return TL_WIRE_REASON_MOTION_ACCELERATION;
    case TL_MOTION_BAD_STROKE:
        return TL_WIRE_REASON_MOTION_STROKE;
    case TL_MOTION_BAD_CYCLES:
        return TL_WIRE_REASON_MOTION_CYCLES;
    case TL_MOTION_BAD_RATE:
    default:
        return TL_WIRE_REASON_MOTION_RATE;
    }
}

static tl_onset_config_t onset_config(const tl_wire_motion_start_t *request) {
    tl_onset_config_t config = tl_onset_defaults();
    config.delay_us = request->delay_us;
#define TAKE(field, value)                                                                                             \
    if ((value) != 0) {                                                                                                \
        config.field = (value);                                                                                        \
    }
    TAKE(guard_us, request->guard_us)
    TAKE(lost_us, request->lost_us)
    TAKE(timeout_us, request->timeout_us)
    TAKE(turn, request->turn_q8)
    TAKE(sigma_wanted, request->sigma_wanted_q8)
    TAKE(sigma_usable, request->sigma_usable_q8)
    TAKE(noise_px, request->noise_q12)
    TAKE(curvature, request->curvature)
    TAKE(threshold, request->threshold_q4)
    TAKE(frames_min, request->frames_min)
    TAKE(frames_max, request->frames_max)
#undef TAKE
    return config;
}

uint8_t tl_calibration_start(tl_calibration_t *calibration, tl_axis_t *axis, const tl_wire_motion_start_t *request) {
    if (calibration->axis != NULL) {
        return TL_WIRE_REASON_BUSY;
    }
    if (request->host_timeout_us == 0 || request->low_q8 < axis->plan.low || request->high_q8 > axis->plan.high) {
        return TL_WIRE_REASON_RANGE;
    }
    tl_motion_config_t motion = {
        .low = request->low_q8,
        .high = request->high_q8,
        .cycles = request->cycles,
        .transit = request->transit_q8_s,
        .acceleration = request->acceleration_q8_s2,
        .approach = request->approach_q8,
        .stroke_max = request->stroke_max_q8,
        .host_timeout_us = request->host_timeout_us,
        .rate_hz = TL_AXIS_PLAN_HZ,
    };
    while (motion.speed_count < TL_MOTION_SPEEDS && request->speed_q8_s[motion.speed_count] != 0) {
        motion.speed[motion.speed_count] = request->speed_q8_s[motion.speed_count];
        motion.speed_count++;
    }
    const tl_onset_config_t onset = onset_config(request);
    if (!tl_onset_init(&calibration->work.detector, &onset)) {
        return TL_WIRE_REASON_ONSET;
    }
    const tl_motion_error_t error =
        tl_motion_start(&calibration->work.motion, &motion, tl_reference_q(&axis->plan.reference));
    if (error != TL_MOTION_OK) {
        return reason_of(error);
    }
    tl_history_init(&calibration->work.history);
    const uint8_t reason = tl_axis_calibrate(axis, &calibration->work.motion, &calibration->work.history);
    if (reason == 0) {
        calibration->axis = axis;
        calibration->host_lost = false;
        calibration->reversals = 0;
    }
    return reason;
}

TL_FAST void tl_calibration_frame(tl_calibration_t *calibration) {
    tl_motion_frame(&calibration->work.motion);
}

TL_FAST void tl_calibration_turn(tl_calibration_t *calibration, const tl_onset_t *onset) {
    if (onset->started) { // else the stroke goes on, so that the tip is on an envelope again at its end
        tl_motion_onset(&calibration->work.motion, onset->direction);
    }
}

static bool finished(tl_calibration_t *calibration, bool is_finished) {
    calibration->reversals = (uint16_t)(calibration->reversals + (is_finished ? 1U : 0U));
    return is_finished;
}

bool tl_calibration_marker(tl_calibration_t *calibration, const tl_wire_marker_t *marker, tl_onset_t *onset) {
    const tl_marker_t sample = {
        .arrival_us = marker->arrival_us,
        .u = marker->u_q12,
        .v = marker->v_q12,
        .sigma = marker->sigma_q12,
        .valid = marker->valid != 0,
        .other_motion = marker->other_motion != 0,
    };
    return finished(calibration,
                    tl_onset_sample(&calibration->work.detector, &calibration->work.history, &sample, onset));
}

bool tl_calibration_poll(tl_calibration_t *calibration, tl_us_t now_us, tl_onset_t *onset) {
    return finished(calibration, tl_onset_poll(&calibration->work.detector, &calibration->work.history, now_us, onset));
}

TL_FAST bool tl_calibration_ended(tl_calibration_t *calibration, tl_us_t now_us, uint8_t *state) {
    tl_axis_t *axis = calibration->axis;
    if (axis == NULL) {
        return false;
    }
    const tl_motion_state_t motion = tl_motion_state(&calibration->work.motion);
    if (axis->mode == TL_WIRE_MODE_CALIBRATE && (motion == TL_MOTION_RUNNING || motion == TL_MOTION_STOPPING)) {
        return false;
    }
    *state = (uint8_t)motion;
    if (axis->fault != TL_WIRE_FAULT_NONE) {
        *state = TL_WIRE_MOTION_FAILED;
    } else if (motion == TL_MOTION_HOST_LOST || calibration->host_lost) {
        *state = TL_WIRE_MOTION_HOST_LOST;
        tl_axis_fail(axis, TL_WIRE_FAULT_HOST_LOST, 0, now_us);
    } else if (axis->mode == TL_WIRE_MODE_CALIBRATE) {
        tl_axis_stop(axis, false); // it rests: the axis holds from here on
    } else {
        *state = TL_WIRE_MOTION_STOPPED;
    }
    axis->history = NULL;
    calibration->axis = NULL;
    return true;
}

TL_FAST void tl_calibration_stop(tl_calibration_t *calibration, bool host_lost) {
    calibration->host_lost = calibration->host_lost || host_lost;
    tl_motion_stop(&calibration->work.motion);
}

void tl_calibration_onset_message(const tl_calibration_t *calibration, const tl_onset_t *onset,
                                  tl_wire_onset_t *message) {
    *message = (tl_wire_onset_t){
        .axis = calibration->axis->index,
        .direction = onset->direction,
        .reason = onset->reason,
        .index = (uint16_t)(calibration->reversals - 1U),
        .frames = onset->frames,
        .turn_us = onset->turn_us,
        .start_us = onset->start_us,
        .q1_q8 = onset->q1,
        .q2_q8 = onset->q2,
        .width_q8 = onset->width,
        .sigma_q8 = onset->sigma,
        .stop_q8 = onset->stop,
        .sigma_stop_q8 = onset->sigma_stop,
        .speed_stop_q8_s = onset->speed_stop,
        .speed_start_q8_s = onset->speed_start,
        .slope_q12 = onset->slope,
        .noise_q12 = onset->noise,
    };
}

void tl_calibration_progress_message(const tl_calibration_t *calibration, const tl_axis_t *axis, uint8_t state,
                                     tl_us_t now_us, tl_wire_progress_t *message) {
    *message = (tl_wire_progress_t){
        .axis = axis->index,
        .state = state,
        .permille = tl_motion_progress(&calibration->work.motion),
        .reversals = calibration->reversals,
        .t_us = now_us,
    };
}
