// What is watched and told of one axis once a millisecond.
#include "tautline/tl_axis.h"

uint16_t tl_axis_flags(const tl_axis_t *axis) {
    uint32_t flags = axis->noted;
    if (axis->mode == TL_WIRE_MODE_FOLLOW_TIP) {
        const uint32_t now = axis->compensator.flags;
        flags |= TL_WIRE_FLAG_COMPENSATING;
        flags |= (now & (TL_COMPENSATOR_BELOW | TL_COMPENSATOR_ABOVE | TL_COMPENSATOR_CLIPPED)) != 0
                     ? TL_WIRE_FLAG_SATURATED_RANGE
                     : 0U;
        flags |= (now & (TL_COMPENSATOR_LIMITED | TL_COMPENSATOR_FLAT)) != 0 ? TL_WIRE_FLAG_SATURATED_SPEED : 0U;
        flags |= (now & TL_COMPENSATOR_TAKE_UP) != 0 ? TL_WIRE_FLAG_TAKE_UP : 0U;
    }
    flags |= axis->mode != TL_WIRE_MODE_OFF ? TL_WIRE_FLAG_ENABLED : 0U;
    flags |= axis->reference.velocity == 0 ? TL_WIRE_FLAG_AT_REST : 0U;
    flags |= axis->fault != TL_WIRE_FAULT_NONE ? TL_WIRE_FLAG_FAULT : 0U;
    flags |= axis->silent ? TL_WIRE_FLAG_SILENT : 0U;
    return (uint16_t)flags;
}

// First-order mean over 20 ms. A fault, or none.
static tl_wire_fault_t watch_current(tl_axis_t *axis) {
    axis->current_ma = tl_clamp(axis->port->current_ma(axis->port->context, axis->index), -100000, 100000);
    const int32_t magnitude = axis->current_ma < 0 ? -axis->current_ma : axis->current_ma;
    const int32_t difference = tl_clamp(magnitude * 256 - axis->current_mean_q8, -(1 << 20), 1 << 20);
    axis->current_mean_q8 += (difference * (32768 / 20)) >> 15;
    return axis->limits.current_ma > 0 && axis->current_mean_q8 > axis->limits.current_ma * 256 ? TL_WIRE_FAULT_CURRENT
                                                                                                : TL_WIRE_FAULT_NONE;
}

static void watch_motor_and_sender(tl_axis_t *axis, tl_us_t now_us) {
    const tl_count_q8_t error = axis->path.q - axis->q;
    tl_wire_fault_t fault = watch_current(axis);
    if (error > axis->limits.following_error_q8 || error < -axis->limits.following_error_q8) {
        fault = fault == TL_WIRE_FAULT_NONE ? TL_WIRE_FAULT_FOLLOWING : fault;
    }
    if (fault != TL_WIRE_FAULT_NONE && axis->mode != TL_WIRE_MODE_OFF) {
        tl_axis_fail(axis, fault, now_us);
    }
    axis->c_ref = (axis->c_last[0] >> 1) + (axis->c_last[1] >> 1);
    axis->c_last[1] = axis->c_last[0];
    axis->c_last[0] = axis->c_next;
    if (tl_axis_is_following(axis) && --axis->patience == 0U) {
        tl_axis_silence(axis);
    }
}

static void sample(tl_axis_t *axis, tl_us_t now_us) {
    uint32_t flags = 0;
    if (axis->servo.saturated) {
        axis->servo.saturated = false;
        flags |= TL_WIRE_FLAG_SATURATED_DUTY;
    }
    if (axis->mode != TL_WIRE_MODE_OFF) {
        flags |= axis->reference.clamped ? TL_WIRE_FLAG_SATURATED_RANGE : 0U;
        flags |= axis->reference.behind && axis->mode != TL_WIRE_MODE_MOVE ? TL_WIRE_FLAG_SATURATED_SPEED : 0U;
    }
    axis->noted = (uint16_t)flags;
    if (axis->divider == 0 || ++axis->skipped < axis->divider) {
        return;
    }
    axis->skipped = 0;
    if (axis->sample_head - axis->sample_tail == TL_AXIS_SAMPLES) {
        axis->samples_dropped++;
        return;
    }
    tl_sample_t *into = &axis->samples[axis->sample_head % TL_AXIS_SAMPLES];
    into->t_us = (uint32_t)now_us;
    into->q = axis->q;
    into->q_ref = axis->path.q;
    into->p = axis->has_table ? axis->play.p : axis->q;
    into->c_ref = axis->c_ref;
    into->c_est = axis->has_table ? tl_play_angle(&axis->play) : 0;
    into->duty = (int16_t)tl_clamp(axis->duty, INT16_MIN, INT16_MAX);
    into->flags = tl_axis_flags(axis);
    axis->sample_head = axis->sample_head + 1U;
}

// The play operator's result does not depend on how often it is stepped, but for a reversal's tip: 0.03 counts at
// 200 000 counts/s2. So is the error of the history, which joins its points by straight lines.
void tl_axis_watch(tl_axis_t *axis, tl_us_t now_us) {
    axis->q = tl_clamp(axis->q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX); // a step adds 2000 counts at most
    if (axis->history != NULL) {
        tl_history_push(axis->history, now_us, axis->q);
    }
    if (axis->has_table) {
        tl_play_step(&axis->play, axis->q);
    }
    axis->stream.now_us = now_us + axis->lead_us;
    watch_motor_and_sender(axis, now_us);
    sample(axis, now_us);
}
