#include "tautline/tl_axis.h"

#include <string.h>

#define AT_ONCE_US 50000U // longest time that a set-point without one takes
#define PLAN_US    (1000000U / TL_AXIS_PLAN_HZ)

static const tl_servo_gains_t default_gains = {
    .proportional = 900, .integral = 12000, .derivative = 600, .feed_forward = 1640, .inertia = 4900, .friction = 1300};

// -- settings ---------------------------------------------------------------------------------------------------

// An axis that stands outside its limits may stay there or come back, not go farther out.
static void admit(tl_axis_t *axis) {
    const tl_count_q8_t here = tl_reference_q(&axis->reference);
    axis->reference.low = here < axis->low ? here : axis->low;
    axis->reference.high = here > axis->high ? here : axis->high;
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
    axis->travel = tl_reference_limits(speed, axis->limits.acceleration_q8_s2, TL_AXIS_PLAN_HZ);
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
    tl_axis_rest(axis);
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
    axis->ticks = port->control_hz / TL_AXIS_PLAN_HZ;
    // Axes plan in different ticks, and are watched in different ones.
    axis->slot = (axis->ticks - index % axis->ticks) % axis->ticks;
    // A point that is planned in this millisecond is the middle of the curve's second next, and ticks are the middles
    // of theirs.
    const uint32_t period_us = 1000000U / port->control_hz;
    axis->lead_us = 3U * PLAN_US / 2U + period_us / 2U;
    axis->stream.now_us = port->time_us(port->context) + axis->lead_us + index % axis->ticks * period_us;
    tl_path_init(&axis->path, 0, axis->ticks);
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
    tl_axis_drive(axis, 0);
}

// -- what a host asks for ---------------------------------------------------------------------------------------

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
        tl_axis_rest(axis);
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
            tl_reference_limits(speed_q8_s, axis->limits.acceleration_q8_s2, TL_AXIS_PLAN_HZ);
        axis->move.speed = asked.speed < axis->travel.speed ? asked.speed : axis->travel.speed;
    }
    axis->stream.used = 0;
    axis->move_target = target;
    axis->mode = TL_WIRE_MODE_MOVE;
    return 0;
}

// Milliseconds until the sender is silent: silence_us after the time of its last set-point.
static uint32_t patience(const tl_axis_t *axis, tl_us_t now_us) {
    return ((uint32_t)(tl_stream_end(&axis->stream) - now_us) + axis->silence_us) / PLAN_US + 1U;
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
        value = tl_play_angle(&axis->play);
        axis->c_ref = axis->c_next = axis->c_last[0] = axis->c_last[1] = value;
        tl_compensator_start(&axis->compensator, &axis->lookup, TL_AXIS_PLAN_HZ, (tl_mode_t)compensation, q, value);
        tl_compensator_know(&axis->compensator, &axis->play);
        tl_compensator_set_strength(&axis->compensator, axis->strength_q15);
    }
    axis->target = q;
    tl_stream_start(&axis->stream, value, axis->ticks);
    axis->silence_us = silence_us > 0 ? silence_us : TL_AXIS_SILENCE_US;
    axis->patience = patience(axis, now_us);
    axis->heard_us = now_us;
    axis->silent = false;
    axis->mode = tip ? TL_WIRE_MODE_FOLLOW_TIP : TL_WIRE_MODE_FOLLOW_MOTOR;
    return 0;
}

uint8_t tl_axis_set_point(tl_axis_t *axis, int32_t value, tl_us_t at_us, tl_us_t now_us, bool *late) {
    if (!tl_axis_is_following(axis)) {
        const uint8_t reason = ready(axis);
        return reason != 0 ? reason : TL_WIRE_REASON_NOT_FOLLOWING;
    }
    if (at_us > now_us + TL_AXIS_AHEAD_US) {
        return TL_WIRE_REASON_RANGE;
    }
    // Without a time: reached in the time that has passed since the one before, so that a steady sender's points make a
    // line and no steps.
    const tl_us_t start_us = tl_stream_end(&axis->stream), since_us = now_us - axis->heard_us;
    const tl_us_t end_us = at_us != 0 ? at_us : start_us + (since_us < AT_ONCE_US ? since_us : AT_ONCE_US);
    if (!tl_stream_add(&axis->stream, value, end_us)) {
        return TL_WIRE_REASON_QUEUE_FULL;
    }
    *late = at_us != 0 && at_us <= start_us;
    axis->heard_us = now_us;
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
    axis->target = tl_reference_q(&axis->reference);
    axis->motion = motion;
    axis->history = history;
    axis->mode = TL_WIRE_MODE_CALIBRATE;
    return 0;
}
