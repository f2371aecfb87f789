// What an axis notices by itself against its model (guard_model.h): after every millisecond the same mode, fault, value
// and memory, whatever motor, encoder, current, supply and host do.
#include "draws.h"
#include "guard_model.h"
#include "silent_port.h"
#include "tautline/tl_axis_ask.h"
#include "tautline/tl_axis_rest.h"

#include <string.h>
#include <unity.h>

#ifndef LIVES
#define LIVES 4000U
#endif
#define LIFE_MS  1300
#define LEAST_OF (LIVES / 500U) // each fault and event comes at least so often

static tl_axis_t axis;
static guard_model_t m;
static guard_input_t in;
static uint32_t faults[32], seen[8];

void setUp(void) {}
void tearDown(void) {}

static int32_t the_current(void *context, uint8_t index) {
    (void)context;
    (void)index;
    return in.current_ma;
}
static uint16_t the_supply(void *context) {
    (void)context;
    return (uint16_t)in.supply_mv;
}
static bool the_driver(void *context, uint8_t index) {
    (void)context;
    (void)index;
    return in.driver_fault;
}

static tl_port_t port = {.control_hz = 5000,
                         .axes = 1,
                         .driver_ma = 1200,
                         .supply_low_mv = 4000,
                         .time_us = no_time,
                         .encoder = no_encoder,
                         .drive = no_drive,
                         .current_ma = the_current,
                         .supply_mv = the_supply,
                         .driver_fault = the_driver};

// -- a life -----------------------------------------------------------------------------------------------------------

static struct {
    int32_t speed, current, pushed_of, dip_of, fault_of, duty, error, lost_of, way;
    bool gentle;
} life;

static const uint8_t modes[] = {TL_WIRE_MODE_OFF,         TL_WIRE_MODE_HOLD,      TL_WIRE_MODE_MOVE,
                                TL_WIRE_MODE_HOME,        TL_WIRE_MODE_CHECK,     TL_WIRE_MODE_FOLLOW_MOTOR,
                                TL_WIRE_MODE_FOLLOW_TIP,  TL_WIRE_MODE_CALIBRATE, TL_WIRE_MODE_STOPPING,
                                TL_WIRE_MODE_STOPPING_OFF};

static void any_life(void) {
    life.speed = once_in(3) ? 0 : between(-1500, 1500);
    life.current = once_in(8) ? between(900, 1300) : between(0, 250);
    life.current = once_in(12) ? between(0, 1) * 120000 : life.current; // from one end to the other
    life.pushed_of = once_in(3) ? between(1, 3) : between(4, 1000);
    life.dip_of = once_in(6) ? between(1, 4) : 100000;
    life.fault_of = once_in(12) ? between(1, 2) : 50;
    life.duty = between(-32768, 32768);
    life.error = once_in(16) ? between(60 * 256, 330 * 256) : between(0, 40 * 256);
    life.lost_of = once_in(6) ? between(2, 400) : 1000000;
    life.gentle = once_in(2);
    life.way = between(1, 2);
}

static void begin_check(void) {
    tl_axis_start_check(&axis);
    const tl_servo_gains_t *gains = &axis.motor.servo.gains;
    int most = gains->friction + 2621;
    most = most < axis.settings.low_duty_q15 ? most : axis.settings.low_duty_q15;
    most = most < axis.limits.duty_q15 ? most : axis.limits.duty_q15;
    const bool told = gains->feed_forward > 0 && most > gains->friction; // then 32 ms at that many thousand counts/s
    const int way = told ? (most - gains->friction) * 32 * 256 / gains->feed_forward : 0;
    memset(&m.trial, 0, sizeof m.trial);
    m.trial.way = 1;
    m.trial.most = most;
    m.trial.from = m.q;
    m.trial.least = way / 3;
    m.trial.far = way * 3;
    if (!once_in(4)) { // about as the gains say, or not at all
        life.speed = way / 32 * between(-1, 40) / 10;
        life.current = 0;
        life.gentle = true;
    }
}

static void any_settings(void) {
    tl_wire_settings_t settings = tl_axis_default_settings(&port, 0);
    settings.commissioned = (uint8_t)between(0, 2) > 0 ? 1 : 0;
    settings.stall_ms = (uint16_t)between(20, 400);
    settings.hold_ms = once_in(3) ? 0U : (uint32_t)between(1, 500);
    settings.current_ma = once_in(4) ? 0 : between(300, 1200);
    settings.friction_q15 = between(0, 3000);
    settings.feed_forward = once_in(5) ? between(0, 1) : between(300, 4000);
    settings.low_duty_q15 = between(1000, 16000);
    settings.arrive_q8 = between(256, 4096);
    settings.following_error_q8 = between(256, 300 * 256);
    settings.q_low_q8 = -between(1000, 2000) * 256;
    settings.q_high_q8 = between(1000, 2000) * 256;
    port.driver_ma = once_in(4) ? 0 : 1200;
    tl_axis_use_settings(&axis, &settings);
    tl_servo_gains_t *gains = &axis.motor.servo.gains;
    gains->friction = settings.friction_q15;
    axis.limits.current_ma = settings.current_ma;
    axis.limits.duty_q15 = once_in(4) ? between(500, 6000) : axis.limits.duty_q15;
}

static void begin(void) {
    port.driver_ma = 1200;
    tl_axis_init(&axis, &port, 0);
    any_settings();
    any_life();
    memset(&m, 0, sizeof m);
    m.commissioned = axis.settings.commissioned != 0U;
    m.q = axis.q = between(-900, 900) * 256;
    m.referenced = axis.referenced = once_in(2);
    m.checked = axis.checked = once_in(2);
    tl_axis_settle(&axis);
    tl_axis_admit(&axis);
    m.mode = modes[between(0, (int32_t)sizeof modes - 1)];
    tl_axis_enter(&axis, (tl_wire_mode_t)m.mode);
    m.off_ms = axis.guard.off_ms = (uint8_t)between(0, 255);
    life.lost_of = m.mode == TL_WIRE_MODE_OFF && once_in(2) ? between(2, 200) : life.lost_of;
    m.seen_q = axis.guard.seen_q = axis.guard.still_q = m.still_q = axis.q;
    m.patience = axis.guard.patience = (uint32_t)between(1, 1500);
    m.lapsed = axis.guard.lapsed = m.mode == TL_WIRE_MODE_OFF && once_in(8);
    m.alone = axis.guard.alone_ms = once_in(6) ? TL_AXIS_LET_GO : 0U;
    m.homing = axis.guard.homing = m.mode == TL_WIRE_MODE_MOVE && once_in(2);
    m.limit = axis.motor.limit = axis.limits.duty_q15;
    m.target = axis.plan.move_target = m.q + between(-30, 30) * 256;
    if (m.mode == TL_WIRE_MODE_CHECK) {
        begin_check();
    } else if (m.mode == TL_WIRE_MODE_HOME) {
        axis.trial = (tl_axis_trial_t){.way = (int8_t)(once_in(2) ? 1 : -1),
                                       .from = axis.q,
                                       .reach = between(1, 300) * 256,
                                       .end = between(-2100, 2100) * 256,
                                       .retreat = between(0, 500) * 256};
        m.trial.way = axis.trial.way;
        m.trial.from = axis.trial.from;
        m.trial.reach = axis.trial.reach;
        m.trial.end = axis.trial.end;
        m.trial.retreat = axis.trial.retreat;
    }
}

static void something_happens(void) {
    if (once_in(150) && !life.gentle) {
        any_life();
    }
    in.duty = tl_clamp(life.duty + between(-900, 900), -32768, 32768);
    in.duty = once_in(9) ? between(-1, 1) : in.duty;
    in.pushed = once_in(life.pushed_of) ? (once_in(8) ? between(1, 3) : life.way) : 0;
    in.current_ma = (life.current + between(-300, 300)) * (once_in(2) ? 1 : -1);
    in.current_ma = once_in(3000) ? between(-2, 2) * 150000 : in.current_ma;
    in.supply_mv = once_in(life.dip_of) ? between(3000, 4000) : 4000 + between(0, 2000);
    in.driver_fault = !once_in(life.fault_of) ? false : once_in(2) || life.fault_of == 1;
    const bool turned = m.mode == TL_WIRE_MODE_CHECK && m.trial.way < 0 && life.gentle;
    m.q += (turned ? -life.speed : life.speed) + (life.speed != 0 ? between(-40, 40) : 0);
    in.path_rests = once_in(2);
    in.sees = !once_in(life.lost_of);
    m.error = once_in(3) ? life.error : -life.error;
    in.there = m.mode == TL_WIRE_MODE_MOVE && !once_in(15);
    m.q = in.there && once_in(2) ? m.target + between(-1, 1) * axis.settings.arrive_q8 + between(0, 1) : m.q;
}

// Puts it where the axis finds it.
static void show(void) {
    axis.q = m.q;
    axis.motor.duty = in.duty;
    axis.guard.pushed = (uint8_t)in.pushed;
    axis.motor.servo.velocity = between(-(1 << 24), 1 << 24);
    in.speed = (int32_t)((int64_t)axis.motor.servo.velocity * (int32_t)port.control_hz >> 24);
    tl_sight_reset(&axis.motor.sight, axis.q);
    axis.motor.sight.gain = 342;
    axis.motor.sight.least = in.sees ? 0 : 1 << 20; // it must have gone far beyond what may stay unseen
    axis.motor.sight.must = in.sees ? 0 : 100 * 256;
    axis.path.q = axis.q + m.error;
    axis.path.speed = in.path_rests ? 0 : once_in(2) ? between(1, 9000) : 0;
    axis.path.bend = in.path_rests || axis.path.speed != 0 ? 0 : between(1, 9);
    axis.plan.reference.fraction = 0;
    axis.plan.reference.velocity = 0;
    axis.plan.reference.q = m.target;
    if (m.mode == TL_WIRE_MODE_MOVE) {
        axis.path.q = m.target;
        m.error = m.target - m.q;
        if (in.there) {
            axis.path.speed = axis.path.bend = 0;
            in.path_rests = true;
        } else {
            const int what = between(0, 2);
            axis.path.q += what == 0 ? 1 : 0;
            m.error += what == 0 ? 1 : 0;
            axis.plan.reference.q -= what == 1 ? 1 : 0;
            axis.path.speed = what == 2 ? 1 : axis.path.speed;
            in.path_rests = axis.path.speed == 0 && axis.path.bend == 0;
        }
    }
}

#define SAME(of_model, of_axis) TEST_ASSERT_EQUAL_INT64((int64_t)(of_model), (int64_t)(of_axis))

static void check_trial(void) {
    SAME(m.trial.way, axis.trial.way);
    SAME(m.trial.phase, axis.trial.phase);
    SAME(m.trial.ms, axis.trial.ms);
    SAME(m.trial.duty, axis.trial.duty);
    SAME(m.trial.most, axis.trial.most);
    SAME(m.trial.from, axis.trial.from);
    SAME(m.trial.mark, axis.trial.mark);
    SAME(m.trial.least, axis.trial.least);
    SAME(m.trial.far, axis.trial.far);
    SAME(m.trial.moved, axis.trial.moved);
    SAME(m.trial.right_scale, axis.trial.right_scale);
    SAME(m.trial.speed, axis.trial.speed);
}

static void check_memory(void) {
    const tl_axis_guarded_t *guard = &axis.guard;
    SAME(m.mean, guard->current_mean_q8);
    SAME(m.supply_ms, guard->supply_ms);
    SAME(m.driver_ms, guard->driver_ms);
    SAME(m.off_ms, guard->off_ms);
    SAME(m.seen_q, guard->seen_q);
    SAME(m.seen_duty, guard->seen_duty);
    SAME(m.unseen, guard->unseen_ms);
    SAME(m.still_q, guard->still_q);
    SAME(m.pushed_ms, guard->pushed_ms);
    SAME(m.swing, guard->swing);
    SAME(m.swing_way, guard->swing_way);
    SAME(m.still_ms, guard->still_ms);
    SAME(m.blind, guard->blind);
    SAME(m.lapsed, guard->lapsed);
    SAME(m.homing, guard->homing);
    SAME(m.homed, guard->homed);
    SAME(m.patience, guard->patience);
    SAME(m.alone, guard->alone_ms);
    SAME(m.sink, guard->sink);
    SAME(in.supply_mv, guard->supply_mv);
}

static void check(uint64_t now_us) {
    SAME(m.mode, axis.mode);
    SAME(m.fault, axis.fault);
    SAME(m.events, axis.events);
    SAME(m.referenced, axis.referenced);
    SAME(m.checked, axis.checked);
    SAME(m.silent, axis.silent);
    SAME(m.q, axis.q);
    SAME(m.limit, axis.motor.limit);
    SAME(is_closed(&m), axis.closed);
    SAME(m.target, axis.plan.move_target);
    if (m.fault != TL_WIRE_FAULT_NONE) {
        SAME(m.fault_value, axis.guard.fault_value);
        SAME(now_us, axis.guard.fault_us);
        SAME(0, axis.motor.duty);
    }
    check_memory();
    if (m.mode == TL_WIRE_MODE_CHECK) {
        check_trial();
    }
}

static void live(void) {
    begin();
    for (uint64_t ms = 1; ms <= LIFE_MS; ms++) {
        something_happens();
        show();
        guard_model_ms(&m, &axis, &in);
        tl_axis_guard(&axis, ms * 1000U);
        check(ms * 1000U);
        if (m.fault != TL_WIRE_FAULT_NONE) {
            break;
        }
    }
    faults[m.fault]++;
    for (int event = 0; event < 8; event++) {
        seen[event] += (m.events >> event & 1) != 0 ? 1U : 0U;
    }
}

static void test_the_guards_are_their_model(void) {
    static const uint8_t each[] = {TL_WIRE_FAULT_NONE,   TL_WIRE_FAULT_CURRENT,     TL_WIRE_FAULT_FOLLOWING,
                                   TL_WIRE_FAULT_STALL,  TL_WIRE_FAULT_OSCILLATION, TL_WIRE_FAULT_DRIVER,
                                   TL_WIRE_FAULT_SUPPLY, TL_WIRE_FAULT_EDGES,       TL_WIRE_FAULT_HOST_LOST,
                                   TL_WIRE_FAULT_NO_END, TL_WIRE_FAULT_REVERSED,    TL_WIRE_FAULT_UNMOVED,
                                   TL_WIRE_FAULT_SCALE};
    seed = 31415927U;
    for (uint32_t i = 0; i < LIVES; i++) {
        live();
    }
    for (uint32_t i = 0; i < sizeof each; i++) {
        TEST_ASSERT_TRUE(faults[each[i]] >= LEAST_OF);
    }
    TEST_ASSERT_TRUE(seen[TL_WIRE_EVENT_ARRIVED] >= LEAST_OF && seen[TL_WIRE_EVENT_HOMED] >= LEAST_OF);
    TEST_ASSERT_TRUE(seen[TL_WIRE_EVENT_CHECKED] >= LEAST_OF && seen[TL_WIRE_EVENT_SILENT] >= LEAST_OF);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_guards_are_their_model);
    return UNITY_END();
}
