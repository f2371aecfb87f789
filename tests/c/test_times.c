// What docs/safety.md says in milliseconds and as defaults, to the millisecond.
#include "fake_board.h"

#include <math.h>

void setUp(void) {
    fake_new(1);
    fake_ready();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    fake_run_ms(50);
}
void tearDown(void) {}

static tl_axis_t *const axis = &app.axes[0];

static uint32_t until(tl_wire_fault_t fault, uint32_t most_ms) {
    uint32_t ms = 0;
    while (axis->fault == TL_WIRE_FAULT_NONE && ms < most_ms) {
        fake_run_ms(1);
        ms++;
    }
    TEST_ASSERT_EQUAL(fault, axis->fault);
    return ms;
}

static void test_the_defaults(void) {
    const tl_wire_settings_t own = tl_axis_default_settings(&fake_port, 0);
    TEST_ASSERT_EQUAL(300, own.stall_ms);
    TEST_ASSERT_EQUAL(4 * 256, own.arrive_q8);
    TEST_ASSERT_EQUAL(60000, own.hold_ms);
    TEST_ASSERT_EQUAL(FAKE_CHOP * 15 / 16, own.current_ma);
    TEST_ASSERT_EQUAL(4000, own.supply_low_mv); // the port's
    TEST_ASSERT_EQUAL(300 * 256, own.following_error_q8);
    TEST_ASSERT_EQUAL(32768, own.duty_q15);
    TEST_ASSERT_EQUAL(8192, own.low_duty_q15); // a fourth
    TEST_ASSERT_EQUAL(0, own.commissioned);
    TEST_ASSERT_EQUAL(0, own.group);
}

// Looked at once a millisecond: it has been ill in each of the last five, or twenty.
static void test_a_driver_is_ill_for_five_milliseconds(void) {
    fake.driver_fault[0] = true;
    fake_run_ms(4);
    fake.driver_fault[0] = false;
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, axis->fault);
    fake.driver_fault[0] = true;
    TEST_ASSERT_EQUAL(5, until(TL_WIRE_FAULT_DRIVER, 20));
}

static void test_a_supply_is_low_for_twenty(void) {
    fake.supply_mv = 3999;
    fake_run_ms(19);
    fake.supply_mv = 4000; // is enough
    fake_run_ms(50);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, axis->fault);
    fake.supply_mv = 3999;
    TEST_ASSERT_EQUAL(20, until(TL_WIRE_FAULT_SUPPLY, 60));
}

// mean += (|I| - mean) / 20 in each millisecond.
static void test_the_current_s_mean_is_of_first_order_over_twenty(void) {
    static const int32_t currents[] = {500, 0, -800, 100, 0};
    double mean = axis->guard.current_mean_q8 / 256.0;
    for (unsigned i = 0; i < sizeof currents / sizeof currents[0]; i++) {
        fake.current_ma = currents[i];
        for (uint32_t ms = 0; ms < 60U; ms++) {
            mean += (abs(currents[i]) - mean) / 20.0;
            fake_run_ms(1);
            TEST_ASSERT_DOUBLE_WITHIN(0.5, mean, axis->guard.current_mean_q8 / 256.0);
            TEST_ASSERT_EQUAL(currents[i], axis->guard.current_ma);
        }
    }
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, axis->fault);
}

// At I the mean passes the limit L after ln(1 - L / I) / ln(19 / 20) milliseconds.
static void test_a_current_is_too_much_where_its_mean_is(void) {
    fake_run_ms(300);
    axis->limits.current_ma = 700;
    fake.current_ma = 1000;
    TEST_ASSERT_EQUAL(ceil(log(1.0 - 0.7) / log(0.95)), until(TL_WIRE_FAULT_CURRENT, 100));
    TEST_ASSERT_INT_WITHIN(15, 708, axis->guard.fault_value);
}

// A move is there once it has been at its target, at rest, for ten.
static void test_a_move_has_arrived_after_ten_milliseconds_of_rest(void) {
    const tl_wire_move_t move = {.q_q8 = 300 * TL_COUNT_ONE};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOVE, &move));
    uint32_t still = 0;
    for (uint32_t ms = 0; ms < 2000U && axis->mode == TL_WIRE_MODE_MOVE; ms++) {
        const bool there = axis->path.q == move.q_q8 && axis->plan.reference.velocity == 0 &&
                           abs(axis->q - move.q_q8) <= axis->settings.arrive_q8;
        still = there ? still + 1U : 0U;
        fake_run_ms(1);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, axis->mode);
    TEST_ASSERT_INT_WITHIN(1, 10, still);
}

// Whatever was under way: a motor that is off has no calibration, no set-points and no drive.
static void test_off_forgets_what_was_under_way(void) {
    const tl_wire_motion_start_t start = fake_calibration();
    for (int end = 0; end < 2; end++) {
        setUp();
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
        fake_run_ms(100);
        TEST_ASSERT_NOT_NULL(axis->plan.motion);
        if (end == 0) {
            const tl_wire_safe_stop_t stop = {.axis = 0};
            TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SAFE_STOP, &stop));
            TEST_ASSERT_EQUAL(0, fake.duty[0]);
            TEST_ASSERT_FALSE(axis->closed);
        } else {
            TEST_ASSERT_EQUAL(0, fake_enable(0, 0));
        }
        TEST_ASSERT_NULL(axis->plan.motion);
        TEST_ASSERT_EQUAL(0, axis->plan.stream.used);
        TEST_ASSERT_EQUAL(0, axis->trial.duty);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_defaults);
    RUN_TEST(test_a_driver_is_ill_for_five_milliseconds);
    RUN_TEST(test_a_supply_is_low_for_twenty);
    RUN_TEST(test_the_current_s_mean_is_of_first_order_over_twenty);
    RUN_TEST(test_a_current_is_too_much_where_its_mean_is);
    RUN_TEST(test_a_move_has_arrived_after_ten_milliseconds_of_rest);
    RUN_TEST(test_off_forgets_what_was_under_way);
    return UNITY_END();
}
