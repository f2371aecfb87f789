#include "fake_board.h"

#include <math.h>

void setUp(void) {
    fake_new(2);
    fake_ready();
}
void tearDown(void) {}

static const tl_wire_limits_t limits = {
    .axis = 0,
    .q_low_q8 = -4000 * TL_COUNT_ONE,
    .q_high_q8 = 4000 * TL_COUNT_ONE,
    .speed_q8_s = 8000 * TL_COUNT_ONE,
    .acceleration_q8_s2 = 60000 * TL_COUNT_ONE,
    .duty_q15 = 32768,
    .current_ma = 1000,
    .following_error_q8 = 200 * TL_COUNT_ONE,
};

static int follow(uint8_t axis, uint8_t target) {
    const tl_wire_follow_t request = {.axis = axis, .target = target, .compensation = 2};
    return fake_ask(TL_WIRE_FOLLOW, &request);
}

static int set_point(uint8_t axis, int32_t value, tl_us_t at_us) {
    const tl_wire_set_point_t request = {.axis = axis, .value = value, .at_us = at_us};
    return fake_ask(TL_WIRE_SET_POINT, &request);
}

static int move(uint8_t axis, int32_t counts) {
    const tl_wire_move_t request = {.axis = axis, .q_q8 = counts * TL_COUNT_ONE};
    return fake_ask(TL_WIRE_MOVE, &request);
}

static int clear_fault(uint8_t axis) {
    const tl_wire_clear_fault_t request = {.axis = axis};
    return fake_ask(TL_WIRE_CLEAR_FAULT, &request);
}

// The safe state: motor off, compensation off, every request that would move it refused, until the fault is cleared.
static void assert_safe(uint8_t axis, tl_wire_fault_t fault) {
    const tl_wire_status_t status = fake_status(axis);
    TEST_ASSERT_EQUAL(fault, status.fault);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, status.mode);
    TEST_ASSERT_EQUAL(0, status.flags & (TL_WIRE_FLAG_ENABLED | TL_WIRE_FLAG_COMPENSATING));
    TEST_ASSERT_EQUAL(0, fake.duty[axis]);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_FAULT, fake_enable(axis, 1));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_FAULT, move(axis, 10));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_FAULT, follow(axis, 0));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_FAULT, set_point(axis, 0, 0));
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(0, fake.duty[axis]);
    TEST_ASSERT_EQUAL(0, clear_fault(axis));
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(axis).fault);
    TEST_ASSERT_EQUAL(0, fake.duty[axis]); // clearing drives nothing
}

static void test_a_blocked_motor_faults(void) {
    fake_enable(0, 1);
    fake.blocked = true;
    TEST_ASSERT_EQUAL(0, move(0, 2000));
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault);
    fake_run_ms(300);
    fake_listen();
    TEST_ASSERT_EQUAL(TL_WIRE_EVENT_FAULT, heard[TL_WIRE_EVENT].event.event);
    assert_safe(0, TL_WIRE_FAULT_FOLLOWING);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(1).fault);
}

static void test_too_much_current_faults_after_its_mean(void) {
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    fake_enable(0, 1);
    fake.current_ma = -3000;
    fake_run_ms(3);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault); // a spike is none
    fake_run_ms(30);
    fake.current_ma = 0;
    assert_safe(0, TL_WIRE_FAULT_CURRENT);
}

static void test_lost_edges_fault_moving_or_off(void) {
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL(0, move(0, 2000));
    fake_run_ms(60); // at speed
    const double from = fake.position[0];
    fake_run_ms(10);
    const double speed = (fake.position[0] - from) * 100.0; // counts/s
    fake.slipped[0] = true;
    fake_run_ms(2);
    TEST_ASSERT_TRUE(speed > 1000.0);
    TEST_ASSERT_DOUBLE_WITHIN(0.1 * speed, speed, fake_status(0).fault_value);
    assert_safe(0, TL_WIRE_FAULT_EDGES);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(1).fault);
    fake.slipped[1] = true;
    fake_run_ms(2);
    assert_safe(1, TL_WIRE_FAULT_EDGES);
}

static void test_an_encoder_that_jumps_faults_even_when_off(void) {
    fake.position[0] -= 5000.0;
    fake_run_ms(1);
    TEST_ASSERT_INT_WITHIN(1, -5000, fake_status(0).fault_value); // whole counts: rounded down
    assert_safe(0, TL_WIRE_FAULT_ENCODER);
}

static void test_safe_stop_works_from_every_state(void) {
    for (int state = 0; state < 4; state++) {
        fake_new(2);
        fake_ready();
        if (state > 0) {
            fake_enable(0, 1);
        }
        if (state == 2) {
            move(0, 3000);
        } else if (state == 3) {
            const tl_wire_motion_start_t start = fake_calibration();
            TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
        }
        fake_run_ms(50);
        const tl_wire_safe_stop_t stop = {.axis = TL_WIRE_ALL_AXES};
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SAFE_STOP, &stop));
        TEST_ASSERT_EQUAL(0, fake.duty[0]);
        fake_run_ms(2);
        assert_safe(0, TL_WIRE_FAULT_STOPPED);
        assert_safe(1, TL_WIRE_FAULT_STOPPED);
    }
}

static void test_late_control_steps_fault_a_driven_axis_only(void) {
    fake_enable(0, 1);
    fake_run_ms(5);
    fake.t_us += 30000;
    fake_step();
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(1).fault);
    assert_safe(0, TL_WIRE_FAULT_OVERRUN);
}

static void test_a_watchdog_restart_is_told_and_latched(void) {
    fake_start(2, TL_WIRE_BOOT_WATCHDOG);
    assert_safe(0, TL_WIRE_FAULT_WATCHDOG);
    assert_safe(1, TL_WIRE_FAULT_WATCHDOG);
}

static void test_the_watchdog_is_fed_only_while_control_steps_go_on(void) {
    fake_run_ms(10);
    const uint32_t before = fake.fed;
    for (int i = 0; i < 100; i++) {
        fake.t_us += 1000;
        tl_app_task(&app);
    }
    TEST_ASSERT_TRUE(before >= 9);
    TEST_ASSERT_TRUE(fake.fed - before <= 1);
}

static void test_a_silent_sender_brings_the_axis_to_rest_and_holds(void) {
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL(0, follow(0, 0));
    for (int i = 1; i <= 40; i++) {
        TEST_ASSERT_EQUAL(-1, set_point(0, 15 * i * TL_COUNT_ONE, fake.t_us + 5000));
        fake_run_ms(5);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_FOLLOW_MOTOR, fake_status(0).mode);
    fake_run_ms(150);
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, status.mode);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, status.fault);
    TEST_ASSERT_TRUE((status.flags & TL_WIRE_FLAG_SILENT) != 0);
    TEST_ASSERT_TRUE((status.flags & TL_WIRE_FLAG_AT_REST) != 0);
    TEST_ASSERT_INT_WITHIN(5, 600, status.q_q8 / TL_COUNT_ONE);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NOT_FOLLOWING, set_point(0, 0, 0));
    const tl_wire_get_counters_t ask = {0};
    fake_ask(TL_WIRE_GET_COUNTERS, &ask);
    TEST_ASSERT_EQUAL(1, heard[TL_WIRE_COUNTERS].counters.silences);
    TEST_ASSERT_EQUAL(40, heard[TL_WIRE_COUNTERS].counters.set_points);
    TEST_ASSERT_EQUAL(1, heard[TL_WIRE_COUNTERS].counters.set_points_dropped);
}

// A request may come well after the last control step: a board over other makers' drives steps when they answer.
static void test_a_sender_that_is_silent_after_a_late_request_is_noticed(void) {
    for (int points = 0; points < 2; points++) {
        fake_new(2);
        fake_ready();
        fake_enable(0, 1);
        fake.t_us += points == 0 ? 10000 : 0; // beyond what is planned ahead
        TEST_ASSERT_EQUAL(0, follow(0, 0));
        if (points > 0) {
            fake.t_us += 10000;
            TEST_ASSERT_EQUAL(-1, set_point(0, TL_COUNT_ONE, fake.t_us - 5000));
        }
        fake_run_ms(150);
        const tl_wire_status_t status = fake_status(0);
        TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, status.mode);
        TEST_ASSERT_TRUE((status.flags & TL_WIRE_FLAG_SILENT) != 0);
    }
}

static void test_losing_the_bus_while_following_comes_to_rest_at_once(void) {
    fake_enable(0, 1);
    follow(0, 0);
    set_point(0, 1000 * TL_COUNT_ONE, fake.t_us + 2000000);
    fake_run_ms(50);
    tl_app_bus(&app, false);
    fake_run_ms(60);
    tl_app_bus(&app, true);
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, status.mode);
    TEST_ASSERT_TRUE(status.q_q8 < 100 * TL_COUNT_ONE);
}

static void test_set_points_are_joined_by_straight_lines_in_time(void) {
    fake_enable(0, 1);
    fake_run_ms(3);
    follow(0, 0);
    const tl_us_t start = fake.t_us;
    TEST_ASSERT_EQUAL(-1, set_point(0, 10 * TL_COUNT_ONE, start + 10000));
    TEST_ASSERT_EQUAL(-1, set_point(0, 100 * TL_COUNT_ONE, start + 100000));
    TEST_ASSERT_EQUAL(-1, set_point(0, 110 * TL_COUNT_ONE, start + 150200)); // not at a whole millisecond
    fake_run_ms(75);
    for (int i = 0; i < 6; i++) { // at every tick of a millisecond: what is planned ahead is met at its time
        const tl_us_t since = fake.t_us - start;
        TEST_ASSERT_INT_WITHIN(2, (int32_t)(since * TL_COUNT_ONE / 1000U), fake_status(0).q_ref_q8);
        fake_step();
    }
    fake_run_ms(50);
    const int32_t later = 100 * TL_COUNT_ONE + (int32_t)((fake.t_us - start - 100000U) * 2560U / 50200U);
    TEST_ASSERT_INT_WITHIN(2, later, fake_status(0).q_ref_q8);
    fake_run_ms(40);
    TEST_ASSERT_EQUAL(110 * TL_COUNT_ONE, fake_status(0).q_ref_q8);
    TEST_ASSERT_EQUAL(-1, set_point(0, 40 * TL_COUNT_ONE, fake.t_us - 1000));
    TEST_ASSERT_EQUAL(1, app.counters.set_points_late);
    for (unsigned i = 0; i < TL_STREAM_SIZE - 1U; i++) {
        TEST_ASSERT_EQUAL(-1, set_point(0, 40 * TL_COUNT_ONE, fake.t_us + 10000 + 1000 * i));
    }
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_QUEUE_FULL, set_point(0, 0, fake.t_us + 90000));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, set_point(0, 0, fake.t_us + 20000000));
}

// A sender that gives no times but keeps its pace gets a line, not steps.
static void test_set_points_without_a_time_are_smoothed(void) {
    fake_enable(0, 1);
    follow(0, 0);
    int32_t before = 0;
    for (int i = 1; i <= 60; i++) {
        set_point(0, 10 * i * TL_COUNT_ONE, 0);
        for (int k = 0; k < 25; k++) { // 5 ms
            fake_step();
            const int32_t speed = app.axes[0].path.speed;
            if (i > 20) { // 2000 counts/s are 0.4 counts/tick
                TEST_ASSERT_INT_WITHIN(1 << 20, (1 << 24) * 2 / 5, speed);
            }
            TEST_ASSERT_TRUE(app.axes[0].path.q >= before);
            before = app.axes[0].path.q;
        }
    }
    TEST_ASSERT_INT_WITHIN(5 * TL_COUNT_ONE, 600 * TL_COUNT_ONE, before); // 2.5 ms from set-point to motor
}

static void test_enabling_and_disabling_never_jump(void) {
    fake.speed[0] = 3000.0; // pushed by hand while off
    fake_run_ms(100);
    TEST_ASSERT_EQUAL_INT32(app.axes[0].q, fake_status(0).q_ref_q8); // the path goes along
    const double before = fake.position[0];
    fake_enable(0, 1);
    for (int i = 0; i < 500; i++) {
        fake_step();
        TEST_ASSERT_TRUE(fabs(fake.position[0] - before) < 12.0);
    }
    move(0, 1500);
    fake_run_ms(100);
    const double speed = fake.speed[0];
    TEST_ASSERT_TRUE(fabs(speed) > 500.0);
    fake_enable(0, 0); // comes to rest within its limits first
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_STOPPING_OFF, fake_status(0).mode);
    fake_run_ms(200);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, fake_status(0).mode);
    TEST_ASSERT_EQUAL(0, fake.duty[0]);
}

static const tl_count_q8_t low = -4000 * TL_COUNT_ONE;
static const tl_count_q8_t high = 4000 * TL_COUNT_ONE;

// Random targets of every kind: the reference never leaves position, speed and acceleration limits, and gets there.
static void test_the_reference_keeps_its_limits(void) {
    const uint32_t rates[] = {1000, 5000, 10000};
    srand(7);
    for (int run = 0; run < 60; run++) {
        const uint32_t rate = rates[run % 3];
        const tl_reference_limits_t within =
            tl_reference_limits((500 + rand() % 20000) * TL_COUNT_ONE, (5000 + rand() % 200000) * TL_COUNT_ONE, rate);
        tl_reference_t reference = {.low = low, .high = high};
        tl_reference_set(&reference, 0);
        int32_t target = 0;
        int32_t slope = 0;
        for (uint32_t i = 0; i < 3U * rate; i++) {
            if (rand() % (int)rate == 0) {
                target = (rand() % 8000 - 4000) * TL_COUNT_ONE;
                slope = rand() % 2 == 0 ? 0 : rand() % 400 - 200;
            }
            target = tl_clamp(target + slope, low, high);
            const int32_t before = reference.velocity;
            tl_reference_step(&reference, target, &within);
            TEST_ASSERT_TRUE(abs(reference.velocity) <= within.speed);
            TEST_ASSERT_TRUE(abs(reference.velocity - before) <= within.acceleration);
            TEST_ASSERT_TRUE(tl_reference_q(&reference) >= low && tl_reference_q(&reference) <= high);
        }
        slope = 0;
        for (uint32_t i = 0; i < 40U * rate; i++) {
            tl_reference_step(&reference, target, &within);
            TEST_ASSERT_TRUE(tl_reference_q(&reference) >= low && tl_reference_q(&reference) <= high);
        }
        TEST_ASSERT_TRUE(tl_reference_rests_at(&reference, target));
        // From rest to a far target it does not overshoot by a count.
        const int32_t far = target > 0 ? -3000 * TL_COUNT_ONE : 3000 * TL_COUNT_ONE;
        int32_t extreme = 0;
        for (uint32_t i = 0; i < 40U * rate; i++) {
            tl_reference_step(&reference, far, &within);
            const int32_t beyond = far > 0 ? tl_reference_q(&reference) - far : far - tl_reference_q(&reference);
            extreme = beyond > extreme ? beyond : extreme;
        }
        TEST_ASSERT_EQUAL(far, tl_reference_q(&reference));
        TEST_ASSERT_TRUE_MESSAGE(extreme < TL_COUNT_ONE, "overshoot");
    }
}

static int32_t between(int32_t least, int32_t most) {
    return least + rand() % (most - least + 1);
}

// Targets that jump from end to end or run into one at any speed, with any limits: the range is not left by a bit, nor
// are speed and acceleration.
static void test_the_reference_never_leaves_its_range(void) {
    const uint32_t rates[] = {1000, 5000, 10000};
    srand(3);
    for (int run = 0; run < 300; run++) {
        const int32_t quick = run % 2 == 0 ? 4000000 : 20000; // a tick's acceleration, and what is cut off, weigh most
        const tl_reference_limits_t most =
            tl_reference_limits(between(1, 30000) * TL_COUNT_ONE, between(1000, quick) * TL_COUNT_ONE, rates[run % 3]);
        const tl_count_q8_t end = between(1, run % 4 < 2 ? 4000 : 200) * TL_COUNT_ONE;
        tl_reference_t reference = {.low = -end, .high = end};
        tl_reference_set(&reference, between(-end, end));
        tl_count_q8_t target = reference.q, slope = 0;
        for (int i = 0; i < 6000; i++) {
            if (i % 60 == 0 && rand() % 5 == 0) {
                slope = rand() % 2 == 0 ? between(-20, 20) : between(-2, 2) * (most.speed >> 16);
            }
            if (rand() % 40 == 0) {
                const tl_count_q8_t inside = between(0, 600);
                target = rand() % 2 == 0 ? end - inside : inside - end;
            }
            target = tl_clamp(target + slope, -2 * end, 2 * end);
            const int32_t before = reference.velocity;
            tl_reference_step(&reference, target, &most);
            TEST_ASSERT_TRUE(abs(reference.velocity) <= most.speed);
            TEST_ASSERT_TRUE(abs(reference.velocity - before) <= most.acceleration);
            TEST_ASSERT_LESS_OR_EQUAL_INT32(end, abs(tl_reference_q(&reference)));
        }
    }
}

// Every step length, also those that are whole multiples of what a tick's acceleration covers, is reached exactly.
static void test_the_reference_arrives_exactly(void) {
    const uint32_t rates[] = {1000, 5000, 10000};
    for (int k = 0; k < 3; k++) {
        const tl_reference_limits_t within = tl_reference_limits(16000 * TL_COUNT_ONE, 200000 * TL_COUNT_ONE, rates[k]);
        for (int32_t target = 1; target < 3000 * TL_COUNT_ONE; target += 977) {
            tl_reference_t reference = {.low = low, .high = high};
            tl_reference_set(&reference, 0);
            for (uint32_t i = 0; i < rates[k]; i++) {
                tl_reference_step(&reference, target, &within);
            }
            TEST_ASSERT_TRUE(tl_reference_rests_at(&reference, target));
        }
        tl_reference_t reference = {.low = low, .high = high}; // onto the very end of the range
        tl_reference_set(&reference, 0);
        for (uint32_t i = 0; i < 2U * rates[k]; i++) {
            tl_reference_step(&reference, high, &within);
        }
        TEST_ASSERT_TRUE(tl_reference_rests_at(&reference, high));
    }
}

// Whatever the limits: a target is reached exactly, without leaving speed and acceleration.
static void test_the_reference_comes_to_rest_with_any_limits(void) {
    const uint32_t rates[] = {1000, 5000, 10000};
    srand(11);
    for (int run = 0; run < 3000; run++) {
        const uint32_t rate = rates[run % 3];
        const int32_t speed = (500 + rand() % 20000) * TL_COUNT_ONE;
        const int32_t acceleration = (5000 + rand() % 200000) * TL_COUNT_ONE;
        const tl_reference_limits_t within = tl_reference_limits(speed, acceleration, rate);
        tl_reference_t reference = {.low = low, .high = high};
        tl_reference_set(&reference, 0);
        const int32_t target = rand() % (2 * high) - high;
        for (uint32_t i = 0; i < 20U * rate && !tl_reference_rests_at(&reference, target); i++) {
            const int32_t before = reference.velocity;
            tl_reference_step(&reference, target, &within);
            TEST_ASSERT_TRUE(abs(reference.velocity) <= within.speed);
            TEST_ASSERT_TRUE(abs(reference.velocity - before) <= within.acceleration);
        }
        TEST_ASSERT_TRUE(tl_reference_rests_at(&reference, target));
    }
}

// A smooth target well within the limits is followed without lag.
static void test_the_reference_does_not_trail_a_moving_target(void) {
    const tl_reference_limits_t within = tl_reference_limits(8000 * TL_COUNT_ONE, 60000 * TL_COUNT_ONE, FAKE_HZ);
    tl_reference_t reference = {.low = low, .high = high};
    tl_reference_set(&reference, 0);
    for (uint32_t i = 1; i < 5U * FAKE_HZ; i++) {
        const double t = (double)i / FAKE_HZ;
        const double ramp = t < 0.1 ? t * t / 0.2 : t - 0.05; // starts from rest
        const int32_t target = (int32_t)lround(800.0 * sin(6.0 * ramp) * 256.0);
        tl_reference_step(&reference, target, &within);
        TEST_ASSERT_INT_WITHIN(256, target, tl_reference_q(&reference));
    }
}

static void test_positions_beyond_the_limits_are_held_at_the_end(void) {
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, move(0, 4001));
    follow(0, 0);
    for (int i = 0; i < 100; i++) {
        set_point(0, 5000 * TL_COUNT_ONE, fake.t_us + 10000);
        fake_run_ms(10);
    }
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(4000 * TL_COUNT_ONE, status.q_ref_q8);
    TEST_ASSERT_TRUE((status.flags & TL_WIRE_FLAG_SATURATED_RANGE) != 0);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, status.fault);
}

static void test_an_axis_outside_its_limits_may_stay_and_come_back(void) {
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    const tl_wire_set_position_t position = {.axis = 0, .q_q8 = 4300 * TL_COUNT_ONE};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SET_POSITION, &position));
    fake_enable(0, 1);
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(0, follow(0, 0));
    set_point(0, 4350 * TL_COUNT_ONE, 0);
    fake_run_ms(90);
    TEST_ASSERT_INT_WITHIN(3, 4300, fake_status(0).q_q8 / TL_COUNT_ONE);
    TEST_ASSERT_EQUAL(0, move(0, 3900));
    fake_run_ms(500);
    TEST_ASSERT_INT_WITHIN(3, 3900, fake_status(0).q_q8 / TL_COUNT_ONE);
}

static void test_a_calibration_without_frames_ends_in_the_safe_state(void) {
    fake_enable(0, 1);
    const tl_wire_motion_start_t start = fake_calibration();
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    fake_run_ms(100);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_CALIBRATE, fake_status(0).mode);
    TEST_ASSERT_TRUE(fake_status(0).q_q8 < -50 * TL_COUNT_ONE); // on its way to the low end
    fake_run_ms(400);
    fake_listen();
    TEST_ASSERT_EQUAL(TL_WIRE_MOTION_HOST_LOST, heard[TL_WIRE_PROGRESS].progress.state);
    assert_safe(0, TL_WIRE_FAULT_HOST_LOST);
}

static void run_with_frames(uint32_t ms) {
    for (uint32_t i = 0; i < ms / 40U; i++) {
        const tl_wire_marker_t marker = {.valid = 1, .arrival_us = fake.t_us, .u_q12 = 1000, .v_q12 = 1000};
        fake_ask(TL_WIRE_MARKER, &marker);
        fake_run_ms(40);
    }
}

static void test_losing_the_bus_ends_a_calibration_in_the_safe_state(void) {
    fake_enable(0, 1);
    const tl_wire_motion_start_t start = fake_calibration();
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    run_with_frames(1000);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_CALIBRATE, fake_status(0).mode);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BUSY, fake_ask(TL_WIRE_MOTION_START, &start));
    tl_app_bus(&app, false);
    fake_run_ms(300);
    tl_app_bus(&app, true);
    assert_safe(0, TL_WIRE_FAULT_HOST_LOST);
}

static void test_a_calibration_stopped_by_the_host_rests_and_holds(void) {
    fake_enable(0, 1);
    const tl_wire_motion_start_t start = fake_calibration();
    fake_ask(TL_WIRE_MOTION_START, &start);
    run_with_frames(1000);
    const tl_wire_motion_stop_t stop = {.axis = 0};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_STOP, &stop));
    fake_run_ms(300);
    fake_listen();
    TEST_ASSERT_EQUAL(TL_WIRE_MOTION_STOPPED, heard[TL_WIRE_PROGRESS].progress.state);
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, status.mode);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, status.fault);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NOT_CALIBRATING, fake_ask(TL_WIRE_MOTION_STOP, &stop));
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start)); // and may begin again
}

// What a calibration did: where it drove to, and its last words.
typedef struct {
    tl_count_q8_t q_ref[1500];
    tl_wire_progress_t progress;
} calibrated_t;

static void calibrate(calibrated_t *done, uint8_t left_over, void (*meanwhile)(uint32_t ms)) {
    static uint8_t rubbish[TL_TABLE_SIZE_MAX];
    fake_new(2);
    fake_ready();
    memset(rubbish, left_over, sizeof(rubbish));
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, tl_app_table_data(&app, 0, 0, rubbish, sizeof(rubbish)));
    fake_enable(0, 1);
    const tl_wire_motion_start_t start = fake_calibration();
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    for (uint32_t ms = 0; ms < 1500U; ms++) {
        if (ms % 40U == 0U) {
            const tl_wire_marker_t marker = {
                .valid = 1, .arrival_us = fake.t_us, .u_q12 = (int32_t)(1000U + ms), .v_q12 = 1000};
            fake_ask(TL_WIRE_MARKER, &marker);
        }
        meanwhile(ms);
        fake_run_ms(1);
        done->q_ref[ms] = tl_reference_q(&app.axes[0].plan.reference);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_CALIBRATE, fake_status(0).mode);
    const tl_wire_motion_stop_t stop = {.axis = 0};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_STOP, &stop));
    fake_run_ms(300);
    fake_listen();
    done->progress = heard[TL_WIRE_PROGRESS].progress;
    TEST_ASSERT_EQUAL(TL_WIRE_MOTION_STOPPED, done->progress.state);
}

static uint8_t sent[TL_TABLE_SIZE_MAX];
static uint16_t sent_size;

static void nothing(uint32_t ms) {
    (void)ms;
}

static void upload(uint32_t ms) {
    if (ms % 3U == 0U) {
        TEST_ASSERT_EQUAL(TL_UPLOAD_NOT_OFF, fake_upload((uint8_t)(ms % 2U), sent, sent_size));
    } else if (ms % 3U == 1U) {
        tl_app_table_data(&app, 0, 256U * (ms % 9U), sent, 256U);
    } else {
        TEST_ASSERT_EQUAL(TL_UPLOAD_NOT_OFF, tl_app_table_end(&app, 0));
        tl_app_table_abort(&app);
    }
}

static void test_uploads_during_a_calibration_leave_it_as_it_is(void) {
    static calibrated_t alone, disturbed;
    sent_size = fake_table(sent, 0, 1);
    calibrate(&alone, 0x00, nothing);
    calibrate(&disturbed, 0xFF, upload);
    TEST_ASSERT_EQUAL_MEMORY(&alone, &disturbed, sizeof(alone));
    TEST_ASSERT_TRUE(alone.q_ref[1499] != alone.q_ref[1400]); // it moved
    TEST_ASSERT_EQUAL(TL_WIRE_TABLE_NONE, app.tables.in_use[0].state);
    fake_enable(0, 0);
    fake_run_ms(300);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, sent, sent_size));
    TEST_ASSERT_EQUAL_MEMORY(sent, fake.flash + app.tables.in_use[0].blob, sent_size);
}

static void test_a_table_may_come_while_an_axis_calibrates(void) {
    const uint32_t half = 512;
    sent_size = fake_table(sent, 0, 1);
    const tl_wire_motion_start_t start = fake_calibration();
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, tl_app_table_data(&app, 0, 0, sent, half));
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    fake_run_ms(101);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, tl_app_table_data(&app, 0, half, sent + half, sent_size - half));
    TEST_ASSERT_EQUAL(0, fake.operations);
    const tl_wire_safe_stop_t safe = {.axis = 0};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SAFE_STOP, &safe));
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, tl_app_table_end(&app, 0)); // at once, whatever is still under way
    TEST_ASSERT_EQUAL_MEMORY(sent, fake.flash + app.tables.in_use[0].blob, sent_size);
    fake_run_ms(2);
    fake_listen();
    TEST_ASSERT_EQUAL(TL_WIRE_MOTION_FAILED, heard[TL_WIRE_PROGRESS].progress.state);
}

static void test_compensation_needs_a_table_and_starts_without_a_jump(void) {
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NO_TABLE, follow(0, 1));
    fake_enable(0, 0);
    fake_run_ms(5);
    uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = fake_table(blob, 0, 1);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
    fake_run_ms(5);
    fake_enable(0, 1);
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(0, follow(0, 1));
    double before = fake.position[0];
    for (int i = 0; i < 300; i++) { // standing still, then reversals with the strength changed on the way
        const int32_t c = (int32_t)lround(10.0 * sin(i * 0.05) * TL_DEG_ONE);
        set_point(0, i < 20 ? 0 : c - (int32_t)lround(10.0 * sin(20 * 0.05) * TL_DEG_ONE), fake.t_us + 10000);
        if (i % 37 == 0) {
            const tl_wire_strength_t strength = {.axis = 0, .strength_q15 = rand() % 32769};
            TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_STRENGTH, &strength));
        }
        for (int k = 0; k < 50; k++) {
            fake_step();
            TEST_ASSERT_TRUE(fabs(fake.position[0] - before) < 3.0); // 15 000 counts/s
            before = fake.position[0];
        }
    }
    const tl_wire_strength_t all = {.axis = 0, .strength_q15 = 32768};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_STRENGTH, &all));
    set_point(0, 5 * TL_DEG_ONE, fake.t_us + 500000);
    fake_run_ms(550);
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_FOLLOW_TIP, status.mode);
    TEST_ASSERT_TRUE((status.flags & TL_WIRE_FLAG_COMPENSATING) != 0);
    TEST_ASSERT_INT_WITHIN(TL_DEG_ONE / 4, status.c_ref_q16, status.c_est_q16);
}

static void test_telemetry_is_even_and_every_drop_is_counted(void) {
    const tl_wire_telemetry_t on = {.axis = TL_WIRE_ALL_AXES, .divider = 1};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_TELEMETRY, &on));
    const tl_wire_telemetry_t slow = {.axis = 1, .divider = 61};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_TELEMETRY, &slow));
    tl_us_t next = 0;
    uint32_t samples = 0;
    for (int i = 0; i < 100; i++) {
        fake_run_ms(8);
        memset(heard_count, 0, sizeof(heard_count));
        fake_listen();
        TEST_ASSERT_EQUAL(2, heard_count[TL_WIRE_BATCH]);
        const tl_wire_batch_t *batch = &heard[TL_WIRE_BATCH].batch;
        TEST_ASSERT_TRUE(next == 0 || batch->t_us == next);
        next = batch->t_us + 8000U;
        samples += batch->count;
    }
    TEST_ASSERT_EQUAL(800, samples);
    fake_run_ms(8000); // nobody reads
    const tl_wire_table_read_t read = {.axis = 0};
    uint8_t frame[TL_WIRE_FRAME_MAX];
    tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_TABLE_READ, 1, &read));
    fake_listen();
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_TABLE_PART]); // who then asks is answered all the same
    const uint32_t whole = heard_count[TL_WIRE_BATCH];
    const tl_wire_get_counters_t ask = {.clear = 1};
    fake_ask(TL_WIRE_GET_COUNTERS, &ask);
    const uint32_t dropped = heard[TL_WIRE_COUNTERS].counters.telemetry_dropped;
    TEST_ASSERT_TRUE(dropped > 1000);
    // The last evenly read round is still in the count, and the rings wait full.
    TEST_ASSERT_EQUAL(2 * (1 + 1000), whole + dropped / 8U + 2U * TL_AXIS_SAMPLES / 8U);
}

// A host that is held up for as long as the outbox and the rings last misses nothing.
static void test_telemetry_waits_for_a_host_that_is_busy(void) {
    const tl_wire_telemetry_t on = {.axis = TL_WIRE_ALL_AXES, .divider = 1};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_TELEMETRY, &on));
    const uint32_t fits = TL_APP_QUEUE / (TL_WIRE_HEADER_SIZE + TL_WIRE_SIZE_BATCH + TL_WIRE_CRC_SIZE) / 2U * 8U;
    const uint32_t held_up_ms = fits + TL_AXIS_SAMPLES - 16U;
    fake_run_ms(held_up_ms);
    memset(heard_count, 0, sizeof(heard_count));
    fake_listen();
    for (int i = 0; i < 200; i++) {
        fake_run_ms(1);
        fake_listen();
    }
    const tl_wire_get_counters_t ask = {.clear = 0};
    const uint32_t batches = heard_count[TL_WIRE_BATCH];
    fake_ask(TL_WIRE_GET_COUNTERS, &ask);
    TEST_ASSERT_EQUAL(0, heard[TL_WIRE_COUNTERS].counters.telemetry_dropped);
    TEST_ASSERT_EQUAL((held_up_ms + 200U) / 8U * 2U, batches);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_blocked_motor_faults);
    RUN_TEST(test_too_much_current_faults_after_its_mean);
    RUN_TEST(test_lost_edges_fault_moving_or_off);
    RUN_TEST(test_an_encoder_that_jumps_faults_even_when_off);
    RUN_TEST(test_safe_stop_works_from_every_state);
    RUN_TEST(test_late_control_steps_fault_a_driven_axis_only);
    RUN_TEST(test_a_watchdog_restart_is_told_and_latched);
    RUN_TEST(test_the_watchdog_is_fed_only_while_control_steps_go_on);
    RUN_TEST(test_a_silent_sender_brings_the_axis_to_rest_and_holds);
    RUN_TEST(test_a_sender_that_is_silent_after_a_late_request_is_noticed);
    RUN_TEST(test_losing_the_bus_while_following_comes_to_rest_at_once);
    RUN_TEST(test_set_points_are_joined_by_straight_lines_in_time);
    RUN_TEST(test_set_points_without_a_time_are_smoothed);
    RUN_TEST(test_enabling_and_disabling_never_jump);
    RUN_TEST(test_the_reference_keeps_its_limits);
    RUN_TEST(test_the_reference_never_leaves_its_range);
    RUN_TEST(test_the_reference_arrives_exactly);
    RUN_TEST(test_the_reference_comes_to_rest_with_any_limits);
    RUN_TEST(test_the_reference_does_not_trail_a_moving_target);
    RUN_TEST(test_positions_beyond_the_limits_are_held_at_the_end);
    RUN_TEST(test_an_axis_outside_its_limits_may_stay_and_come_back);
    RUN_TEST(test_a_calibration_without_frames_ends_in_the_safe_state);
    RUN_TEST(test_losing_the_bus_ends_a_calibration_in_the_safe_state);
    RUN_TEST(test_a_calibration_stopped_by_the_host_rests_and_holds);
    RUN_TEST(test_uploads_during_a_calibration_leave_it_as_it_is);
    RUN_TEST(test_a_table_may_come_while_an_axis_calibrates);
    RUN_TEST(test_compensation_needs_a_table_and_starts_without_a_jump);
    RUN_TEST(test_telemetry_is_even_and_every_drop_is_counted);
    RUN_TEST(test_telemetry_waits_for_a_host_that_is_busy);
    return UNITY_END();
}
