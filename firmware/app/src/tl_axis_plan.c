// Planning one axis: what its control step does once a millisecond, a job in a tick.
#include "tautline/tl_axis.h"

// Whether the motor follows, and what the host asks for.
void tl_axis_listen(tl_axis_t *axis, tl_us_t now_us) {
    const tl_count_q8_t error = axis->path.q - axis->q; // nothing while off
    if (error > axis->limits.following_error_q8 || error < -axis->limits.following_error_q8) {
        tl_axis_fail(axis, TL_WIRE_FAULT_FOLLOWING, now_us);
    }
    axis->stream.now_us = now_us + axis->lead_us;
    if (!tl_axis_is_following(axis)) {
        return;
    }
    if (--axis->patience == 0U) {
        tl_axis_silence(axis);
        return;
    }
    const int32_t value = tl_stream_next(&axis->stream);
    if (axis->mode == TL_WIRE_MODE_FOLLOW_MOTOR) {
        axis->target = value;
        return;
    }
    axis->c_ref = (axis->c_next[0] >> 1) + (axis->c_next[1] >> 1);
    axis->c_next[0] = axis->c_next[1];
    axis->c_next[1] = value;
}

static void come_to_rest(tl_axis_t *axis) {
    if (tl_reference_brake(&axis->reference, &axis->travel)) {
        tl_reference_set(&axis->reference, tl_reference_q(&axis->reference));
        tl_axis_event(axis, TL_WIRE_EVENT_RESTED);
        if (axis->mode == TL_WIRE_MODE_STOPPING) {
            axis->mode = TL_WIRE_MODE_HOLD;
        } else {
            axis->mode = TL_WIRE_MODE_OFF;
            tl_axis_drive(axis, 0);
        }
    }
}

void tl_axis_plan(tl_axis_t *axis) {
    axis->q = tl_clamp(axis->q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    const tl_reference_limits_t *limits = &axis->travel;
    tl_count_q8_t target = axis->target;
    switch (axis->mode) {
    case TL_WIRE_MODE_OFF:
        tl_axis_rest(axis);
        return;
    case TL_WIRE_MODE_STOPPING:
    case TL_WIRE_MODE_STOPPING_OFF:
        come_to_rest(axis);
        return;
    case TL_WIRE_MODE_HOLD:
        target = tl_reference_q(&axis->reference);
        break;
    case TL_WIRE_MODE_MOVE:
        limits = &axis->move;
        target = axis->move_target;
        break;
    default:
        break;
    }
    if (target < axis->lowest || target > axis->highest) {
        axis->noted |= TL_WIRE_FLAG_SATURATED_RANGE;
        target = tl_clamp(target, axis->lowest, axis->highest);
    }
    tl_reference_step(&axis->reference, target, axis->lowest, axis->highest, limits);
    if (axis->mode == TL_WIRE_MODE_MOVE) {
        if (tl_reference_rests_at(&axis->reference, target)) {
            axis->mode = TL_WIRE_MODE_HOLD;
            tl_axis_event(axis, TL_WIRE_EVENT_ARRIVED);
        }
    } else if (axis->reference.behind) {
        axis->noted |= TL_WIRE_FLAG_SATURATED_SPEED;
    }
}

void tl_axis_catch_up(tl_axis_t *axis, uint32_t job, tl_us_t now_us) {
    for (; job < TL_AXIS_JOBS; job++) {
        tl_axis_job(axis, job, now_us);
    }
}
