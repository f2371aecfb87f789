// What an axis must refuse, notice and survive, one test each: the motors here have inertia, the wires may be swapped.
#include "fake_board.h"

void setUp(void) {
    fake_new(2);
}
void tearDown(void) {}

#define COUNTS(n) ((tl_count_q8_t)((n) * TL_COUNT_ONE))

static int ask_axis(uint8_t type) { // of requests that are an axis alone
    const tl_wire_check_t request = {.axis = 0};
    return fake_ask(type, &request);
}

static int move(int32_t counts) {
    const tl_wire_move_t request = {.axis = 0, .q_q8 = COUNTS(counts), .silence_us = 60000000};
    return fake_ask(TL_WIRE_MOVE, &request);
}

static int set_position(int32_t counts) {
    const tl_wire_set_position_t request = {.axis = 0, .q_q8 = COUNTS(counts)};
    return fake_ask(TL_WIRE_SET_POSITION, &request);
}

static int home(int8_t direction, int32_t reach, int32_t retreat) {
    const tl_wire_home_t request = {.axis = 0,
                                    .direction = direction,
                                    .reach_q8 = COUNTS(reach),
                                    .end_q8 = COUNTS(direction * 3000),
                                    .retreat_q8 = COUNTS(retreat),
                                    .silence_us = 60000000};
    return fake_ask(TL_WIRE_HOME, &request);
}

static tl_wire_settings_t settings(void) {
    const tl_wire_get_settings_t request = {.axis = 0};
    fake_ask(TL_WIRE_GET_SETTINGS, &request);
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_SETTINGS]);
    heard[TL_WIRE_SETTINGS].settings.key = TL_WIRE_KEY;
    return heard[TL_WIRE_SETTINGS].settings;
}

// Ready to move, holding.
static void hold(void) {
    fake_ready();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
}

// Milliseconds until the axis has a fault.
static uint32_t until_fault(uint32_t most_ms) {
    for (uint32_t ms = 0; ms < most_ms; ms++) {
        if (app.axes[0].fault != TL_WIRE_FAULT_NONE) {
            return ms;
        }
        fake_run_ms(1);
    }
    TEST_FAIL_MESSAGE("no fault came");
    return 0;
}

static void assert_fault(tl_wire_fault_t fault) {
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(fault, status.fault);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, status.mode);
    TEST_ASSERT_EQUAL(0, fake.duty[0]);
}

// -- stall, current, driver, supply -----------------------------------------------------------------------------

static void test_a_motor_blocked_near_its_target_faults_within_the_stall_time(void) {
    hold();
    fake.blocked = true;
    TEST_ASSERT_EQUAL(0, move(200)); // within the following error: nothing else notices
    const uint32_t ms = until_fault(1000);
    TEST_ASSERT_INT_WITHIN(100, 300, (int)ms);
    assert_fault(TL_WIRE_FAULT_STALL);
    TEST_ASSERT_EQUAL(32768, abs(fake_status(0).fault_value));
    TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_CHECKED); // wires may have been pulled
}

// It shows nothing any more, and so what the servo sees stands still: the integral drives the motor away. After the
// stall time, and what the integral of the default gains needs to grow by twice what the check drives with.
static void test_an_encoder_lost_next_to_its_target_is_noticed_and_its_position_not_trusted(void) {
    const int32_t ways[] = {2, 3, 5, 8, 20, 60};
    for (unsigned i = 0; i < sizeof(ways) / sizeof(ways[0]); i++) {
        fake_new(1);
        fake.position[0] = 0.5;
        hold();
        fake.wiring[0] = 0.0;
        TEST_ASSERT_EQUAL(0, move(ways[i]));
        const double grows_s = 2.0 * (1300.0 + 2621.0) / (12000.0 * ways[i]);
        const uint32_t ms = until_fault(2000);
        TEST_ASSERT_TRUE(ms <= 300U + 20U + 20U + (uint32_t)(1000.0 * grows_s)); // and the path's own time
        assert_fault(TL_WIRE_FAULT_STALL);
        TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_REFERENCED);
    }
}

static void test_an_encoder_lost_just_before_switching_off_leaves_no_position(void) {
    for (int how = 0; how < 3; how++) {
        fake_new(1);
        fake.position[0] = 0.5;
        hold();
        fake.wiring[0] = how == 2 ? 1.0 : 0.0;
        TEST_ASSERT_EQUAL(0, move(40));
        fake_run_ms(100);
        TEST_ASSERT_EQUAL(0, how == 0 ? ask_axis(TL_WIRE_SAFE_STOP) : fake_enable(0, 0));
        fake_run_ms(100);
        TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, fake_status(0).mode);
        TEST_ASSERT_EQUAL(how == 2, (fake_status(0).flags & TL_WIRE_FLAG_REFERENCED) != 0);
    }
}

// Two counts away the drive grows for half a second before it is a stall, and after the first 0.18 s nothing that
// sticks explains it.
static void test_an_encoder_lost_next_to_its_target_leaves_no_position_when_switched_off(void) {
    for (uint32_t ms = 220; ms <= 340; ms += 40) {
        for (int sound = 0; sound < 2; sound++) {
            fake_new(1);
            fake.position[0] = 0.5;
            hold();
            fake.wiring[0] = sound != 0 ? 1.0 : 0.0;
            TEST_ASSERT_EQUAL(0, move(2));
            fake_run_ms(ms);
            TEST_ASSERT_EQUAL(0, fake_enable(0, 0));
            fake_run_ms(100);
            TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault);
            TEST_ASSERT_EQUAL(sound != 0, (fake_status(0).flags & TL_WIRE_FLAG_REFERENCED) != 0);
        }
    }
}

static void test_an_encoder_lost_at_full_speed_leaves_no_position(void) {
    hold();
    TEST_ASSERT_EQUAL(0, move(10000));
    fake_run_ms(200);
    fake.shown = fake_encoder(&fake, 0);
    fake.stuck = true;
    TEST_ASSERT_TRUE(until_fault(100) <= 3U); // 50 counts at 16000 a second
    assert_fault(TL_WIRE_FAULT_STALL);
    TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_REFERENCED);
}

// Too slowly for its momentum to tell: another fault that comes after some milliseconds.
static void test_another_fault_while_nothing_is_seen_leaves_no_position(void) {
    for (int lost = 0; lost < 2; lost++) {
        fake_new(1);
        hold();
        const tl_wire_move_t slow = {
            .axis = 0, .q_q8 = COUNTS(10000), .speed_q8_s = COUNTS(400), .silence_us = 60000000};
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOVE, &slow));
        fake_run_ms(200);
        fake.shown = fake_encoder(&fake, 0);
        fake.stuck = lost != 0;
        fake.current_ma = 3000;
        TEST_ASSERT_INT_WITHIN(5, 12, (int)until_fault(20)); // its mean is above the limit
        assert_fault(TL_WIRE_FAULT_CURRENT);
        TEST_ASSERT_EQUAL(lost == 0, (fake_status(0).flags & TL_WIRE_FLAG_REFERENCED) != 0);
    }
}

static void test_an_encoder_lost_while_its_path_goes_to_and_fro_is_noticed(void) {
    fake_new(1);
    fake.position[0] = 0.5;
    hold();
    fake.wiring[0] = 0.0;
    uint32_t ms = 0;
    for (int i = 0; app.axes[0].fault == TL_WIRE_FAULT_NONE && ms < 2000U; i++, ms += 100U) {
        TEST_ASSERT_EQUAL(0, move(i % 2 == 0 ? 30 : -30)); // which never asks for one way as long as a stall takes
        fake_run_ms(100);
    }
    TEST_ASSERT_TRUE(ms <= 700U); // the drive rests for less than half of the time
    assert_fault(TL_WIRE_FAULT_STALL);
}

// As much friction as a check lets pass, at no load and at a heavy one: each count waits for the integral.
static void test_a_sound_motor_that_sticks_at_every_count_is_no_stall(void) {
    for (int load = -2; load <= 2; load++) {
        fake_new(1);
        fake.load = 0.2 * load;
        fake.friction = 0.115;
        hold();
        for (int i = 0; i < 60; i++) {
            TEST_ASSERT_EQUAL(0, move(i % 7 - i % 3));
            fake_run_ms(50U + 100U * (uint32_t)(i % 9));
        }
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault);
        TEST_ASSERT_TRUE((fake_status(0).flags & TL_WIRE_FLAG_REFERENCED) != 0);
    }
}

static void test_a_driver_that_chops_its_current_at_a_blocked_motor_is_a_stall(void) {
    hold();
    tl_wire_settings_t own = settings();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 0));
    fake_run_ms(5);
    own.current_ma = 0; // not watched
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
    hold();
    fake.blocked = true;
    fake.current_ma = FAKE_CHOP;
    fake_run_ms(350); // holding, its duty is nothing: only the current tells
    assert_fault(TL_WIRE_FAULT_STALL);
}

static void test_the_default_current_limit_is_below_the_drivers_own(void) {
    TEST_ASSERT_TRUE(settings().current_ma > FAKE_CHOP / 2 && settings().current_ma < FAKE_CHOP);
    tl_wire_settings_t of_another = tl_axis_default_settings(&(tl_port_t){.driver_ma = 425}, 0);
    TEST_ASSERT_TRUE(of_another.current_ma > 425 / 2 && of_another.current_ma < 425);
    tl_wire_limits_t limits = app.axes[0].limits;
    limits.current_ma = FAKE_CHOP + 1; // could never trip
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_LIMITS, &limits));
}

static void test_a_driver_fault_and_a_low_supply_are_faults_and_told(void) {
    hold();
    fake.driver_fault[0] = true;
    TEST_ASSERT_TRUE(until_fault(20) <= 10);
    assert_fault(TL_WIRE_FAULT_DRIVER);
    TEST_ASSERT_TRUE((fake_status(0).flags & TL_WIRE_FLAG_DRIVER_FAULT) != 0);
    fake.driver_fault[0] = false;
    TEST_ASSERT_EQUAL(0, ask_axis(TL_WIRE_CLEAR_FAULT));
    hold();
    fake.supply_mv = 3500;
    fake_run_ms(10); // a dip is none
    fake.supply_mv = 6000;
    fake_run_ms(10);
    TEST_ASSERT_EQUAL(6000, fake_status(0).supply_mv);
    fake.supply_mv = 3500;
    TEST_ASSERT_TRUE(until_fault(50) <= 25);
    assert_fault(TL_WIRE_FAULT_SUPPLY);
    TEST_ASSERT_EQUAL(3500, fake_status(0).fault_value);
}

static void test_gains_that_swing_the_drive_are_a_fault(void) {
    const tl_wire_servo_t wild = {.axis = 0, .proportional = 32767, .derivative = 32767};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SERVO, &wild));
    hold();
    TEST_ASSERT_EQUAL(0, move(50));
    TEST_ASSERT_TRUE(until_fault(2000) < 1000);
    assert_fault(TL_WIRE_FAULT_OSCILLATION);
}

// By proportional gain alone a motor without a winding settles within one count, where it brakes. A real one's current
// lags: by 0.2 ms (a bare motor of 6 V) to 2 ms; its inertia with the load's makes 20 ms, a heavy one's 300.
static void test_proportional_gain_alone_swings_at_full_duty_until_it_is_a_fault(void) {
    const double windings_s[] = {0.0002, 0.0005, 0.001, 0.002}, lags_s[] = {FAKE_LAG, 0.1, 0.3};
    for (unsigned i = 0; i < 12U; i++) {
        fake_new(1);
        fake.winding_s = windings_s[i % 4U];
        fake.lag_s = lags_s[i / 4U];
        const tl_wire_servo_t wild = {.axis = 0, .proportional = 32767};
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SERVO, &wild));
        hold();
        TEST_ASSERT_EQUAL(0, move(50));
        uint32_t full[2] = {0, 0}, steps = 0;
        while (app.axes[0].fault == TL_WIRE_FAULT_NONE && steps < 3U * FAKE_HZ) {
            fake_step();
            steps++;
            full[fake.duty[0] > 0] += abs(fake.duty[0]) >= 32767 ? 1U : 0U;
        }
        TEST_ASSERT_TRUE(full[0] > steps / 10U && full[1] > steps / 10U);
        assert_fault(TL_WIRE_FAULT_OSCILLATION);
    }
}

static void test_sound_gains_do_not_swing(void) {
    hold();
    for (int i = 0; i < 40; i++) { // as hard as the limits allow, there and back
        TEST_ASSERT_EQUAL(0, move(i % 2 == 0 ? 400 : -400));
        fake_run_ms(100);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault);
}

// -- arrival ----------------------------------------------------------------------------------------------------

static void test_a_move_arrives_where_the_motor_is_at_rest_at_its_target(void) {
    hold();
    fake.blocked = true;
    TEST_ASSERT_EQUAL(0, move(100));
    memset(heard_count, 0, sizeof(heard_count));
    for (int ms = 0; ms < 250; ms++) {
        fake_run_ms(1);
        TEST_ASSERT_EQUAL_MESSAGE(TL_WIRE_MODE_MOVE, app.axes[0].mode, "it has not moved");
    }
    fake_listen();
    TEST_ASSERT_EQUAL(0, heard_count[TL_WIRE_EVENT]);
    fake.blocked = false;
    for (int ms = 0; ms < 500 && app.axes[0].mode == TL_WIRE_MODE_MOVE; ms++) {
        fake_run_ms(1);
    }
    fake_listen();
    TEST_ASSERT_EQUAL(TL_WIRE_EVENT_ARRIVED, heard[TL_WIRE_EVENT].event.event);
    TEST_ASSERT_INT_WITHIN(4, 100, fake_status(0).q_q8 / TL_COUNT_ONE);
    TEST_ASSERT_TRUE(fake.speed[0] < 400.0 && fake.speed[0] > -400.0);
}

// -- reference --------------------------------------------------------------------------------------------------

static void test_nothing_that_goes_by_position_goes_without_a_reference(void) {
    app.axes[0].checked = true;
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_REFERENCED);
    const tl_wire_follow_t follow = {.axis = 0};
    const tl_wire_motion_start_t start = {.axis = 0,
                                          .cycles = 3,
                                          .low_q8 = COUNTS(-2000),
                                          .high_q8 = COUNTS(2000),
                                          .speed_q8_s = {COUNTS(700)},
                                          .transit_q8_s = COUNTS(2000),
                                          .acceleration_q8_s2 = COUNTS(20000),
                                          .approach_q8 = COUNTS(100),
                                          .stroke_max_q8 = COUNTS(800),
                                          .host_timeout_us = 200000};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NOT_REFERENCED, move(10));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NOT_REFERENCED, fake_ask(TL_WIRE_FOLLOW, &follow));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NOT_REFERENCED, fake_ask(TL_WIRE_MOTION_START, &start));
    fake_enable(0, 0);
    fake_run_ms(10);
    TEST_ASSERT_EQUAL(0, set_position(0)); // the host says where it is
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
}

static void test_a_lost_position_is_not_trusted_again(void) {
    for (int how = 0; how < 2; how++) {
        fake_new(2);
        hold();
        TEST_ASSERT_TRUE((fake_status(0).flags & TL_WIRE_FLAG_REFERENCED) != 0);
        if (how == 0) {
            fake.position[0] += 5000.0;
        } else {
            fake.slipped[0] = true;
        }
        fake_run_ms(3);
        assert_fault(how == 0 ? TL_WIRE_FAULT_ENCODER : TL_WIRE_FAULT_EDGES);
        TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_REFERENCED);
        TEST_ASSERT_EQUAL(0, ask_axis(TL_WIRE_CLEAR_FAULT));
        TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_REFERENCED);
    }
}

// The motor meets a wall at +-1000 counts.
static void run_between_walls(uint32_t ms) {
    for (uint32_t i = 0; i < ms * FAKE_HZ / 1000U; i++) {
        fake_step();
        const double at = fake.position[0] > 1000.0 ? 1000.0 : -1000.0;
        if (fake.position[0] > 1000.0 || fake.position[0] < -1000.0) {
            fake.position[0] = at;
            fake.speed[0] = 0.0;
        }
        TEST_ASSERT_TRUE_MESSAGE(abs(fake.duty[0]) <= app.axes[0].settings.low_duty_q15,
                                 "low drive, until it is known");
    }
}

static void test_homing_finds_the_end_at_low_drive_and_is_referenced(void) {
    for (int8_t direction = -1; direction <= 1; direction = (int8_t)(direction + 2)) {
        fake_new(2);
        app.axes[0].checked = true;
        fake_enable(0, 1);
        TEST_ASSERT_EQUAL(0, home(direction, 5000, 200));
        run_between_walls(3000);
        fake_listen();
        TEST_ASSERT_EQUAL(TL_WIRE_EVENT_HOMED, heard[TL_WIRE_EVENT].event.event);
        const tl_wire_status_t status = fake_status(0);
        TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, status.mode);
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, status.fault);
        TEST_ASSERT_TRUE((status.flags & TL_WIRE_FLAG_REFERENCED) != 0);
        // The wall is 3000 by request; true position and position agree from there on.
        TEST_ASSERT_INT_WITHIN(4, direction * 2800, status.q_q8 / TL_COUNT_ONE);
        TEST_ASSERT_INT_WITHIN(6, direction * 800, (int)fake.position[0]);
        TEST_ASSERT_EQUAL(0, move(direction * 2500));
    }
}

static void test_homing_gives_up_where_no_end_comes(void) {
    app.axes[0].checked = true;
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL(0, home(1, 500, 0));
    until_fault(3000);
    assert_fault(TL_WIRE_FAULT_NO_END);
    TEST_ASSERT_TRUE(fake.position[0] < 700.0);
    TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_REFERENCED);
}

static void test_a_jog_needs_no_reference_and_is_weak(void) {
    app.axes[0].checked = true;
    fake_enable(0, 1);
    const tl_wire_jog_t jog = {.axis = 0, .way_q8 = COUNTS(300), .silence_us = 60000000};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_JOG, &jog));
    run_between_walls(1000);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
    TEST_ASSERT_INT_WITHIN(5, 300, (int)fake.position[0]);
    TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_REFERENCED);
}

// The greatest speed of the path until it rests, as a share of what the settings allow.
static double greatest_speed(void) {
    int32_t most = 0;
    for (int ms = 0; ms < 5000 && app.axes[0].mode != TL_WIRE_MODE_HOLD && app.axes[0].fault == 0; ms++) {
        const int32_t speed = abs(app.axes[0].plan.reference.velocity);
        most = speed > most ? speed : most;
        fake_run_ms(1);
    }
    return (double)most / app.axes[0].plan.travel.speed;
}

static void test_jogs_and_homing_go_at_half_the_speed_at_most(void) {
    app.axes[0].checked = true;
    fake_enable(0, 1);
    tl_wire_limits_t limits = app.axes[0].limits;
    limits.speed_q8_s = COUNTS(4000); // which low drive brings about
    limits.acceleration_q8_s2 = COUNTS(20000);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    tl_wire_jog_t jog = {.axis = 0, .way_q8 = COUNTS(1000), .silence_us = 60000000};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_JOG, &jog));
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.1, greatest_speed());
    jog.speed_q8_s = COUNTS(16000);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_JOG, &jog));
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.5, greatest_speed());
    const tl_wire_home_t homing = {
        .axis = 0, .direction = 1, .reach_q8 = COUNTS(2000), .speed_q8_s = COUNTS(16000), .silence_us = 60000000};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_HOME, &homing));
    TEST_ASSERT_DOUBLE_WITHIN(0.01, 0.5, greatest_speed());
}

// A path that goes away from what the integral pushes towards: the drive never saturates, and the integral still ends
// at the limit.
static void test_the_integral_is_no_more_than_the_drive_may_be(void) {
    static tl_servo_t servo;
    const tl_servo_gains_t gains = {.integral = 30000, .feed_forward = 8000};
    const tl_duty_q15_t limit = 8192;
    TEST_ASSERT_TRUE(tl_servo_configure(&servo, &gains, FAKE_HZ));
    tl_servo_reset(&servo, 0);
    tl_path_t path;
    tl_path_init(&path, COUNTS(50), 5);
    for (int tick = 0; tick < 20000; tick++) {
        if (tick % 5 == 0) {
            path.speed = -(int32_t)((3000LL << 24) / FAKE_HZ); // counts a tick Q24
            tl_servo_feed(&servo, &path);
        }
        (void)tl_servo_step(&servo, 0, &path, limit);
        TEST_ASSERT_TRUE(servo.integral <= limit << 14);
    }
    TEST_ASSERT_EQUAL(limit << 14, servo.integral);
}

// -- check of motor and encoder ---------------------------------------------------------------------------------

static void test_the_first_enable_checks_motor_and_encoder_at_low_drive(void) {
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_CHECK, fake_status(0).mode);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BUSY, move(100));
    run_between_walls(700);
    fake_listen();
    TEST_ASSERT_EQUAL(TL_WIRE_EVENT_CHECKED, heard[TL_WIRE_EVENT].event.event);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
    fake_enable(0, 0);
    fake_run_ms(10);
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL_MESSAGE(TL_WIRE_MODE_HOLD, fake_status(0).mode, "once is enough");
    fake_enable(0, 0);
    fake_run_ms(10);
    const tl_wire_settings_t own = settings();
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own)); // until they change
    fake_enable(0, 1);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_CHECK, fake_status(0).mode);
}

static void check_with(double wiring, tl_wire_fault_t fault) {
    fake_new(2);
    fake.wiring[0] = wiring;
    TEST_ASSERT_EQUAL(0, set_position(0));
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    run_between_walls(1500);
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(fault, status.fault);
    TEST_ASSERT_EQUAL(fault == TL_WIRE_FAULT_NONE ? TL_WIRE_MODE_HOLD : TL_WIRE_MODE_OFF, status.mode);
    TEST_ASSERT_EQUAL(fault == TL_WIRE_FAULT_NONE, (status.flags & TL_WIRE_FLAG_REFERENCED) != 0);
}

static void test_swapped_wires_a_dead_encoder_and_a_wrong_scale_are_told_apart(void) {
    check_with(1.0, TL_WIRE_FAULT_NONE);
    check_with(-1.0, TL_WIRE_FAULT_REVERSED);
    check_with(0.0, TL_WIRE_FAULT_UNMOVED);
    check_with(0.125, TL_WIRE_FAULT_SCALE);
    check_with(8.0, TL_WIRE_FAULT_SCALE);
    check_with(2.0, TL_WIRE_FAULT_NONE); // a load, or a weak supply
    fake_new(2);
    fake.blocked = true;
    fake_enable(0, 1);
    until_fault(2000);
    assert_fault(TL_WIRE_FAULT_UNMOVED);
}

static void test_a_check_beside_a_wall_goes_by_the_free_way(void) {
    fake_new(2);
    fake.position[0] = 995.0;
    fake_enable(0, 1);
    run_between_walls(1500);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
}

// -- settings ---------------------------------------------------------------------------------------------------

static void test_settings_outlive_the_power_and_no_host_widens_them(void) {
    tl_wire_settings_t own = settings();
    own.q_high_q8 = COUNTS(1000);
    own.duty_q15 = 20000;
    own.proportional = 700;
    memcpy(own.instrument, "SN-0042", 7);
    own.key = 1;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_KEY, fake_ask(TL_WIRE_SETTINGS, &own));
    own.key = TL_WIRE_KEY;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
    TEST_ASSERT_EQUAL(TL_WIRE_STORE_NEWEST, fake_status(0).settings);
    fake_start(2, TL_WIRE_BOOT_POWER);
    TEST_ASSERT_EQUAL(TL_WIRE_STORE_NEWEST, fake_status(0).settings);
    const tl_wire_settings_t read = settings();
    uint8_t frames[2][TL_WIRE_FRAME_MAX];
    const size_t size = tl_wire_frame(frames[0], TL_WIRE_SETTINGS, 0, &own);
    tl_wire_frame(frames[1], TL_WIRE_SETTINGS, 0, &read);
    TEST_ASSERT_EQUAL_MEMORY(frames[0], frames[1], size);
    TEST_ASSERT_EQUAL(700, app.axes[0].motor.servo.gains.proportional);
    TEST_ASSERT_EQUAL(32768, app.axes[1].limits.duty_q15); // the other axis has its own
    const tl_wire_limits_t held = app.axes[0].limits;
    tl_wire_limits_t wider = held;
    wider.q_high_q8 = COUNTS(1001);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_SETTINGS, fake_ask(TL_WIRE_LIMITS, &wider));
    wider = held;
    wider.duty_q15 = 20001;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_SETTINGS, fake_ask(TL_WIRE_LIMITS, &wider));
    wider = held;
    wider.current_ma = 0; // not watched is wider than any limit
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_SETTINGS, fake_ask(TL_WIRE_LIMITS, &wider));
    wider = held;
    wider.following_error_q8++;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_SETTINGS, fake_ask(TL_WIRE_LIMITS, &wider));
    tl_wire_limits_t narrower = held;
    narrower.q_high_q8 = COUNTS(500);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &narrower));
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &held)); // and back
}

static void test_a_power_cut_while_settings_are_written_leaves_the_old_or_the_new(void) {
    for (unsigned pattern = 0; pattern < 4U; pattern++) {
        for (uint32_t cut = 1; cut <= 4U; cut++) {
            fake_new(2);
            tl_wire_settings_t own = settings();
            own.stall_ms = 111;
            TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
            own.stall_ms = 222;
            fake.operations = 0;
            fake.cut_at = cut;
            fake.cut_pattern = pattern;
            const int done = fake_ask(TL_WIRE_SETTINGS, &own);
            fake_start(2, TL_WIRE_BOOT_POWER);
            const uint16_t found = settings().stall_ms;
            TEST_ASSERT_TRUE(found == 222 || (found == 111 && done != 0));
            TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault);
        }
    }
}

static void test_damaged_settings_are_a_fault(void) {
    tl_wire_settings_t own = settings();
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
    fake.flash[2U * TL_WIRE_AXES_MAX * TL_PORT_FLASH_SECTOR + TL_PORT_FLASH_PAGE + 20U] ^= 4U;
    fake_start(2, TL_WIRE_BOOT_POWER);
    assert_fault(TL_WIRE_FAULT_SETTINGS);
    TEST_ASSERT_EQUAL(TL_WIRE_STORE_BAD, fake_status(0).settings);
}

// -- the host leaves --------------------------------------------------------------------------------------------

static void test_a_move_ends_when_the_host_is_silent_or_gone(void) {
    for (int how = 0; how < 3; how++) {
        fake_new(2);
        hold();
        tl_wire_limits_t slow = app.axes[0].limits;
        slow.speed_q8_s = COUNTS(2000);
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &slow));
        const tl_wire_move_t far = {.axis = 0, .q_q8 = COUNTS(100000), .silence_us = how == 0 ? 0U : 200000U};
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOVE, &far));
        for (int i = 0; i < 20; i++) { // heard from: it goes on
            fake_run_ms(how == 0 ? 900 : 100);
            TEST_ASSERT_EQUAL(TL_WIRE_MODE_MOVE, fake_status(0).mode);
        }
        if (how == 2) {
            tl_app_bus(&app, false);
        }
        const double before = fake.position[0];
        fake_run_ms(how == 0 ? 1200 : (how == 1 ? 400 : 200));
        TEST_ASSERT_TRUE(fake.position[0] - before < (how == 0 ? 2300.0 : (how == 1 ? 600.0 : 100.0)));
        if (how == 2) {
            tl_app_bus(&app, true);
        }
        assert_fault(TL_WIRE_FAULT_HOST_LOST);
        TEST_ASSERT_TRUE(fake.speed[0] < 1.0);
        TEST_ASSERT_TRUE((fake_status(0).flags & TL_WIRE_FLAG_REFERENCED) != 0); // the position is still known
    }
}

static void test_homing_and_checks_end_with_the_host_too(void) {
    const tl_wire_home_t homing = {
        .axis = 0, .direction = 1, .reach_q8 = COUNTS(100000), .end_q8 = COUNTS(3000), .silence_us = 200000};
    for (int how = 0; how < 3; how++) { // gone while it checks and while it homes; silent while it homes
        fake_new(2);
        app.axes[0].checked = how > 0;
        fake_enable(0, 1);
        TEST_ASSERT_TRUE(how == 0 || fake_ask(TL_WIRE_HOME, &homing) == 0);
        fake_run_ms(100);
        TEST_ASSERT_EQUAL(how > 0 ? TL_WIRE_MODE_HOME : TL_WIRE_MODE_CHECK, app.axes[0].mode);
        if (how < 2) {
            tl_app_bus(&app, false);
        }
        fake_run_ms(how < 2 ? 100 : 250);
        tl_app_bus(&app, true);
        assert_fault(TL_WIRE_FAULT_HOST_LOST);
    }
}

// A tendon pulls at the motor; its host says nothing any more.
static void test_a_motor_that_holds_alone_lets_go_slowly(void) {
    for (int speaks = 0; speaks < 2; speaks++) {
        fake_new(1);
        fake.load = 0.3;
        fake.friction = 0.02;
        hold();
        const tl_wire_ping_t ping = {.host_us = 0};
        for (int second = 0; second < 59; second++) {
            fake_run_ms(1000);
            TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, app.axes[0].mode);
            TEST_ASSERT_TRUE(speaks != 1 || fake_ask(TL_WIRE_PING, &ping) == -1);
        }
        const int held = fake.duty[0];
        TEST_ASSERT_INT_WITHIN(1500, 9830, held); // 30 %
        fake_run_ms(900);
        TEST_ASSERT_INT_WITHIN(300, held, fake.duty[0]);
        int before = fake.duty[0];
        uint32_t ms = 0;
        for (; app.axes[0].fault == TL_WIRE_FAULT_NONE && ms < 3000; ms++) {
            fake_run_ms(1);
            TEST_ASSERT_TRUE_MESSAGE(before - fake.duty[0] <= (speaks == 1 ? 300 : held / 500),
                                     "never a sudden release");
            before = fake.duty[0];
        }
        if (speaks == 1) {
            TEST_ASSERT_EQUAL(3000, ms);
            TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, app.axes[0].mode);
            continue;
        }
        TEST_ASSERT_INT_WITHIN(150, 1000, (int)ms);
        TEST_ASSERT_TRUE(app.axes[0].silent);
        assert_fault(TL_WIRE_FAULT_HOST_LOST);
    }
}

static void test_how_long_it_holds_alone_is_a_setting(void) {
    tl_wire_settings_t own = settings();
    TEST_ASSERT_EQUAL(60000, own.hold_ms);
    own.hold_ms = TL_AXIS_HOLD_MAX_MS + 1U;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_SETTINGS, &own));
    own.hold_ms = 2000;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
    hold();
    fake_run_ms(1900);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, app.axes[0].mode);
    fake_run_ms(1200);
    assert_fault(TL_WIRE_FAULT_HOST_LOST);
    own.hold_ms = 0;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_CLEAR_FAULT, &own));
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
    hold();
    fake_run_ms(200000);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, app.axes[0].mode);
}

// Settings that firmware stored before the last of them were there are in force all the same: of protocol 2.3 without
// commissioned, a byte, of 2.2 without group and estop, two more, of 2.1 without hold_ms, four more. Commissioned is
// then who has a range: nobody else had one stored.
static void test_settings_of_earlier_firmware_are_read(void) {
    static const size_t lacks[] = {1U, 3U, 7U};
    for (unsigned era = 0; era < 3U; era++) {
        const size_t size = TL_WIRE_HEADER_SIZE + TL_WIRE_SIZE_SETTINGS + TL_WIRE_CRC_SIZE - lacks[era];
        uint8_t blob[TL_WIRE_AXES_MAX * TL_WIRE_FRAME_MAX];
        for (uint8_t i = 0; i < TL_WIRE_AXES_MAX; i++) {
            tl_wire_settings_t own = tl_axis_default_settings(&fake_port, i);
            own.stall_ms = 222;
            own.hold_ms = 5000;
            own.q_low_q8 = i == 0U ? COUNTS(-700) : own.q_low_q8;
            own.group = 3;
            own.estop = TL_WIRE_ESTOP_OPEN;
            uint8_t frame[TL_WIRE_FRAME_MAX];
            tl_wire_frame(frame, TL_WIRE_SETTINGS, 0, &own);
            memcpy(blob + i * size, frame, size - TL_WIRE_CRC_SIZE);
            memset(blob + (i + 1U) * size - TL_WIRE_CRC_SIZE, 0xA5, TL_WIRE_CRC_SIZE); // the slot has its own
        }
        TEST_ASSERT_TRUE(tl_store_write(&fake_port, TL_STORE_SETTINGS, 0U, blob, (uint16_t)(TL_WIRE_AXES_MAX * size)));
        fake_start(2, TL_WIRE_BOOT_POWER);
        TEST_ASSERT_EQUAL(TL_WIRE_STORE_NEWEST, fake_status(0).settings);
        const tl_wire_settings_t read = settings();
        TEST_ASSERT_EQUAL(222, read.stall_ms);
        TEST_ASSERT_EQUAL(era < 2U ? 5000 : 60000, read.hold_ms);
        TEST_ASSERT_EQUAL(era < 1U ? 3 : 0, read.group);
        TEST_ASSERT_EQUAL(era < 1U ? TL_WIRE_ESTOP_OPEN : TL_WIRE_ESTOP_CLOSED, read.estop);
        TEST_ASSERT_TRUE((fake_status(0).flags & TL_WIRE_FLAG_COMMISSIONED) != 0);
        TEST_ASSERT_FALSE((fake_status(1).flags & TL_WIRE_FLAG_COMMISSIONED) != 0);
    }
}

// Nobody has told a board as it comes which motor hangs on it, nor how far that may go.
static void test_a_motor_that_nobody_commissioned_is_weak_and_slow(void) {
    fake_start(1, TL_WIRE_BOOT_POWER); // nothing is stored
    const tl_wire_settings_t fresh = settings();
    TEST_ASSERT_EQUAL(0, fresh.commissioned);
    TEST_ASSERT_EQUAL(0, fake_status(0).flags & TL_WIRE_FLAG_COMMISSIONED);
    TEST_ASSERT_TRUE(fresh.low_duty_q15 <= TL_RATIO_ONE / 4);
    tl_wire_limits_t wider = app.axes[0].limits;
    wider.duty_q15++;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_SETTINGS, fake_ask(TL_WIRE_LIMITS, &wider));
    hold();
    TEST_ASSERT_EQUAL(0, move(3000));
    double fastest = 0.0;
    for (uint32_t ms = 0; ms < 3000U && app.axes[0].mode == TL_WIRE_MODE_MOVE; ms++) {
        fake_run_ms(1);
        fastest = fake.speed[0] > fastest ? fake.speed[0] : fastest;
        TEST_ASSERT_TRUE(abs(fake.duty[0]) <= fresh.low_duty_q15);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[0].fault); // and what it may, it can follow
    TEST_ASSERT_DOUBLE_WITHIN(10.0, 3000.0, fake.position[0]);
    TEST_ASSERT_TRUE(fastest < 0.25 * FAKE_SPEED);
    TEST_ASSERT_EQUAL(0, fake_enable(0, 0));
    fake_run_ms(10);
    tl_wire_settings_t own = fresh;
    own.commissioned = 2U;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_SETTINGS, &own));
    own.commissioned = 1U;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
    TEST_ASSERT_EQUAL(fresh.duty_q15, app.axes[0].limits.duty_q15);
    TEST_ASSERT_EQUAL(fresh.speed_q8_s, app.axes[0].limits.speed_q8_s);
    fake_start(1, TL_WIRE_BOOT_POWER);
    TEST_ASSERT_TRUE((fake_status(0).flags & TL_WIRE_FLAG_COMMISSIONED) != 0);
}

// -- the encoder while nobody looks -----------------------------------------------------------------------------

static void test_a_motor_turned_by_hand_during_an_erase_is_no_fault(void) {
    TEST_ASSERT_EQUAL(0, set_position(100));
    fake.t_us += 100000; // an erase: no control step comes
    fake.position[0] += 3000.0;
    fake_run_ms(5);
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, status.fault);
    TEST_ASSERT_INT_WITHIN(1, 3100, status.q_q8 / TL_COUNT_ONE);
    TEST_ASSERT_TRUE((status.flags & TL_WIRE_FLAG_REFERENCED) != 0);
    fake.t_us += 1000;
    fake.position[0] += 4000.0; // in a millisecond nothing turns so far
    fake_run_ms(5);
    assert_fault(TL_WIRE_FAULT_ENCODER);
    TEST_ASSERT_EQUAL(4000, fake_status(0).fault_value);
}

// -- tables -----------------------------------------------------------------------------------------------------

static void test_a_refused_table_leaves_the_one_in_use(void) {
    static uint8_t good[TL_TABLE_SIZE_MAX], bad[TL_TABLE_SIZE_MAX];
    const uint16_t size = fake_table(good, 0, 1);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, good, size));
    const tl_deg_q16_t before = tl_lookup_angle(&app.axes[0].tip.lookup, 1000, &(uint32_t){0});
    memcpy(bad, good, sizeof(bad));
    bad[200] ^= 1U;
    fake.operations = 0;
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, bad, size));
    TEST_ASSERT_EQUAL(0, fake.operations); // flash was not touched, nor read again
    tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(TL_WIRE_TABLE_NEWEST, status.table);
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_CRC, status.table_reason);
    TEST_ASSERT_EQUAL(before, tl_lookup_angle(&app.axes[0].tip.lookup, 1000, &(uint32_t){0}));
    uint8_t read[TL_TABLE_SIZE_MAX];
    TEST_ASSERT_EQUAL(size, tl_app_table_read(&app, 0, 0, read, sizeof(read)));
    TEST_ASSERT_EQUAL_MEMORY(good, read, size);
    // Flash that fails leaves it in use, too.
    static uint8_t other[TL_TABLE_SIZE_MAX];
    fake_table(other, 0, 2);
    fake.cut_at = fake.operations + 1U;
    fake.cut_pattern = 2;
    TEST_ASSERT_EQUAL(TL_UPLOAD_FLASH, fake_upload(0, other, size));
    TEST_ASSERT_TRUE(app.axes[0].has_table);
    TEST_ASSERT_EQUAL(1, app.axes[0].tip.lookup.table.created_s);
}

static void test_a_table_for_another_instrument_is_refused_unless_any_will_do(void) {
    tl_wire_settings_t own = settings();
    memcpy(own.instrument, "SN-0042", 8);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    static tl_table_t table;
    const uint16_t size = fake_table(blob, 0, 1);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size)); // it does not say
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_table_decode(blob, size, 0, &table));
    memcpy(table.instrument, "SN-0043", 8);
    tl_table_encode(&table, blob, sizeof(blob));
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, blob, size));
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_INSTRUMENT, fake_status(0).table_reason);
    TEST_ASSERT_EQUAL(0, ask_axis(TL_WIRE_ANY_TABLE));
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, blob, size)); // once
    memcpy(table.instrument, "SN-0042", 8);
    tl_table_encode(&table, blob, sizeof(blob));
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_motor_blocked_near_its_target_faults_within_the_stall_time);
    RUN_TEST(test_an_encoder_lost_next_to_its_target_is_noticed_and_its_position_not_trusted);
    RUN_TEST(test_an_encoder_lost_just_before_switching_off_leaves_no_position);
    RUN_TEST(test_an_encoder_lost_next_to_its_target_leaves_no_position_when_switched_off);
    RUN_TEST(test_an_encoder_lost_at_full_speed_leaves_no_position);
    RUN_TEST(test_another_fault_while_nothing_is_seen_leaves_no_position);
    RUN_TEST(test_an_encoder_lost_while_its_path_goes_to_and_fro_is_noticed);
    RUN_TEST(test_a_sound_motor_that_sticks_at_every_count_is_no_stall);
    RUN_TEST(test_a_driver_that_chops_its_current_at_a_blocked_motor_is_a_stall);
    RUN_TEST(test_the_default_current_limit_is_below_the_drivers_own);
    RUN_TEST(test_a_driver_fault_and_a_low_supply_are_faults_and_told);
    RUN_TEST(test_gains_that_swing_the_drive_are_a_fault);
    RUN_TEST(test_proportional_gain_alone_swings_at_full_duty_until_it_is_a_fault);
    RUN_TEST(test_sound_gains_do_not_swing);
    RUN_TEST(test_a_move_arrives_where_the_motor_is_at_rest_at_its_target);
    RUN_TEST(test_nothing_that_goes_by_position_goes_without_a_reference);
    RUN_TEST(test_a_lost_position_is_not_trusted_again);
    RUN_TEST(test_homing_finds_the_end_at_low_drive_and_is_referenced);
    RUN_TEST(test_homing_gives_up_where_no_end_comes);
    RUN_TEST(test_a_jog_needs_no_reference_and_is_weak);
    RUN_TEST(test_jogs_and_homing_go_at_half_the_speed_at_most);
    RUN_TEST(test_the_integral_is_no_more_than_the_drive_may_be);
    RUN_TEST(test_the_first_enable_checks_motor_and_encoder_at_low_drive);
    RUN_TEST(test_swapped_wires_a_dead_encoder_and_a_wrong_scale_are_told_apart);
    RUN_TEST(test_a_check_beside_a_wall_goes_by_the_free_way);
    RUN_TEST(test_settings_outlive_the_power_and_no_host_widens_them);
    RUN_TEST(test_a_power_cut_while_settings_are_written_leaves_the_old_or_the_new);
    RUN_TEST(test_damaged_settings_are_a_fault);
    RUN_TEST(test_a_move_ends_when_the_host_is_silent_or_gone);
    RUN_TEST(test_homing_and_checks_end_with_the_host_too);
    RUN_TEST(test_a_motor_that_holds_alone_lets_go_slowly);
    RUN_TEST(test_how_long_it_holds_alone_is_a_setting);
    RUN_TEST(test_settings_of_earlier_firmware_are_read);
    RUN_TEST(test_a_motor_that_nobody_commissioned_is_weak_and_slow);
    RUN_TEST(test_a_motor_turned_by_hand_during_an_erase_is_no_fault);
    RUN_TEST(test_a_refused_table_leaves_the_one_in_use);
    RUN_TEST(test_a_table_for_another_instrument_is_refused_unless_any_will_do);
    return UNITY_END();
}
