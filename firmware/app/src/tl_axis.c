#include "tautline/tl_axis.h"

#include <string.h>

#define AT_ONCE_US   50000U // longest time that a set-point without one takes
#define ENCODER_JUMP 2000   // counts in one step: above any motor's speed, below a glitch's

static const tl_servo_gains_t default_gains = {
    .proportional = 900, .integral = 12000, .derivative = 600, .feed_forward = 1640, .inertia = 4900, .friction = 1300};

static void event(tl_axis_t *axis, tl_wire_event_code_t code) {
    axis->events = (uint8_t)(axis->events | (1U << code));
}

static void drive(tl_axis_t *axis, tl_duty_q15_t duty) {
    axis->duty = duty;
    axis->port->drive(axis->port->context, axis->index, duty);
}

static bool is_following(const tl_axis_t *axis) {
    return axis->mode == TL_WIRE_MODE_FOLLOW_MOTOR || axis->mode == TL_WIRE_MODE_FOLLOW_TIP;
}

// -- settings ---------------------------------------------------------------------------------------------------

// An axis that stands outside its limits may stay there or come back, not go farther out.
static void admit(tl_axis_t *axis) {
    const tl_count_q8_t here = tl_reference_q(&axis->reference);
    axis->lowest = here < axis->low ? here : axis->low;
    axis->highest = here > axis->high ? here : axis->high;
}

static void apply_limits(tl_axis_t *axis) {
    int32_t speed = axis->limits.speed_q8_s;
    axis->low = axis->limits.q_low_q8;
    axis->high = axis->limits.q_high_q8;
    if (axis->has_table) {
        tl_table_t *table = &axis->lookup.table;
        // A take-up that brakes harder than the reference may would overshoot. The last quarter is left to the feed.
        const int32_t acceleration = axis->limits.acceleration_q8_s2 / TL_COUNT_ONE / 4 * 3;
        table->takeup_accel = axis->takeup_accel < acceleration ? axis->takeup_accel : acceleration;
        speed = table->speed_max_q8 < speed ? table->speed_max_q8 : speed;
        axis->low = table->q_min > axis->low ? table->q_min : axis->low;
        axis->high = table->q_max < axis->high ? table->q_max : axis->high;
        if (axis->low > axis->high) { // the two do not meet: the host's limits hold
            axis->low = axis->limits.q_low_q8;
            axis->high = axis->limits.q_high_q8;
        }
    }
    axis->travel = tl_reference_limits(speed, axis->limits.acceleration_q8_s2, axis->port->control_hz);
    admit(axis);
}

uint8_t tl_axis_set_limits(tl_axis_t *axis, const tl_wire_limits_t *limits) {
    if (limits->q_low_q8 >= limits->q_high_q8 || limits->q_low_q8 < -TL_AXIS_RANGE_MAX ||
        limits->q_high_q8 > TL_AXIS_RANGE_MAX || limits->speed_q8_s < 1 ||
        limits->speed_q8_s > TL_REFERENCE_SPEED_MAX || limits->acceleration_q8_s2 < TL_REFERENCE_ACCELERATION_MIN ||
        limits->acceleration_q8_s2 > TL_REFERENCE_ACCELERATION_MAX || limits->duty_q15 < 0 ||
        limits->duty_q15 > TL_RATIO_ONE || limits->current_ma < 0 || limits->current_ma > 100000 ||
        limits->following_error_q8 < TL_COUNT_ONE || limits->following_error_q8 > TL_AXIS_RANGE_MAX) {
        return TL_WIRE_REASON_RANGE;
    }
    if (axis->mode != TL_WIRE_MODE_OFF && axis->mode != TL_WIRE_MODE_HOLD) {
        return TL_WIRE_REASON_BUSY;
    }
    axis->limits = *limits;
    apply_limits(axis);
    return 0;
}

uint8_t tl_axis_set_servo(tl_axis_t *axis, const tl_servo_gains_t *gains) {
    if (axis->mode != TL_WIRE_MODE_OFF) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    return tl_servo_configure(&axis->servo, gains, axis->port->control_hz) ? 0 : TL_WIRE_REASON_RANGE;
}

uint8_t tl_axis_set_position(tl_axis_t *axis, tl_count_q8_t q) {
    if (axis->mode != TL_WIRE_MODE_OFF) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    if (q < -TL_AXIS_RANGE_MAX || q > TL_AXIS_RANGE_MAX) {
        return TL_WIRE_REASON_RANGE;
    }
    axis->q = q / TL_COUNT_ONE * TL_COUNT_ONE;
    tl_servo_reset(&axis->servo, axis->q);
    tl_reference_set(&axis->reference, axis->q);
    if (axis->has_table) {
        tl_play_start(&axis->play, &axis->lookup, axis->q);
    }
    return 0;
}

void tl_axis_set_strength(tl_axis_t *axis, int32_t strength_q15) {
    axis->strength_q15 = tl_clamp(strength_q15, 0, TL_RATIO_ONE);
    if (axis->mode == TL_WIRE_MODE_FOLLOW_TIP) {
        tl_compensator_set_strength(&axis->compensator, axis->strength_q15);
    }
}

void tl_axis_use_table(tl_axis_t *axis, bool has_table) {
    axis->has_table = has_table;
    if (has_table) {
        axis->strength_q15 = axis->lookup.table.strength_q15;
        axis->takeup_accel = axis->lookup.table.takeup_accel;
        tl_play_start(&axis->play, &axis->lookup, axis->q);
    }
    apply_limits(axis);
}

void tl_axis_init(tl_axis_t *axis, const tl_port_t *port, uint8_t index) {
    memset(axis, 0, sizeof(*axis));
    axis->port = port;
    axis->index = index;
    axis->encoder = port->encoder(port->context, index);
    axis->rate_hz = port->control_hz;
    const uint8_t slots = (uint8_t)(port->control_hz / 1000U);
    axis->play_slot = (uint8_t)(slots - 1U); // just before a sample is taken
    axis->history_slot = slots > 2U ? 2U : 0U;
    axis->current_slot = slots > 1U ? 1U : 0U;
    axis->limits = (tl_wire_limits_t){
        .axis = index,
        .q_low_q8 = -TL_AXIS_RANGE_MAX,
        .q_high_q8 = TL_AXIS_RANGE_MAX,
        .speed_q8_s = 16000 * TL_COUNT_ONE,
        .acceleration_q8_s2 = 200000 * TL_COUNT_ONE,
        .duty_q15 = TL_RATIO_ONE,
        .current_ma = 1000,
        .following_error_q8 = 300 * TL_COUNT_ONE,
    };
    axis->strength_q15 = TL_RATIO_ONE;
    apply_limits(axis);
    tl_servo_configure(&axis->servo, &default_gains, port->control_hz);
    drive(axis, 0);
}

// -- what a host asks for ---------------------------------------------------------------------------------------

void tl_axis_fail(tl_axis_t *axis, tl_wire_fault_t fault, tl_us_t now_us) {
    drive(axis, 0);
    axis->mode = TL_WIRE_MODE_OFF;
    axis->queue_used = 0;
    axis->motion = NULL;
    if (axis->fault == TL_WIRE_FAULT_NONE) {
        axis->fault = (uint8_t)fault;
        axis->fault_us = now_us;
        event(axis, TL_WIRE_EVENT_FAULT);
    }
}

void tl_axis_stop(tl_axis_t *axis, bool then_off) {
    if (axis->mode == TL_WIRE_MODE_OFF || (axis->mode == TL_WIRE_MODE_HOLD && !then_off)) {
        return;
    }
    axis->queue_used = 0;
    axis->motion = NULL;
    axis->mode = then_off ? TL_WIRE_MODE_STOPPING_OFF : TL_WIRE_MODE_STOPPING;
}

void tl_axis_silence(tl_axis_t *axis) {
    if (is_following(axis)) {
        tl_axis_stop(axis, false);
        axis->silent = true;
        event(axis, TL_WIRE_EVENT_SILENT);
    }
}

static uint8_t ready(const tl_axis_t *axis) {
    if (axis->fault != TL_WIRE_FAULT_NONE) {
        return TL_WIRE_REASON_FAULT;
    }
    return axis->mode == TL_WIRE_MODE_OFF ? TL_WIRE_REASON_OFF : 0;
}

uint8_t tl_axis_enable(tl_axis_t *axis) {
    if (axis->fault != TL_WIRE_FAULT_NONE) {
        return TL_WIRE_REASON_FAULT;
    }
    if (axis->mode == TL_WIRE_MODE_OFF) {
        tl_reference_set(&axis->reference, axis->q);
        tl_servo_reset(&axis->servo, axis->q);
        admit(axis);
        axis->current_mean_q8 = 0;
        axis->silent = false;
        axis->mode = TL_WIRE_MODE_HOLD;
    } else if (axis->mode == TL_WIRE_MODE_STOPPING_OFF) {
        axis->mode = TL_WIRE_MODE_STOPPING;
    }
    return 0;
}

uint8_t tl_axis_move(tl_axis_t *axis, tl_count_q8_t target, int32_t speed_q8_s) {
    const uint8_t reason = ready(axis);
    if (reason != 0) {
        return reason;
    }
    if (axis->mode == TL_WIRE_MODE_CALIBRATE) {
        return TL_WIRE_REASON_BUSY;
    }
    if (target < axis->low || target > axis->high || speed_q8_s < 0) {
        return TL_WIRE_REASON_RANGE;
    }
    axis->move = axis->travel;
    if (speed_q8_s > 0) {
        const tl_reference_limits_t asked =
            tl_reference_limits(speed_q8_s, axis->limits.acceleration_q8_s2, axis->port->control_hz);
        axis->move.speed = asked.speed < axis->travel.speed ? asked.speed : axis->travel.speed;
    }
    axis->queue_used = 0;
    axis->move_target = target;
    axis->mode = TL_WIRE_MODE_MOVE;
    return 0;
}

// Ticks until the sender is silent: silence_us after the time of its last set-point.
static uint32_t patience(const tl_axis_t *axis, tl_us_t now_us) {
    return ((uint32_t)(axis->queue_end_us - now_us) + axis->silence_us) / (1000000U / axis->port->control_hz) + 1U;
}

uint8_t tl_axis_follow(tl_axis_t *axis, bool tip, uint8_t compensation, uint32_t silence_us, tl_us_t now_us) {
    const uint8_t reason = ready(axis);
    if (reason != 0) {
        return reason;
    }
    if (axis->mode != TL_WIRE_MODE_HOLD) {
        return TL_WIRE_REASON_BUSY;
    }
    if (compensation > (uint8_t)TL_MODE_FULL || silence_us > TL_AXIS_SILENCE_MAX_US) {
        return TL_WIRE_REASON_RANGE;
    }
    if (tip && !axis->has_table) {
        return TL_WIRE_REASON_NO_TABLE;
    }
    const tl_count_q8_t q = tl_reference_q(&axis->reference);
    int32_t value = q;
    if (tip) {
        value = axis->c_ref = tl_play_angle(&axis->play);
        tl_compensator_start(&axis->compensator, &axis->lookup, axis->port->control_hz, (tl_mode_t)compensation, q,
                             axis->c_ref);
        tl_compensator_set_strength(&axis->compensator, axis->strength_q15);
    }
    axis->queue_used = 0;
    axis->queue_end = value;
    axis->queue_end_us = now_us;
    axis->value = (int64_t)value * (1 << 24);
    axis->silence_us = silence_us > 0 ? silence_us : TL_AXIS_SILENCE_US;
    axis->patience = patience(axis, now_us);
    axis->heard_us = now_us;
    axis->silent = false;
    axis->mode = tip ? TL_WIRE_MODE_FOLLOW_TIP : TL_WIRE_MODE_FOLLOW_MOTOR;
    return 0;
}

uint8_t tl_axis_set_point(tl_axis_t *axis, int32_t value, tl_us_t at_us, tl_us_t now_us, bool *late) {
    if (!is_following(axis)) {
        const uint8_t reason = ready(axis);
        return reason != 0 ? reason : TL_WIRE_REASON_NOT_FOLLOWING;
    }
    if (at_us > now_us + TL_AXIS_AHEAD_US) {
        return TL_WIRE_REASON_RANGE;
    }
    if (axis->queue_used == TL_AXIS_QUEUE) {
        return TL_WIRE_REASON_QUEUE_FULL;
    }
    const uint32_t period_us = 1000000U / axis->port->control_hz;
    const tl_us_t start_us = axis->queue_end_us > now_us ? axis->queue_end_us : now_us;
    *late = at_us != 0 && at_us <= start_us;
    // Without a time: reached in the time that has passed since the one before, so that a steady sender's points make a
    // line and no steps.
    const tl_us_t since_us = now_us - axis->heard_us;
    const tl_us_t end_us = at_us != 0 ? at_us : start_us + (since_us < AT_ONCE_US ? since_us : AT_ONCE_US);
    axis->heard_us = now_us;
    const uint32_t ticks = end_us > start_us + period_us ? (uint32_t)(end_us - start_us) / period_us : 1U;
    axis->queue[(axis->queue_first + axis->queue_used) % TL_AXIS_QUEUE] = (tl_segment_t){
        .ticks = ticks,
        .end = value,
        .slope = ((int64_t)value - axis->queue_end) * (1 << 24) / (int64_t)ticks,
    };
    if (axis->queue_used++ == 0) {
        axis->segment_ticks = ticks;
    }
    axis->queue_end = value;
    axis->queue_end_us = start_us + (tl_us_t)ticks * period_us;
    axis->patience = patience(axis, now_us);
    return 0;
}

uint8_t tl_axis_calibrate(tl_axis_t *axis, tl_motion_t *motion, tl_history_t *history) {
    const uint8_t reason = ready(axis);
    if (reason != 0) {
        return reason;
    }
    if (axis->mode != TL_WIRE_MODE_HOLD) {
        return TL_WIRE_REASON_BUSY;
    }
    axis->motion = motion;
    axis->history = history;
    axis->mode = TL_WIRE_MODE_CALIBRATE;
    return 0;
}

// -- the control step -------------------------------------------------------------------------------------------

static void measure(tl_axis_t *axis, tl_us_t now_us) {
    const int32_t encoder = axis->port->encoder(axis->port->context, axis->index);
    int32_t moved = (int32_t)((uint32_t)encoder - (uint32_t)axis->encoder);
    axis->encoder = encoder;
    if (moved > ENCODER_JUMP || moved < -ENCODER_JUMP) {
        tl_axis_fail(axis, TL_WIRE_FAULT_ENCODER, now_us);
        moved = 0;
    }
    axis->q = tl_clamp(axis->q + moved * TL_COUNT_ONE, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
}

static int32_t next_value(tl_axis_t *axis) {
    if (axis->queue_used > 0) {
        const tl_segment_t *segment = &axis->queue[axis->queue_first];
        axis->value += segment->slope;
        if (--axis->segment_ticks == 0) {
            axis->value = (int64_t)segment->end * (1 << 24);
            axis->queue_first = (uint8_t)((axis->queue_first + 1U) % TL_AXIS_QUEUE);
            axis->queue_used--;
            axis->segment_ticks = axis->queue_used > 0 ? axis->queue[axis->queue_first].ticks : 0;
        }
    }
    return (int32_t)(axis->value >> 24);
}

// The target of a mode that has one; *limits are the axis' own unless the mode has others.
static tl_count_q8_t target_of(tl_axis_t *axis, const tl_reference_limits_t **limits) {
    switch (axis->mode) {
    case TL_WIRE_MODE_FOLLOW_MOTOR:
        return next_value(axis);
    case TL_WIRE_MODE_FOLLOW_TIP:
        axis->c_ref = next_value(axis);
        return tl_compensator_step(&axis->compensator, axis->c_ref);
    case TL_WIRE_MODE_CALIBRATE:
        return tl_motion_tick(axis->motion).q;
    case TL_WIRE_MODE_MOVE:
        *limits = &axis->move;
        return axis->move_target;
    default:
        return tl_reference_q(&axis->reference);
    }
}

static void refer(tl_axis_t *axis) {
    const tl_reference_limits_t *limits = &axis->travel;
    if (is_following(axis) && --axis->patience == 0U) {
        tl_axis_silence(axis);
    }
    if (axis->mode == TL_WIRE_MODE_STOPPING || axis->mode == TL_WIRE_MODE_STOPPING_OFF) {
        if (tl_reference_brake(&axis->reference, limits)) {
            tl_reference_set(&axis->reference, tl_reference_q(&axis->reference));
            axis->mode = axis->mode == TL_WIRE_MODE_STOPPING ? TL_WIRE_MODE_HOLD : TL_WIRE_MODE_OFF;
            event(axis, TL_WIRE_EVENT_RESTED);
        }
        return;
    }
    tl_count_q8_t target = target_of(axis, &limits);
    if (target < axis->lowest || target > axis->highest) {
        axis->noted |= TL_WIRE_FLAG_SATURATED_RANGE;
        target = tl_clamp(target, axis->lowest, axis->highest);
    }
    tl_reference_step(&axis->reference, target, axis->lowest, axis->highest, limits);
    if (axis->mode == TL_WIRE_MODE_MOVE) {
        if (tl_reference_rests_at(&axis->reference, target)) {
            axis->mode = TL_WIRE_MODE_HOLD;
            event(axis, TL_WIRE_EVENT_ARRIVED);
        }
    } else if (axis->reference.behind) {
        axis->noted |= TL_WIRE_FLAG_SATURATED_SPEED;
    }
}

// First-order mean over 20 ms, at 1 kHz.
static void watch_current(tl_axis_t *axis, tl_us_t now_us) {
    axis->current_ma = tl_clamp(axis->port->current_ma(axis->port->context, axis->index), -100000, 100000);
    const int32_t magnitude = axis->current_ma < 0 ? -axis->current_ma : axis->current_ma;
    const int32_t difference = tl_clamp(magnitude * 256 - axis->current_mean_q8, -(1 << 20), 1 << 20);
    axis->current_mean_q8 += (difference * (32768 / 20)) >> 15;
    if (axis->mode != TL_WIRE_MODE_OFF && axis->limits.current_ma > 0 &&
        axis->current_mean_q8 > axis->limits.current_ma * 256) {
        tl_axis_fail(axis, TL_WIRE_FAULT_CURRENT, now_us);
    }
}

uint16_t tl_axis_flags(const tl_axis_t *axis) {
    uint32_t flags = axis->noted_before;
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

static void sample(tl_axis_t *axis, tl_us_t now_us) {
    axis->noted_before = axis->noted;
    axis->noted = 0;
    if (axis->divider == 0 || ++axis->skipped < axis->divider) {
        return;
    }
    axis->skipped = 0;
    if (axis->sample_head - axis->sample_tail == TL_AXIS_SAMPLES) {
        axis->samples_dropped++;
        return;
    }
    tl_sample_t *into = &axis->samples[axis->sample_head % TL_AXIS_SAMPLES];
    into->t_us = now_us;
    into->q = axis->q;
    into->q_ref = tl_reference_q(&axis->reference);
    into->p = axis->has_table ? axis->play.p : axis->q;
    into->c_ref = axis->c_ref;
    into->c_est = axis->has_table ? tl_play_angle(&axis->play) : 0;
    into->duty = (int16_t)tl_clamp(axis->duty, INT16_MIN, INT16_MAX);
    into->flags = tl_axis_flags(axis);
    axis->sample_head = axis->sample_head + 1U;
}

// What is done once a millisecond, each in a tick of its own where there are enough of them. The play operator's result
// does not depend on how often it is stepped, but for a reversal's tip: 0.03 counts at 200 000 counts/s2. So is the
// error of the history, which joins its points by straight lines.
static void by_the_millisecond(tl_axis_t *axis, tl_us_t now_us) {
    axis->phase += 1000U;
    axis->slot++;
    if (axis->phase >= axis->rate_hz) {
        axis->phase -= axis->rate_hz;
        axis->slot = 0;
    }
    const uint32_t slot = axis->slot;
    if (slot == axis->play_slot && axis->has_table) {
        tl_play_step(&axis->play, axis->q);
    }
    if (slot == axis->history_slot && axis->history != NULL) {
        tl_history_push(axis->history, now_us, axis->q);
    }
    if (slot == axis->current_slot) {
        watch_current(axis, now_us);
    }
    if (slot == 0U) {
        sample(axis, now_us);
    }
}

void tl_axis_step(tl_axis_t *axis, tl_us_t now_us) {
    measure(axis, now_us);
    if (axis->mode == TL_WIRE_MODE_OFF) {
        tl_reference_set(&axis->reference, axis->q);
        tl_servo_watch(&axis->servo, axis->q);
        drive(axis, 0);
    } else {
        refer(axis);
        const tl_count_q8_t reference = tl_reference_q(&axis->reference);
        const int32_t speed = tl_reference_speed(&axis->reference, axis->rate_hz);
        const tl_duty_q15_t duty = tl_servo_step(&axis->servo, axis->q, reference, speed, axis->limits.duty_q15);
        const tl_count_q8_t error = reference - axis->q;
        if (error > axis->limits.following_error_q8 || error < -axis->limits.following_error_q8) {
            tl_axis_fail(axis, TL_WIRE_FAULT_FOLLOWING, now_us);
        } else {
            drive(axis, axis->mode == TL_WIRE_MODE_OFF ? 0 : duty);
            axis->noted |= axis->servo.saturated ? TL_WIRE_FLAG_SATURATED_DUTY : 0U;
        }
    }
    by_the_millisecond(axis, now_us);
}
