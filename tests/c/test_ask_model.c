// What may be asked of an axis, by mode, fault, reference and table: the reason that is expected of each request, and
// what an axis is afterwards (tl_axis_ask.h, docs/protocol.md). The lock is held where it has to be, and let go.
#include "draws.h"
#include "silent_port.h"
#include "table_fixture.h"
#include "tautline/tl_axis_ask.h"
#include "tautline/tl_axis_rest.h"

#include <stdlib.h>
#include <unity.h>

#define TRIALS 3000

static tl_axis_t axis, was;
static tl_reference_t reference_was;
static uint32_t depth, taken;
static uint32_t reasons[40];

void setUp(void) {
    seed = 141421U;
    memset(reasons, 0, sizeof reasons);
}
void tearDown(void) {}

static tl_us_t the_time(void *context) {
    (void)context;
    return 7000000;
}
static int32_t encoder_by_axis(void *context, uint8_t index) {
    (void)context;
    return 1000 * (index + 1);
}
static uint32_t lock(void *context) {
    (void)context;
    taken++;
    return depth++ + 77U;
}
static void unlock(void *context, uint32_t state) {
    (void)context;
    depth--;
    TEST_ASSERT_EQUAL_UINT32(depth + 77U, state);
}

static tl_port_t port = {.control_hz = 5000,
                         .axes = 4,
                         .driver_ma = 1200,
                         .supply_low_mv = 4000,
                         .time_us = the_time,
                         .encoder = encoder_by_axis,
                         .drive = no_drive,
                         .lock = lock,
                         .unlock = unlock};

// -- the beginning ----------------------------------------------------------------------------------------------------

static void test_an_axis_begins_as_its_header_says(void) {
    for (uint8_t index = 0; index < 4U; index++) {
        memset(&axis, 0x5A, sizeof axis);
        tl_axis_init(&axis, &port, index);
        TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, axis.mode);
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, axis.fault);
        TEST_ASSERT_EQUAL(0, axis.q);
        TEST_ASSERT_EQUAL(0, axis.events);
        TEST_ASSERT_FALSE(axis.referenced || axis.checked || axis.has_table || axis.closed || axis.silent);
        TEST_ASSERT_EQUAL(index, axis.index);
        TEST_ASSERT_EQUAL(5, axis.ticks);
        TEST_ASSERT_EQUAL(1000 * (index + 1), axis.motor.encoder);
        TEST_ASSERT_EQUAL(0, axis.motor.duty);
        TEST_ASSERT_EQUAL((5 - index) % 5, axis.slot); // apart by a tick, none in another's
        TEST_ASSERT_EQUAL(255, axis.guard.off_ms);     // it has run down
        TEST_ASSERT_EQUAL(32768, axis.tip.strength_q15);
        TEST_ASSERT_EQUAL(1600, axis.plan.lead_us); // a millisecond and a half, and half of a tick
        TEST_ASSERT_TRUE(axis.plan.stream.now_us == 7000000U + 1600U + 200U * index);
        TEST_ASSERT_EQUAL(0, axis.plan.stream.used);
        TEST_ASSERT_NULL(axis.history);
        TEST_ASSERT_NULL(axis.plan.motion);
        const tl_wire_settings_t *own = &axis.settings;
        TEST_ASSERT_EQUAL(index, own->axis);
        TEST_ASSERT_EQUAL(-4000000 * 256, own->q_low_q8);
        TEST_ASSERT_EQUAL(4000000 * 256, own->q_high_q8);
        TEST_ASSERT_EQUAL(16000 * 256, own->speed_q8_s);
        TEST_ASSERT_EQUAL(200000 * 256, own->acceleration_q8_s2);
        TEST_ASSERT_EQUAL(32768, own->duty_q15);
        TEST_ASSERT_EQUAL(1125, own->current_ma); // 15/16 of the driver's
        TEST_ASSERT_EQUAL(300 * 256, own->following_error_q8);
        const int32_t gains[] = {900, 12000, 600, 1640, 4900, 1300}; // "gains that hold a small gearmotor"
        TEST_ASSERT_EQUAL(gains[0], own->proportional);
        TEST_ASSERT_EQUAL(gains[1], own->integral);
        TEST_ASSERT_EQUAL(gains[2], own->derivative);
        TEST_ASSERT_EQUAL(gains[3], own->feed_forward);
        TEST_ASSERT_EQUAL(gains[4], own->inertia);
        TEST_ASSERT_EQUAL(gains[5], own->friction_q15);
        TEST_ASSERT_EQUAL_MEMORY(gains, &axis.motor.servo.gains, sizeof gains);
        TEST_ASSERT_EQUAL(8192, own->low_duty_q15);
        TEST_ASSERT_EQUAL(4 * 256, own->arrive_q8);
        TEST_ASSERT_EQUAL(300, own->stall_ms);
        TEST_ASSERT_EQUAL(4000, own->supply_low_mv);
        TEST_ASSERT_EQUAL(60000, own->hold_ms);
        TEST_ASSERT_EQUAL(0, own->commissioned);
        TEST_ASSERT_EQUAL(0, own->group);
        // Of a motor that nobody has commissioned: low duty, an eighth of speed and acceleration.
        TEST_ASSERT_EQUAL(8192, axis.limits.duty_q15);
        TEST_ASSERT_EQUAL(2000 * 256, axis.limits.speed_q8_s);
        TEST_ASSERT_EQUAL(25000 * 256, axis.limits.acceleration_q8_s2);
        TEST_ASSERT_EQUAL(own->q_low_q8, axis.limits.q_low_q8);
        TEST_ASSERT_EQUAL(own->current_ma, axis.limits.current_ma);
        TEST_ASSERT_EQUAL(own->following_error_q8, axis.limits.following_error_q8);
    }
}

static void test_settings_are_limits_and_less_until_commissioned(void) {
    tl_axis_init(&axis, &port, 1);
    for (uint32_t i = 0; i < 2000U; i++) {
        tl_wire_settings_t own = tl_axis_default_settings(&port, 1);
        own.commissioned = once_in(2) ? 1 : 0;
        own.speed_q8_s = once_in(4) ? between(1, 9) : between(1, TL_REFERENCE_SPEED_MAX);
        own.acceleration_q8_s2 = between(TL_REFERENCE_ACCELERATION_MIN, TL_REFERENCE_ACCELERATION_MAX);
        own.low_duty_q15 = between(0, 32768);
        own.duty_q15 = between(own.low_duty_q15, 32768);
        tl_axis_use_settings(&axis, &own);
        const bool free = own.commissioned != 0;
        const int64_t share = own.low_duty_q15 / 2;
        const int64_t speed = free ? own.speed_q8_s : own.speed_q8_s * share / 32768;
        const int64_t acceleration = free ? own.acceleration_q8_s2 : own.acceleration_q8_s2 * share / 32768;
        TEST_ASSERT_EQUAL_INT64(speed < 1 ? 1 : speed, axis.limits.speed_q8_s);
        TEST_ASSERT_EQUAL_INT64(acceleration < 256000 ? 256000 : acceleration, axis.limits.acceleration_q8_s2);
        TEST_ASSERT_EQUAL(free ? own.duty_q15 : own.low_duty_q15, axis.limits.duty_q15);
        const tl_reference_limits_t travel =
            tl_reference_limits(axis.limits.speed_q8_s, axis.limits.acceleration_q8_s2, 1000);
        TEST_ASSERT_EQUAL_MEMORY(&travel, &axis.plan.travel, sizeof travel);
        TEST_ASSERT_FALSE(axis.checked);
    }
}

// -- an axis in any state ---------------------------------------------------------------------------------------------

static const uint8_t modes[] = {TL_WIRE_MODE_OFF,        TL_WIRE_MODE_HOLD,         TL_WIRE_MODE_MOVE,
                                TL_WIRE_MODE_HOME,       TL_WIRE_MODE_CHECK,        TL_WIRE_MODE_FOLLOW_MOTOR,
                                TL_WIRE_MODE_FOLLOW_TIP, TL_WIRE_MODE_CALIBRATE,    TL_WIRE_MODE_STOPPING,
                                TL_WIRE_MODE_HOLD,       TL_WIRE_MODE_STOPPING_OFF, TL_WIRE_MODE_HOLD};

static void any_state(void) {
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    static tl_lookup_t loaded;
    static size_t size;
    if (size == 0) {
        tl_table_t table = table_fixture(1);
        table.speed_max_q8 = 9000 * TL_COUNT_ONE;
        table.takeup_accel = 100000;
        table.strength_q15 = 20000;
        size = tl_table_encode(&table, blob, sizeof blob);
        TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_lookup_load(&loaded, blob, size, TL_TABLE_ANY_AXIS));
    }
    tl_axis_init(&axis, &port, 0);
    tl_wire_settings_t own = tl_axis_default_settings(&port, 0);
    own.commissioned = once_in(5) ? 0 : 1;
    own.q_low_q8 = -between(300, 6000) * TL_COUNT_ONE;
    own.q_high_q8 = between(300, 6000) * TL_COUNT_ONE;
    own.low_duty_q15 = between(0, 9000);
    own.duty_q15 = between(own.low_duty_q15, 32768);
    own.acceleration_q8_s2 = between(20000, 400000) * TL_COUNT_ONE;
    tl_axis_use_settings(&axis, &own);
    axis.tip.lookup = loaded;
    if (once_in(2)) {
        tl_axis_use_table(&axis, true);
        TEST_ASSERT_EQUAL(20000, axis.tip.strength_q15);
        TEST_ASSERT_EQUAL(100000, axis.tip.takeup_accel);
        const int64_t most = axis.limits.acceleration_q8_s2 / 256 / 4 * 3; // a quarter is the feed's
        TEST_ASSERT_EQUAL_INT64(most < 100000 ? most : 100000, axis.tip.lookup.table.takeup_accel);
        const int32_t speed = axis.limits.speed_q8_s < 9000 * 256 ? axis.limits.speed_q8_s : 9000 * 256;
        TEST_ASSERT_EQUAL(tl_reference_speed(speed, 1000), axis.plan.travel.speed);
    }
    axis.q = between(-250, 250) * TL_COUNT_ONE;
    axis.referenced = once_in(3) ? false : true;
    axis.checked = once_in(2);
    tl_axis_settle(&axis);
    tl_axis_admit(&axis);
    tl_axis_enter(&axis, (tl_wire_mode_t)modes[between(0, (int32_t)sizeof modes - 1)]);
    axis.fault = once_in(5) ? TL_WIRE_FAULT_STALL : TL_WIRE_FAULT_NONE;
    axis.guard.fault_value = axis.fault != 0 ? 5 : 0;
    axis.guard.fault_us = axis.fault != 0 ? 9U : 0U;
    axis.guard.homing = axis.mode == TL_WIRE_MODE_MOVE && once_in(2);
    axis.guard.lapsed = axis.guard.blind = axis.silent = once_in(2);
    axis.guard.sink = between(0, 3);
    axis.guard.still_ms = (uint8_t)between(0, 9);
    axis.guard.pushed_ms = (uint16_t)between(0, 99);
    axis.guard.swing = (uint16_t)between(0, 99);
    axis.guard.swing_way = axis.guard.pushed = (uint8_t)between(0, 2);
    axis.guard.current_mean_q8 = between(0, 999);
    axis.guard.seen_duty = between(-99, 99);
    axis.guard.unseen_ms = (uint8_t)between(0, 9);
    axis.guard.alone_ms = (uint32_t)between(0, 9);
    axis.guard.silence_ms = (uint32_t)between(0, 99);
    axis.guard.patience = (uint32_t)between(0, 99);
    axis.plan.stream.used = (uint8_t)between(0, 1);
    axis.motor.limit = between(0, 999);
    axis.motor.servo.velocity = between(-999, 999);
    depth = taken = 0;
    was = axis;
    reference_was = axis.plan.reference;
}

static int ready(void) {
    return was.fault != TL_WIRE_FAULT_NONE ? TL_WIRE_REASON_FAULT
                                           : (was.mode == TL_WIRE_MODE_OFF ? TL_WIRE_REASON_OFF : 0);
}

static int ready_at_rest(void) {
    return ready() == 0 && was.mode != TL_WIRE_MODE_HOLD ? TL_WIRE_REASON_BUSY : ready();
}

static int ready_and_referenced(void) {
    return ready_at_rest() == 0 && !was.referenced ? TL_WIRE_REASON_NOT_REFERENCED : ready_at_rest();
}

static int32_t low_duty(void) {
    return was.settings.low_duty_q15 < was.limits.duty_q15 ? was.settings.low_duty_q15 : was.limits.duty_q15;
}

static void is_refused(int expected, int reason) {
    TEST_ASSERT_EQUAL(expected, reason);
    TEST_ASSERT_EQUAL(0, depth);
    reasons[reason]++;
}

// Nothing has changed but for what is told.
static void is_as_it_was(void) {
    TEST_ASSERT_EQUAL(was.mode, axis.mode);
    TEST_ASSERT_EQUAL(was.referenced, axis.referenced);
    TEST_ASSERT_EQUAL(was.plan.move_target, axis.plan.move_target);
    TEST_ASSERT_EQUAL(was.motor.limit, axis.motor.limit);
    TEST_ASSERT_EQUAL(was.guard.homing, axis.guard.homing);
    TEST_ASSERT_EQUAL(was.guard.lapsed, axis.guard.lapsed);
    TEST_ASSERT_EQUAL(was.plan.stream.used, axis.plan.stream.used);
}

static void has_begun(uint8_t mode, int32_t limit) {
    TEST_ASSERT_EQUAL(mode, axis.mode);
    TEST_ASSERT_EQUAL(mode != TL_WIRE_MODE_CHECK, axis.closed);
    TEST_ASSERT_EQUAL(limit, axis.motor.limit);
    TEST_ASSERT_FALSE(axis.silent || axis.guard.lapsed || axis.guard.homing);
    TEST_ASSERT_EQUAL(0, axis.guard.sink);
    TEST_ASSERT_EQUAL(0, axis.guard.still_ms);
    TEST_ASSERT_EQUAL(0, axis.trial.duty);
}

static void is_patient(uint32_t silence_us, uint32_t by_default_us) {
    const uint32_t ms = (silence_us > 0U ? silence_us : by_default_us) / 1000U + 1U;
    TEST_ASSERT_EQUAL_UINT32(ms, axis.guard.silence_ms);
    TEST_ASSERT_EQUAL_UINT32(ms, axis.guard.patience);
}

static uint32_t any_silence(void) {
    return once_in(4) ? 60000000U + (uint32_t)between(0, 1)
                      : (once_in(3) ? (uint32_t)between(0, 1) : (uint32_t)between(1, 9999999));
}

static int32_t speed_of(int32_t asked, int32_t by_default, int32_t most) {
    const int32_t speed = asked > 0 ? tl_reference_speed(asked, 1000) : by_default;
    return speed < most ? speed : most;
}

static void moves_at(int32_t speed) {
    tl_reference_limits_t expected = was.plan.travel;
    expected.speed = speed;
    TEST_ASSERT_EQUAL_MEMORY(&expected, &axis.plan.move, sizeof expected);
}

// -- requests ---------------------------------------------------------------------------------------------------------

static void test_enabling(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        const bool check = once_in(3);
        int expected = was.fault != TL_WIRE_FAULT_NONE ? TL_WIRE_REASON_FAULT : 0;
        expected = check && was.mode != TL_WIRE_MODE_OFF ? TL_WIRE_REASON_NOT_OFF : expected;
        const bool checked = was.checked && !check;
        is_refused(expected, check ? tl_axis_check(&axis) : tl_axis_enable(&axis));
        if (expected == 0 && was.mode == TL_WIRE_MODE_OFF) {
            has_begun(checked ? TL_WIRE_MODE_HOLD : TL_WIRE_MODE_CHECK,
                      was.referenced ? was.limits.duty_q15 : low_duty());
            TEST_ASSERT_EQUAL(0, axis.plan.stream.used);
            TEST_ASSERT_EQUAL(0, axis.guard.current_mean_q8);
            TEST_ASSERT_EQUAL(0, axis.guard.swing + axis.guard.swing_way + axis.guard.pushed + axis.guard.pushed_ms);
            TEST_ASSERT_EQUAL(0, axis.guard.seen_duty + axis.guard.unseen_ms + axis.motor.servo.velocity);
            TEST_ASSERT_EQUAL(axis.q, axis.guard.seen_q);
            TEST_ASSERT_FALSE(axis.guard.blind);
            TEST_ASSERT_EQUAL(axis.q, axis.path.q);
        } else if (expected == 0 && was.mode == TL_WIRE_MODE_STOPPING_OFF) {
            TEST_ASSERT_EQUAL(TL_WIRE_MODE_STOPPING, axis.mode);
            TEST_ASSERT_FALSE(axis.guard.lapsed);
        } else {
            is_as_it_was();
        }
    }
}

static void test_moving(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        const int32_t ends[] = {was.plan.low, was.plan.high};
        const tl_wire_move_t request = {.q_q8 =
                                            once_in(3) ? ends[between(0, 1)] + between(-1, 1) : between(-90000, 90000),
                                        .speed_q8_s = once_in(3) ? between(-1, 1) : between(1, 2000000),
                                        .silence_us = any_silence()};
        const bool busy = was.mode == TL_WIRE_MODE_CALIBRATE || was.mode == TL_WIRE_MODE_CHECK ||
                          was.mode == TL_WIRE_MODE_HOME || (was.mode == TL_WIRE_MODE_MOVE && was.guard.homing);
        const bool sound = request.q_q8 >= ends[0] && request.q_q8 <= ends[1] && request.speed_q8_s >= 0 &&
                           request.silence_us <= 60000000U;
        int expected = ready() != 0 ? ready() : (busy ? TL_WIRE_REASON_BUSY : 0);
        expected = expected == 0 && !was.referenced ? TL_WIRE_REASON_NOT_REFERENCED : expected;
        expected = expected == 0 && !sound ? TL_WIRE_REASON_RANGE : expected;
        is_refused(expected, tl_axis_move(&axis, &request));
        if (expected != 0) {
            is_as_it_was();
            continue;
        }
        has_begun(TL_WIRE_MODE_MOVE, was.limits.duty_q15);
        TEST_ASSERT_EQUAL(0, axis.plan.stream.used);
        TEST_ASSERT_EQUAL(was.guard.pushed_ms, axis.guard.pushed_ms); // asking again is no way round a stall
        is_patient(request.silence_us, 1000000U);
        moves_at(speed_of(request.speed_q8_s, was.plan.travel.speed, was.plan.travel.speed));
        TEST_ASSERT_EQUAL(request.q_q8, axis.plan.move_target);
    }
}

static void test_jogging(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        const int32_t room[] = {was.plan.low - axis.q, was.plan.high - axis.q};
        const tl_wire_jog_t request = {.way_q8 =
                                           once_in(3) ? room[between(0, 1)] + between(-1, 1) : between(-9000, 9000),
                                       .speed_q8_s = once_in(3) ? between(-1, 1) : between(1, 2000000),
                                       .silence_us = any_silence()};
        const bool sound = request.way_q8 >= room[0] && request.way_q8 <= room[1] && request.speed_q8_s >= 0 &&
                           request.silence_us <= 60000000U;
        const int expected = ready_at_rest() != 0 ? ready_at_rest() : (sound ? 0 : TL_WIRE_REASON_RANGE);
        is_refused(expected, tl_axis_jog(&axis, &request));
        if (expected != 0) {
            is_as_it_was();
            continue;
        }
        has_begun(TL_WIRE_MODE_MOVE, low_duty());
        is_patient(request.silence_us, 1000000U);
        moves_at(speed_of(request.speed_q8_s, was.plan.travel.speed / 10, was.plan.travel.speed / 2));
        TEST_ASSERT_EQUAL(axis.q + request.way_q8, axis.plan.move_target);
    }
}

static void test_homing(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        const tl_wire_home_t request = {.direction = (int8_t)(once_in(8) ? between(-2, 2) : (once_in(2) ? 1 : -1)),
                                        .duty_q15 = once_in(2) ? low_duty() + between(-1, 1) : between(0, 1),
                                        .speed_q8_s = once_in(3) ? between(-1, 1) : between(1, 2000000),
                                        .reach_q8 = between(1, 90000),
                                        .end_q8 = between(-76800, 76800),
                                        .retreat_q8 = between(0, 9000),
                                        .silence_us = any_silence()};
        const int64_t back = request.end_q8 - (int64_t)request.direction * request.retreat_q8;
        const bool sound = abs(request.direction) == 1 && request.duty_q15 >= 0 && request.duty_q15 <= low_duty() &&
                           request.speed_q8_s >= 0 && back >= was.limits.q_low_q8 && back <= was.limits.q_high_q8 &&
                           request.silence_us <= 60000000U;
        const int expected = ready_at_rest() != 0 ? ready_at_rest() : (sound ? 0 : TL_WIRE_REASON_RANGE);
        is_refused(expected, tl_axis_home(&axis, &request));
        if (expected != 0) {
            is_as_it_was();
            continue;
        }
        has_begun(TL_WIRE_MODE_HOME, request.duty_q15 > 0 ? request.duty_q15 : low_duty());
        is_patient(request.silence_us, 1000000U);
        moves_at(speed_of(request.speed_q8_s, was.plan.travel.speed / 10, was.plan.travel.speed / 2));
        TEST_ASSERT_FALSE(axis.referenced);
        TEST_ASSERT_EQUAL(-TL_AXIS_RANGE_MAX, axis.plan.low); // limits are of positions, which it does not know
        TEST_ASSERT_EQUAL(TL_AXIS_RANGE_MAX, axis.plan.high);
        TEST_ASSERT_EQUAL(axis.q, axis.plan.move_target);
        TEST_ASSERT_EQUAL(0, axis.guard.pushed_ms);
        TEST_ASSERT_EQUAL(request.direction, axis.trial.way);
        TEST_ASSERT_EQUAL(axis.q, axis.trial.from);
        TEST_ASSERT_EQUAL(request.reach_q8, axis.trial.reach);
        TEST_ASSERT_EQUAL(request.end_q8 / 256 * 256, axis.trial.end); // encoders count whole ones
        TEST_ASSERT_EQUAL(request.retreat_q8, axis.trial.retreat);
    }
}

static void test_following(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        const tl_wire_follow_t request = {.target = (uint8_t)(once_in(9) ? 2 : between(0, 1)),
                                          .compensation = (uint8_t)(once_in(9) ? 3 : between(0, 2)),
                                          .silence_us = any_silence()};
        const bool sound = request.target < 2U && request.compensation < 3U && request.silence_us <= 60000000U;
        int expected = ready_and_referenced() != 0 ? ready_and_referenced() : (sound ? 0 : TL_WIRE_REASON_RANGE);
        expected = expected == 0 && request.target == 1U && !was.has_table ? TL_WIRE_REASON_NO_TABLE : expected;
        const tl_us_t now_us = 7000000U;
        is_refused(expected, tl_axis_follow(&axis, &request, now_us));
        if (expected != 0) {
            is_as_it_was();
            continue;
        }
        TEST_ASSERT_TRUE(taken > 0U);
        has_begun(request.target == 1U ? TL_WIRE_MODE_FOLLOW_TIP : TL_WIRE_MODE_FOLLOW_MOTOR, was.limits.duty_q15);
        TEST_ASSERT_EQUAL_UINT32((request.silence_us > 0 ? request.silence_us : 100000U) / 1000U + 1U,
                                 axis.guard.silence_ms);
        TEST_ASSERT_TRUE(axis.guard.patience >= axis.guard.silence_ms);
        TEST_ASSERT_TRUE(axis.guard.patience <= axis.guard.silence_ms + 3U);
        TEST_ASSERT_EQUAL(axis.q, axis.plan.target);
        TEST_ASSERT_TRUE(axis.plan.heard_us == now_us);
        if (request.target == 1U) {
            const tl_deg_q16_t angle = tl_play_angle(&axis.tip.play);
            TEST_ASSERT_EQUAL(angle, axis.tip.c_ref);
            TEST_ASSERT_EQUAL(angle, axis.plan.c_next);
            TEST_ASSERT_EQUAL(angle, axis.plan.c_last[0]);
            TEST_ASSERT_EQUAL(angle, axis.plan.c_last[1]);
            TEST_ASSERT_EQUAL(request.compensation, axis.tip.compensator.mode);
        }
    }
}

static void test_calibrating(void) {
    static tl_motion_t motion;
    static tl_history_t history;
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        const int expected = ready_and_referenced();
        is_refused(expected, tl_axis_calibrate(&axis, &motion, &history));
        if (expected != 0) {
            is_as_it_was();
            continue;
        }
        TEST_ASSERT_EQUAL(1, taken);
        has_begun(TL_WIRE_MODE_CALIBRATE, was.limits.duty_q15);
        TEST_ASSERT_EQUAL_PTR(&motion, axis.plan.motion);
        TEST_ASSERT_EQUAL_PTR(&history, axis.history);
        TEST_ASSERT_EQUAL(axis.q, axis.plan.target);
    }
}

static void test_telling_where_it_is(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        const int32_t end = TL_AXIS_RANGE_MAX;
        const int32_t q = once_in(3) ? (once_in(2) ? end : -end) + between(-1, 1) : between(-90000, 90000);
        int expected = was.mode != TL_WIRE_MODE_OFF ? TL_WIRE_REASON_NOT_OFF : 0;
        expected = expected == 0 && (q > end || q < -end) ? TL_WIRE_REASON_RANGE : expected;
        is_refused(expected, tl_axis_set_position(&axis, q));
        if (expected != 0) {
            is_as_it_was();
            TEST_ASSERT_EQUAL(was.q, axis.q);
            continue;
        }
        const int32_t whole = q / 256 * 256;
        TEST_ASSERT_EQUAL(1, taken);
        TEST_ASSERT_EQUAL(whole, axis.q);
        TEST_ASSERT_TRUE(axis.referenced);
        TEST_ASSERT_EQUAL(whole, axis.plan.reference.q);
        TEST_ASSERT_EQUAL(whole, axis.path.q);
        TEST_ASSERT_EQUAL(0, axis.motor.servo.velocity);
        TEST_ASSERT_EQUAL(axis.has_table ? -5000 * 256 > axis.limits.q_low_q8 ? -5000 * 256 : axis.limits.q_low_q8
                                         : axis.limits.q_low_q8,
                          axis.plan.low);
        if (axis.has_table) {
            tl_play_t play;
            tl_play_start(&play, &axis.tip.lookup, whole);
            TEST_ASSERT_EQUAL(play.p, axis.tip.play.p);
        }
    }
}

static void test_gains_strength_and_clearing(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        const tl_wire_servo_t gains = {.proportional = once_in(4) ? between(-1, 0) : between(32766, 32768)};
        const bool sound = gains.proportional >= 0 && gains.proportional <= 32767;
        const int expected = was.mode != TL_WIRE_MODE_OFF ? TL_WIRE_REASON_NOT_OFF : (sound ? 0 : TL_WIRE_REASON_RANGE);
        is_refused(expected, tl_axis_set_servo(&axis, &gains));
        TEST_ASSERT_EQUAL(expected == 0 ? gains.proportional : was.motor.servo.gains.proportional,
                          axis.motor.servo.gains.proportional);
        TEST_ASSERT_EQUAL(expected == 0 ? false : was.checked, axis.checked);
        const int32_t strength = once_in(2) ? between(-1, 1) : between(32767, 32769);
        const bool possible = strength >= 0 && strength <= 32768;
        is_refused(possible ? 0 : TL_WIRE_REASON_RANGE, tl_axis_set_strength(&axis, strength));
        TEST_ASSERT_EQUAL(possible ? strength : was.tip.strength_q15, axis.tip.strength_q15);
        is_refused(0, tl_axis_clear_fault(&axis, 1));
        TEST_ASSERT_EQUAL(0, axis.fault + axis.guard.fault_value);
        TEST_ASSERT_TRUE(axis.guard.fault_us == 0U);
    }
}

static void test_limits(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        tl_wire_limits_t limits = was.limits;
        limits.duty_q15 -= between(0, limits.duty_q15 < 9 ? 0 : 9);
        limits.speed_q8_s -= between(0, limits.speed_q8_s / 2);
        const bool rests = was.mode == TL_WIRE_MODE_OFF || was.mode == TL_WIRE_MODE_HOLD;
        is_refused(rests ? 0 : TL_WIRE_REASON_BUSY, tl_axis_set_limits(&axis, &limits));
        TEST_ASSERT_EQUAL(1, taken);
        TEST_ASSERT_EQUAL_MEMORY(rests ? &limits : &was.limits, &axis.limits, sizeof limits);
        const int32_t limit = was.motor.limit;
        TEST_ASSERT_EQUAL(rests && limits.duty_q15 < limit ? limits.duty_q15 : limit, axis.motor.limit);
        const int32_t table = axis.tip.lookup.table.speed_max_q8;
        const int32_t speed = was.has_table && table < limits.speed_q8_s ? table : limits.speed_q8_s;
        TEST_ASSERT_EQUAL(rests ? tl_reference_speed(speed, 1000) : was.plan.travel.speed, axis.plan.travel.speed);
    }
}

// A sender that is heard of is no more silent; the tip is found once the axis is homed.
static void test_hearing(void) {
    for (uint32_t i = 0; i < TRIALS; i++) {
        any_state();
        axis.guard.homed = once_in(2);
        axis.trial.way = once_in(2) ? 1 : -1;
        axis.trial.end = axis.q + axis.trial.way * between(0, 900) * 256; // also so far that the tip follows
        const bool found = axis.guard.homed && axis.has_table;
        tl_axis_hear(&axis);
        TEST_ASSERT_EQUAL(0, depth);
        TEST_ASSERT_EQUAL(found ? 1 : 0, taken);
        TEST_ASSERT_FALSE(axis.guard.homed);
        TEST_ASSERT_EQUAL(0, axis.guard.alone_ms);
        TEST_ASSERT_EQUAL(tl_axis_is_following(&axis) ? was.guard.patience : was.guard.silence_ms, axis.guard.patience);
        if (found) { // dragged along to the end, and left behind since: within B = 300 counts all along
            const tl_count_q8_t half = 150 * TL_COUNT_ONE, tip = axis.trial.end - axis.trial.way * half;
            const tl_count_q8_t low = axis.q - half, high = axis.q + half;
            TEST_ASSERT_INT32_WITHIN(1, tl_clamp(tip, low, high), axis.tip.play.p);
        }
    }
}

static void test_each_reason_was_given(void) {
    test_moving();
    test_following();
    const uint8_t each[] = {TL_WIRE_REASON_FAULT,          TL_WIRE_REASON_OFF,
                            TL_WIRE_REASON_BUSY,           TL_WIRE_REASON_RANGE,
                            TL_WIRE_REASON_NOT_REFERENCED, TL_WIRE_REASON_NO_TABLE};
    for (uint32_t i = 0; i < sizeof each; i++) {
        TEST_ASSERT_TRUE(reasons[each[i]] > 50U);
    }
    TEST_ASSERT_TRUE(reasons[0] > 500U);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_an_axis_begins_as_its_header_says);
    RUN_TEST(test_settings_are_limits_and_less_until_commissioned);
    RUN_TEST(test_enabling);
    RUN_TEST(test_moving);
    RUN_TEST(test_jogging);
    RUN_TEST(test_homing);
    RUN_TEST(test_following);
    RUN_TEST(test_calibrating);
    RUN_TEST(test_telling_where_it_is);
    RUN_TEST(test_gains_strength_and_clearing);
    RUN_TEST(test_limits);
    RUN_TEST(test_hearing);
    RUN_TEST(test_each_reason_was_given);
    return UNITY_END();
}
