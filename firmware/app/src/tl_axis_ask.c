#include "tautline/tl_axis_ask.h"

#include <string.h>

#include "tautline/tl_axis_guard.h"
#include "tautline/tl_axis_rest.h"
#include "tautline/tl_axis_watch.h"
#include "tautline/tl_fast.h"
#include "tautline/tl_stop.h"

#define AT_ONCE_US 50000U // longest time that a set-point without one takes
#define PLAN_US    (1000000U / TL_AXIS_PLAN_HZ)

#define COPY(kind, name, doc)              to->name = from->name;
#define COPY_ARRAY(kind, name, count, doc) memcpy(to->name, from->name, sizeof(to->name));

static TL_FAST uint32_t keep_out(const tl_axis_t *axis) {
    return axis->port->lock(axis->port->context);
}

static TL_FAST void let_in(const tl_axis_t *axis, uint32_t state) {
    axis->port->unlock(axis->port->context, state);
}

// -- settings, limits, gains ------------------------------------------------------------------------------------

tl_wire_settings_t tl_axis_default_settings(const tl_port_t *port, uint8_t index) {
    return (tl_wire_settings_t){
        .axis = index,
        .q_low_q8 = -TL_AXIS_RANGE_MAX,
        .q_high_q8 = TL_AXIS_RANGE_MAX,
        .speed_q8_s = 16000 * TL_COUNT_ONE,
        .acceleration_q8_s2 = 200000 * TL_COUNT_ONE,
        .duty_q15 = TL_RATIO_ONE,
        .current_ma = port->driver_ma - port->driver_ma / 16, // a chopped current never shows more than the driver's
        .following_error_q8 = 300 * TL_COUNT_ONE,
        .proportional = 900,
        .integral = 12000,
        .derivative = 600,
        .feed_forward = 1640,
        .inertia = 4900,
        .friction_q15 = 1300,
        .low_duty_q15 = TL_RATIO_ONE / 4,
        .arrive_q8 = 4 * TL_COUNT_ONE,
        .stall_ms = 300,
        .supply_low_mv = port->supply_low_mv,
        .hold_ms = 60000,
    };
}

static void values_of(const tl_wire_settings_t *from, tl_wire_limits_t *to) {
    *to = (tl_wire_limits_t){.axis = from->axis};
    TL_WIRE_VALUES_LIMITS(COPY, COPY_ARRAY)
}

// What settings allow. Of a motor that nobody has commissioned, nor its range: low duty, and half that share of speed
// and acceleration, which then leave drive for friction.
static void limits_of(const tl_wire_settings_t *from, tl_wire_limits_t *to) {
    values_of(from, to);
    if (from->commissioned == 0U) {
        const int64_t share = from->low_duty_q15 / 2;
        const int32_t speed = (int32_t)(to->speed_q8_s * share / TL_RATIO_ONE),
                      acceleration = (int32_t)(to->acceleration_q8_s2 * share / TL_RATIO_ONE);
        to->duty_q15 = from->low_duty_q15;
        to->speed_q8_s = speed > 1 ? speed : 1;
        to->acceleration_q8_s2 =
            acceleration > TL_REFERENCE_ACCELERATION_MIN ? acceleration : TL_REFERENCE_ACCELERATION_MIN;
    }
}

static bool is_sound(const tl_port_t *port, const tl_wire_limits_t *limits) {
    const int32_t most_ma = port->driver_ma > 0 ? port->driver_ma : 100000;
    return limits->q_low_q8 < limits->q_high_q8 && limits->q_low_q8 >= -TL_AXIS_RANGE_MAX &&
           limits->q_high_q8 <= TL_AXIS_RANGE_MAX && limits->speed_q8_s >= 1 &&
           limits->speed_q8_s <= TL_REFERENCE_SPEED_MAX &&
           limits->acceleration_q8_s2 >= TL_REFERENCE_ACCELERATION_MIN &&
           limits->acceleration_q8_s2 <= TL_REFERENCE_ACCELERATION_MAX && limits->duty_q15 >= 0 &&
           limits->duty_q15 <= TL_RATIO_ONE && limits->current_ma >= 0 && limits->current_ma <= most_ma &&
           limits->following_error_q8 >= TL_COUNT_ONE && limits->following_error_q8 <= TL_AXIS_RANGE_MAX;
}

static bool are_within(const tl_wire_limits_t *limits, const tl_wire_settings_t *settings) {
    tl_wire_limits_t most;
    limits_of(settings, &most);
    const bool current = most.current_ma == 0 || (limits->current_ma > 0 && limits->current_ma <= most.current_ma);
    return limits->q_low_q8 >= most.q_low_q8 && limits->q_high_q8 <= most.q_high_q8 &&
           limits->speed_q8_s <= most.speed_q8_s && limits->acceleration_q8_s2 <= most.acceleration_q8_s2 &&
           limits->duty_q15 <= most.duty_q15 && current && limits->following_error_q8 <= most.following_error_q8;
}

static bool set_gains(tl_axis_t *axis, const tl_wire_servo_t *from) {
    const tl_servo_gains_t gains = {
        .proportional = from->proportional,
        .integral = from->integral,
        .derivative = from->derivative,
        .feed_forward = from->feed_forward,
        .inertia = from->inertia,
        .friction = from->friction_q15,
    };
    if (!tl_servo_configure(&axis->motor.servo, &gains, axis->port->control_hz)) {
        return false;
    }
    tl_actuator_know(&axis->motor);
    axis->checked = false; // its scale is checked against them
    return true;
}

uint8_t tl_axis_check_settings(const tl_port_t *port, const tl_wire_settings_t *settings) {
    tl_wire_limits_t limits;
    values_of(settings, &limits);
    const int32_t gains[] = {settings->proportional, settings->integral, settings->derivative,
                             settings->feed_forward, settings->inertia,  settings->friction_q15};
    for (unsigned i = 0; i < sizeof(gains) / sizeof(gains[0]); i++) {
        if (gains[i] < 0 || gains[i] > TL_WIRE_GAIN_MAX) {
            return TL_WIRE_REASON_RANGE;
        }
    }
    const bool sound =
        is_sound(port, &limits) && settings->low_duty_q15 >= 0 && settings->low_duty_q15 <= settings->duty_q15 &&
        settings->arrive_q8 >= TL_COUNT_ONE && settings->arrive_q8 <= TL_AXIS_RANGE_MAX && settings->stall_ms >= 20U &&
        settings->stall_ms <= 5000U && settings->hold_ms <= TL_AXIS_HOLD_MAX_MS &&
        settings->group <= TL_WIRE_AXES_MAX && tl_wire_is_estop(settings->estop) && settings->commissioned <= 1U &&
        (settings->estop == TL_WIRE_ESTOP_CLOSED || port->estop_closed != NULL);
    return sound ? 0 : TL_WIRE_REASON_RANGE;
}

// What the reference may, under these limits and the table's.
static tl_reference_limits_t travel_by(const tl_axis_t *axis, const tl_wire_limits_t *limits) {
    int32_t speed = limits->speed_q8_s;
    if (axis->has_table) {
        const int32_t most = axis->tip.lookup.table.speed_max_q8;
        speed = most < speed ? most : speed;
    }
    return tl_reference_limits(speed, limits->acceleration_q8_s2, TL_AXIS_PLAN_HZ);
}

static TL_FAST void put_into_force(tl_axis_t *axis, const tl_reference_limits_t *travel) {
    if (axis->has_table) {
        // A take-up that brakes harder than the reference may would overshoot. The last quarter is left to the feed.
        const int32_t acceleration = axis->limits.acceleration_q8_s2 / TL_COUNT_ONE / 4 * 3,
                      own = axis->tip.takeup_accel;
        axis->tip.lookup.table.takeup_accel = own < acceleration ? own : acceleration;
    }
    axis->plan.travel = *travel;
    tl_axis_admit(axis);
}

static void apply_limits(tl_axis_t *axis) {
    const tl_reference_limits_t travel = travel_by(axis, &axis->limits);
    put_into_force(axis, &travel);
}

void tl_axis_use_settings(tl_axis_t *axis, const tl_wire_settings_t *settings) {
    axis->settings = *settings;
    limits_of(settings, &axis->limits);
    const tl_wire_settings_t *from = settings;
    tl_wire_servo_t gains, *to = &gains;
    TL_WIRE_VALUES_SERVO(COPY, COPY_ARRAY)
    set_gains(axis, &gains);
    apply_limits(axis);
}

static TL_FAST_LOCKED uint8_t take_limits(tl_axis_t *axis, const tl_wire_limits_t *limits,
                                          const tl_reference_limits_t *travel) {
    const uint32_t state = keep_out(axis);
    const bool rests = axis->mode == TL_WIRE_MODE_OFF || axis->mode == TL_WIRE_MODE_HOLD;
    if (rests) {
        axis->limits = *limits;
        axis->motor.limit = limits->duty_q15 < axis->motor.limit ? limits->duty_q15 : axis->motor.limit;
        put_into_force(axis, travel);
    }
    let_in(axis, state);
    return rests ? 0 : TL_WIRE_REASON_BUSY;
}

uint8_t tl_axis_set_limits(tl_axis_t *axis, const tl_wire_limits_t *limits) {
    if (!is_sound(axis->port, limits)) {
        return TL_WIRE_REASON_RANGE;
    }
    if (!are_within(limits, &axis->settings)) {
        return TL_WIRE_REASON_BEYOND_SETTINGS;
    }
    const tl_reference_limits_t travel = travel_by(axis, limits);
    return take_limits(axis, limits, &travel);
}

// Without the lock: of a motor that is off the control step uses nothing that the gains change.
uint8_t tl_axis_set_servo(tl_axis_t *axis, const tl_wire_servo_t *gains) {
    if (axis->mode != TL_WIRE_MODE_OFF) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    return set_gains(axis, gains) ? 0 : TL_WIRE_REASON_RANGE;
}

TL_FAST uint8_t tl_axis_set_strength(tl_axis_t *axis, int32_t strength_q15) {
    if (strength_q15 < 0 || strength_q15 > TL_RATIO_ONE) {
        return TL_WIRE_REASON_RANGE;
    }
    axis->tip.strength_q15 = strength_q15;
    if (axis->mode == TL_WIRE_MODE_FOLLOW_TIP) {
        tl_compensator_set_strength(&axis->tip.compensator, strength_q15);
    }
    return 0;
}

// A table that nobody follows is moved at once: nothing comes of it yet.
static TL_FAST uint32_t ticks_of(const tl_axis_t *axis, uint16_t within_ms) {
    return axis->mode == TL_WIRE_MODE_FOLLOW_TIP ? (uint32_t)within_ms * (TL_AXIS_PLAN_HZ / 1000U) : 0U;
}

TL_FAST uint8_t tl_axis_adapt(tl_axis_t *axis, const tl_wire_adapt_t *request) {
    if (!axis->has_table) {
        return TL_WIRE_REASON_NO_TABLE;
    }
    const uint32_t ticks = ticks_of(axis, request->within_ms);
    tl_compensator_t *compensator = &axis->tip.compensator;
    compensator->lookup = &axis->tip.lookup;
    return tl_compensator_adapt(compensator, request->offset_q8, request->scale_q15, ticks)
               ? 0
               : TL_WIRE_REASON_BEYOND_TABLE;
}

TL_FAST uint8_t tl_axis_load(tl_axis_t *axis, const tl_wire_load_t *request) {
    if (!axis->has_table) {
        return TL_WIRE_REASON_NO_TABLE;
    }
    axis->tip.compensator.lookup = &axis->tip.lookup;
    tl_compensator_load(&axis->tip.compensator, request->load_q8, ticks_of(axis, request->within_ms));
    return 0;
}

// -- where it is ------------------------------------------------------------------------------------------------

// Where the motor that is at q pushes from, as far as other axes move it.
static tl_count_q8_t pushing(const tl_axis_t *axis, tl_count_q8_t q) {
    return tl_add_sat(q, axis->tip.compensator.undo.before);
}

static TL_FAST_LOCKED void take_position(tl_axis_t *axis, tl_count_q8_t q, const tl_play_t *play) {
    const uint32_t state = keep_out(axis);
    axis->q = q;
    axis->referenced = true;
    tl_actuator_reset(&axis->motor, q);
    tl_axis_settle(axis);
    tl_axis_admit(axis);
    if (play != NULL) {
        axis->tip.play = *play;
    }
    let_in(axis, state);
}

uint8_t tl_axis_set_position(tl_axis_t *axis, tl_count_q8_t q) {
    if (axis->mode != TL_WIRE_MODE_OFF) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    if (q < -TL_AXIS_RANGE_MAX || q > TL_AXIS_RANGE_MAX) {
        return TL_WIRE_REASON_RANGE;
    }
    q = q / TL_COUNT_ONE * TL_COUNT_ONE;
    tl_play_t play;
    if (axis->has_table) {
        tl_play_start(&play, &axis->tip.lookup, pushing(axis, q));
    }
    take_position(axis, q, axis->has_table ? &play : NULL);
    return 0;
}

static TL_FAST_LOCKED void take_play(tl_axis_t *axis, const tl_play_t *play) {
    const uint32_t state = keep_out(axis);
    axis->tip.play = *play;
    let_in(axis, state);
}

// The motor has pressed against an end: the tip is on that side's envelope, and has followed the retreat since.
static void find_tip(tl_axis_t *axis) {
    axis->guard.homed = false;
    if (axis->has_table) {
        const tl_count_q8_t end = pushing(axis, axis->trial.end);
        tl_play_t play;
        tl_play_start(&play, &axis->tip.lookup, end);
        tl_play_step(&play, end - axis->trial.way * TL_AXIS_RANGE_MAX);
        tl_play_step(&play, end);
        tl_play_step(&play, pushing(axis, axis->q));
        take_play(axis, &play); // what the motor goes from here the watch has it follow
    }
}

void tl_axis_hear(tl_axis_t *axis) {
    if (axis->guard.homed) {
        find_tip(axis);
    }
    axis->guard.alone_ms = 0;
    if (!tl_axis_is_following(axis)) { // a follower's sender sends set-points
        axis->guard.patience = axis->guard.silence_ms;
    }
}

void tl_axis_use_table(tl_axis_t *axis, bool has_table) {
    axis->has_table = has_table;
    axis->tip.compensator.undo = (tl_undo_t){.active = false};
    if (has_table) {
        axis->tip.strength_q15 = axis->tip.lookup.table.strength_q15;
        axis->tip.takeup_accel = axis->tip.lookup.table.takeup_accel;
        if ((axis->tip.lookup.table.has & (uint32_t)TL_TABLE_HAS_before) != 0) { // else it waits for a follower
            tl_axis_join(axis);
            tl_undo_start(&axis->tip.compensator.undo, &axis->tip.lookup, TL_AXIS_PLAN_HZ);
        }
        tl_play_start(&axis->tip.play, &axis->tip.lookup, pushing(axis, axis->q));
    }
    apply_limits(axis);
}

void tl_axis_init(tl_axis_t *axis, const tl_port_t *port, uint8_t index) {
    memset(axis, 0, sizeof(*axis));
    axis->port = port;
    axis->index = index;
    tl_actuator_init(&axis->motor, port, index);
    axis->ticks = port->control_hz / TL_AXIS_PLAN_HZ;
    // Axes plan in different ticks, and are watched in different ones.
    axis->slot = (axis->ticks - index % axis->ticks) % axis->ticks;
    // A point that is planned in this millisecond is the middle of the curve's second next, and ticks are the middles
    // of theirs.
    const uint32_t period_us = 1000000U / port->control_hz;
    axis->plan.lead_us = 3U * PLAN_US / 2U + period_us / 2U;
    axis->plan.stream.now_us = port->time_us(port->context) + axis->plan.lead_us + index % axis->ticks * period_us;
    tl_path_init(&axis->path, 0, axis->ticks);
    axis->tip.strength_q15 = TL_RATIO_ONE;
    axis->guard.off_ms = UINT8_MAX;
    const tl_wire_settings_t settings = tl_axis_default_settings(port, index);
    tl_axis_use_settings(axis, &settings);
}

// -- motions ----------------------------------------------------------------------------------------------------

static TL_FAST uint8_t ready(const tl_axis_t *axis) {
    if (axis->fault != TL_WIRE_FAULT_NONE) {
        return TL_WIRE_REASON_FAULT;
    }
    return axis->mode == TL_WIRE_MODE_OFF ? TL_WIRE_REASON_OFF : 0;
}

static TL_FAST uint8_t ready_at_rest(const tl_axis_t *axis) {
    const uint8_t reason = ready(axis);
    return reason == 0 && axis->mode != TL_WIRE_MODE_HOLD ? TL_WIRE_REASON_BUSY : reason;
}

static TL_FAST uint8_t ready_and_referenced(const tl_axis_t *axis) {
    const uint8_t reason = ready_at_rest(axis);
    return reason == 0 && !axis->referenced ? TL_WIRE_REASON_NOT_REFERENCED : reason;
}

static TL_FAST int32_t low_duty(const tl_axis_t *axis) {
    const int32_t low = axis->settings.low_duty_q15, most = axis->limits.duty_q15;
    return low < most ? low : most;
}

static TL_FAST bool may_be_silent(tl_axis_t *axis, uint32_t silence_us) {
    if (silence_us > TL_AXIS_SILENCE_MAX_US) {
        return false;
    }
    axis->guard.silence_ms = (silence_us > 0 ? silence_us : TL_AXIS_MOVE_SILENCE_US) / PLAN_US + 1U;
    axis->guard.patience = axis->guard.silence_ms;
    return true;
}

// A motion begins: nothing of the last one counts any more.
static TL_FAST void begin(tl_axis_t *axis, tl_duty_q15_t most) {
    axis->motor.limit = most;
    axis->silent = false;
    axis->plan.stream.used = 0;
    axis->guard.lapsed = false;
    axis->guard.homing = false;
    axis->guard.sink = 0;
    axis->guard.still_ms = 0; // but how long it has been pushing does: asking again is no way round a stall
}

static TL_FAST void switch_on(tl_axis_t *axis) {
    tl_axis_settle(axis);
    tl_actuator_reset(&axis->motor, axis->q);
    tl_axis_admit(axis);
    axis->guard.current_mean_q8 = 0;
    axis->guard.swing = 0;
    axis->guard.pushed_ms = 0;
    axis->guard.seen_q = axis->q;
    axis->guard.seen_duty = 0;
    axis->guard.unseen_ms = 0;
    axis->guard.blind = false;
    axis->guard.pushed = axis->guard.swing_way = 0;
    begin(axis, axis->referenced ? axis->limits.duty_q15 : low_duty(axis));
}

TL_FAST uint8_t tl_axis_enable(tl_axis_t *axis) {
    if (axis->fault != TL_WIRE_FAULT_NONE) {
        return TL_WIRE_REASON_FAULT;
    }
    if (tl_stop_group_has_fault(axis)) {
        return TL_WIRE_REASON_GROUP;
    }
    if (axis->mode == TL_WIRE_MODE_OFF) {
        switch_on(axis);
        if (axis->checked) {
            tl_axis_enter(axis, TL_WIRE_MODE_HOLD);
        } else {
            tl_axis_start_check(axis); // which ends by itself
        }
    } else if (axis->mode == TL_WIRE_MODE_STOPPING_OFF) {
        axis->guard.lapsed = false;
        tl_axis_enter(axis, TL_WIRE_MODE_STOPPING);
    }
    return 0;
}

TL_FAST uint8_t tl_axis_check(tl_axis_t *axis) {
    if (axis->mode != TL_WIRE_MODE_OFF) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    axis->checked = false;
    return tl_axis_enable(axis);
}

// The speed of a move: as asked, 0 is the one that is the default.
static TL_FAST void set_speed(tl_axis_t *axis, int32_t speed_q8_s, int32_t by_default, int32_t most) {
    const int32_t speed = speed_q8_s > 0 ? tl_reference_speed(speed_q8_s, TL_AXIS_PLAN_HZ) : by_default;
    axis->plan.move = axis->plan.travel;
    axis->plan.move.speed = speed < most ? speed : most;
}

TL_FAST uint8_t tl_axis_move(tl_axis_t *axis, const tl_wire_move_t *request) {
    const uint8_t reason = ready(axis);
    if (reason != 0) {
        return reason;
    }
    if (axis->mode == TL_WIRE_MODE_CALIBRATE || axis->mode == TL_WIRE_MODE_CHECK || axis->mode == TL_WIRE_MODE_HOME ||
        (axis->mode == TL_WIRE_MODE_MOVE && axis->guard.homing)) {
        return TL_WIRE_REASON_BUSY;
    }
    if (!axis->referenced) {
        return TL_WIRE_REASON_NOT_REFERENCED;
    }
    if (request->q_q8 < axis->plan.low || request->q_q8 > axis->plan.high || request->speed_q8_s < 0 ||
        !may_be_silent(axis, request->silence_us)) {
        return TL_WIRE_REASON_RANGE;
    }
    begin(axis, axis->limits.duty_q15);
    const int32_t most = axis->plan.travel.speed;
    set_speed(axis, request->speed_q8_s, most, most);
    axis->plan.move_target = request->q_q8;
    tl_axis_enter(axis, TL_WIRE_MODE_MOVE);
    return 0;
}

TL_FAST uint8_t tl_axis_jog(tl_axis_t *axis, const tl_wire_jog_t *request) {
    const uint8_t reason = ready_at_rest(axis);
    if (reason != 0) {
        return reason;
    }
    const int64_t target = (int64_t)tl_reference_q(&axis->plan.reference) + request->way_q8;
    if (target < axis->plan.low || target > axis->plan.high || request->speed_q8_s < 0 ||
        !may_be_silent(axis, request->silence_us)) {
        return TL_WIRE_REASON_RANGE;
    }
    begin(axis, low_duty(axis));
    set_speed(axis, request->speed_q8_s, axis->plan.travel.speed / 10, axis->plan.travel.speed / 2);
    axis->plan.move_target = (tl_count_q8_t)target;
    tl_axis_enter(axis, TL_WIRE_MODE_MOVE);
    return 0;
}

TL_FAST uint8_t tl_axis_home(tl_axis_t *axis, const tl_wire_home_t *request) {
    const uint8_t reason = ready_at_rest(axis);
    if (reason != 0) {
        return reason;
    }
    const tl_wire_limits_t *limits = &axis->limits;
    const int64_t back = (int64_t)request->end_q8 - (int64_t)request->direction * request->retreat_q8;
    const bool sound = (request->direction == 1 || request->direction == -1) && request->duty_q15 >= 0 &&
                       request->duty_q15 <= low_duty(axis) && request->speed_q8_s >= 0 && request->reach_q8 > 0 &&
                       request->reach_q8 <= TL_AXIS_RANGE_MAX && request->retreat_q8 >= 0 &&
                       request->end_q8 >= -TL_AXIS_RANGE_MAX && request->end_q8 <= TL_AXIS_RANGE_MAX &&
                       back >= limits->q_low_q8 && back <= limits->q_high_q8;
    if (!sound || !may_be_silent(axis, request->silence_us)) {
        return TL_WIRE_REASON_RANGE;
    }
    axis->referenced = false;
    tl_axis_admit(axis);
    begin(axis, request->duty_q15 > 0 ? request->duty_q15 : low_duty(axis));
    set_speed(axis, request->speed_q8_s, axis->plan.travel.speed / 10, axis->plan.travel.speed / 2);
    axis->plan.move_target = tl_reference_q(&axis->plan.reference);
    axis->guard.pushed_ms = 0; // pushing here is no end
    axis->trial = (tl_axis_trial_t){.way = request->direction,
                                    .from = axis->q,
                                    .reach = request->reach_q8,
                                    .end = request->end_q8 / TL_COUNT_ONE * TL_COUNT_ONE,
                                    .retreat = request->retreat_q8};
    tl_axis_enter(axis, TL_WIRE_MODE_HOME);
    return 0;
}

// Milliseconds until the sender is silent: silence after the time of its last set-point, or after now where control
// steps came so late that this has passed.
static TL_FAST uint32_t patience(const tl_axis_t *axis, tl_us_t now_us) {
    const tl_us_t end_us = tl_stream_end(&axis->plan.stream);
    return (end_us > now_us ? (uint32_t)(end_us - now_us) / PLAN_US : 0U) + axis->guard.silence_ms;
}

// Where a follower of the tip begins: the forward play, and how the table was moved.
typedef struct {
    tl_play_t play;
    tl_moved_t moved;
    tl_count_q8_t q;
} tip_now_t;

static TL_FAST_LOCKED void look_at_tip(const tl_axis_t *axis, tip_now_t *now) {
    const uint32_t state = keep_out(axis);
    now->play = axis->tip.play;
    now->moved = axis->tip.compensator.undo.moved;
    now->q = tl_reference_q(&axis->plan.reference);
    let_in(axis, state);
}

// `compensator`: what leads the tip from where its angle is `value`; NULL: a follower of the motor begins.
static TL_FAST_LOCKED uint8_t begin_to_follow(tl_axis_t *axis, const tl_compensator_t *compensator, int32_t value,
                                              uint32_t silence_ms, tl_us_t now_us) {
    const uint32_t state = keep_out(axis);
    const uint8_t reason = ready_and_referenced(axis);
    if (reason == 0) {
        tl_axis_planned_t *plan = &axis->plan;
        const tl_count_q8_t q = tl_reference_q(&plan->reference); // it rests: as it was when the compensator began
        begin(axis, axis->limits.duty_q15);
        plan->target = q;
        if (compensator != NULL) {
            axis->tip.compensator = *compensator;
            axis->tip.c_ref = plan->c_next = plan->c_last[0] = plan->c_last[1] = value;
        } else {
            value = q;
        }
        tl_stream_start(&plan->stream, value, axis->ticks);
        axis->guard.silence_ms = silence_ms;
        axis->guard.patience = patience(axis, now_us);
        plan->heard_us = now_us;
        tl_axis_enter(axis, compensator != NULL ? TL_WIRE_MODE_FOLLOW_TIP : TL_WIRE_MODE_FOLLOW_MOTOR);
    }
    let_in(axis, state);
    return reason;
}

uint8_t tl_axis_follow(tl_axis_t *axis, const tl_wire_follow_t *request, tl_us_t now_us) {
    const uint8_t reason = ready_and_referenced(axis);
    if (reason != 0) {
        return reason;
    }
    if (request->target > 1U || request->compensation > (uint8_t)TL_MODE_FULL ||
        request->silence_us > TL_AXIS_SILENCE_MAX_US) {
        return TL_WIRE_REASON_RANGE;
    }
    const uint32_t silence_us = request->silence_us > 0 ? request->silence_us : TL_AXIS_FOLLOW_SILENCE_US;
    const uint32_t silence_ms = silence_us / PLAN_US + 1U;
    if (request->target == 0U) {
        return begin_to_follow(axis, NULL, 0, silence_ms, now_us);
    }
    if (!axis->has_table) {
        return TL_WIRE_REASON_NO_TABLE;
    }
    tip_now_t now;
    tl_compensator_t compensator;
    look_at_tip(axis, &now);
    const tl_deg_q16_t value = tl_play_angle(&now.play);
    tl_compensator_start_moved(&compensator, &axis->tip.lookup, TL_AXIS_PLAN_HZ, (tl_mode_t)request->compensation,
                               now.q, value, &now.moved);
    tl_compensator_know(&compensator, &now.play);
    tl_compensator_set_strength(&compensator, axis->tip.strength_q15);
    return begin_to_follow(axis, &compensator, value, silence_ms, now_us);
}

TL_FAST uint8_t tl_axis_set_point(tl_axis_t *axis, const tl_wire_set_point_t *request, tl_us_t now_us, bool *late) {
    if (!tl_axis_is_following(axis)) {
        const uint8_t reason = ready(axis);
        return reason != 0 ? reason : TL_WIRE_REASON_NOT_FOLLOWING;
    }
    const tl_us_t at_us = request->at_us;
    if (at_us > now_us + TL_AXIS_AHEAD_US) {
        return TL_WIRE_REASON_RANGE;
    }
    tl_axis_planned_t *plan = &axis->plan;
    // Without a time: reached in the time that has passed since the one before, so that a steady sender's points make a
    // line and no steps.
    const tl_us_t start_us = tl_stream_end(&plan->stream), since_us = now_us - plan->heard_us;
    const tl_us_t end_us = at_us != 0 ? at_us : start_us + (since_us < AT_ONCE_US ? since_us : AT_ONCE_US);
    if (!tl_stream_add(&plan->stream, request->value, end_us)) {
        return TL_WIRE_REASON_QUEUE_FULL;
    }
    *late = at_us != 0 && at_us <= start_us;
    plan->heard_us = now_us;
    axis->guard.patience = patience(axis, now_us);
    return 0;
}

TL_FAST_LOCKED uint8_t tl_axis_calibrate(tl_axis_t *axis, tl_motion_t *motion, tl_history_t *history) {
    const uint32_t state = keep_out(axis);
    const uint8_t reason = ready_and_referenced(axis);
    if (reason == 0) {
        begin(axis, axis->limits.duty_q15);
        axis->plan.target = tl_reference_q(&axis->plan.reference);
        axis->plan.motion = motion;
        axis->history = history;
        tl_axis_enter(axis, TL_WIRE_MODE_CALIBRATE);
    }
    let_in(axis, state);
    return reason;
}

TL_FAST uint8_t tl_axis_clear_fault(tl_axis_t *axis, tl_us_t now_us) {
    if (tl_stop_is_pressed(axis)) { // whatever its fault is: it would be driven until the input is looked at again
        return TL_WIRE_REASON_ESTOP;
    }
    tl_stop_group(axis, now_us); // also for one that came and is cleared within a millisecond
    axis->fault = TL_WIRE_FAULT_NONE;
    axis->guard.fault_us = 0;
    axis->guard.fault_value = 0;
    return 0;
}
