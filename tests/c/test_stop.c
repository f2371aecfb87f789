// What stops axes that are well themselves: an antagonist's fault, and the stop input.
#include "fake_board.h"

#include "tautline/tl_axis_ask.h"

enum { AXES = 3 };

void setUp(void) {
    fake_new(AXES);
}
void tearDown(void) {}

static tl_wire_settings_t settings(uint8_t axis) {
    const tl_wire_get_settings_t request = {.axis = axis};
    fake_ask(TL_WIRE_GET_SETTINGS, &request);
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_SETTINGS]);
    heard[TL_WIRE_SETTINGS].settings.key = TL_WIRE_KEY;
    return heard[TL_WIRE_SETTINGS].settings;
}

static int store(uint8_t axis, uint8_t group, uint8_t estop) {
    tl_wire_settings_t own = settings(axis);
    own.group = group;
    own.estop = estop;
    return fake_ask(TL_WIRE_SETTINGS, &own);
}

static int clear(uint8_t axis) {
    const tl_wire_clear_fault_t request = {.axis = axis};
    return fake_ask(TL_WIRE_CLEAR_FAULT, &request);
}

static void all_hold(void) {
    fake_ready();
    for (uint8_t i = 0; i < AXES; i++) {
        TEST_ASSERT_EQUAL(0, fake_enable(i, 1));
    }
}

// Off, its bridge too, with this fault and value.
static void assert_off(uint8_t axis, uint8_t fault, int32_t value) {
    const tl_wire_status_t status = fake_status(axis);
    TEST_ASSERT_EQUAL(fault, status.fault);
    TEST_ASSERT_EQUAL(value, status.fault_value);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, status.mode);
    TEST_ASSERT_EQUAL(0, fake.duty[axis]);
}

static void move_all(void) {
    for (uint8_t i = 0; i < AXES; i++) {
        const tl_wire_move_t request = {.axis = i, .q_q8 = 4000 * TL_COUNT_ONE, .silence_us = 60000000};
        TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOVE, &request));
    }
    fake_run_ms(100);
    for (uint8_t i = 0; i < AXES; i++) {
        TEST_ASSERT_EQUAL(TL_WIRE_MODE_MOVE, app.axes[i].mode);
        TEST_ASSERT_TRUE(fake.duty[i] > 0);
    }
}

static void test_an_axis_takes_its_group_with_it(void) {
    for (uint8_t faulty = 0; faulty < AXES; faulty++) {
        fake_new(AXES);
        const uint8_t mate = (uint8_t)((faulty + 1U) % AXES), other = (uint8_t)((faulty + 2U) % AXES);
        TEST_ASSERT_EQUAL(0, store(faulty, 2, TL_WIRE_ESTOP_CLOSED));
        TEST_ASSERT_EQUAL(0, store(mate, 2, TL_WIRE_ESTOP_CLOSED));
        TEST_ASSERT_EQUAL(0, store(other, faulty == 0 ? 0 : 4, TL_WIRE_ESTOP_CLOSED)); // none, or one of its own
        all_hold();
        move_all();
        fake.driver_fault[faulty] = true;
        fake_run_ms(5 + 3); // DRIVER_MS, and each axis looks once a millisecond
        assert_off(faulty, TL_WIRE_FAULT_DRIVER, 0);
        assert_off(mate, TL_WIRE_FAULT_GROUP, faulty);
        TEST_ASSERT_EQUAL(TL_WIRE_MODE_MOVE, fake_status(other).mode);
    }
}

static void test_every_axis_of_a_group_names_the_first_that_failed(void) {
    for (uint8_t i = 0; i < AXES; i++) {
        TEST_ASSERT_EQUAL(0, store(i, 1, TL_WIRE_ESTOP_CLOSED));
    }
    all_hold();
    fake.driver_fault[1] = true;
    fake_run_ms(20);
    assert_off(0, TL_WIRE_FAULT_GROUP, 1);
    assert_off(1, TL_WIRE_FAULT_DRIVER, 0);
    assert_off(2, TL_WIRE_FAULT_GROUP, 1);
}

static void test_axes_without_a_group_are_apart(void) {
    all_hold();
    fake.driver_fault[1] = true;
    fake_run_ms(20);
    assert_off(1, TL_WIRE_FAULT_DRIVER, 0);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(2).mode);
}

static void test_a_fault_that_is_cleared_at_once_takes_its_group_all_the_same(void) {
    TEST_ASSERT_EQUAL(0, store(0, 1, TL_WIRE_ESTOP_CLOSED));
    TEST_ASSERT_EQUAL(0, store(1, 1, TL_WIRE_ESTOP_CLOSED));
    all_hold();
    const tl_wire_safe_stop_t stop = {.axis = 1};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SAFE_STOP, &stop));
    TEST_ASSERT_EQUAL(0, clear(1));
    fake_run_ms(3);
    assert_off(0, TL_WIRE_FAULT_GROUP, 1);
}

// Whichever is cleared first: the one that waits for the other is refused, not faulted anew.
static void test_a_group_is_driven_again_once_the_first_fault_is_cleared(void) {
    TEST_ASSERT_EQUAL(0, store(0, 1, TL_WIRE_ESTOP_CLOSED));
    TEST_ASSERT_EQUAL(0, store(1, 1, TL_WIRE_ESTOP_CLOSED));
    all_hold();
    fake.driver_fault[1] = true;
    fake_run_ms(20);
    fake.driver_fault[1] = false;
    TEST_ASSERT_EQUAL(0, clear(0));
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_GROUP, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(0, clear(1));
    fake_ready();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(0, fake_enable(1, 1));
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(1).mode);
}

enum { HOLD_MS = 60000 };

// One bears a load and one does not, as antagonists do; `later` begins its time alone so much after the other.
static int largest_fall(uint8_t loaded, uint8_t free, uint32_t ticks, uint32_t later_ms, uint32_t hold_ms) {
    fake_new(AXES);
    tl_wire_settings_t own = settings(loaded);
    own.group = 1;
    own.hold_ms = hold_ms;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SETTINGS, &own));
    TEST_ASSERT_EQUAL(0, store(free, 1, TL_WIRE_ESTOP_CLOSED));
    fake.load = 0.3;
    fake.friction = 0.02;
    all_hold();
    int before = 0, most = 0;
    for (uint32_t step = 0; app.axes[loaded].fault == TL_WIRE_FAULT_NONE; step++) {
        TEST_ASSERT_TRUE(step < 63U * FAKE_HZ);
        fake.position[free] = 0.5;
        fake.speed[free] = 0.0;
        fake_step();
        if (step == FAKE_HZ + ticks) { // anywhere in a millisecond
            tl_axis_hear(&app.axes[free]);
            tl_axis_hear(&app.axes[loaded]);
        } else if (step == FAKE_HZ + ticks + later_ms * FAKE_HZ / 1000U) {
            tl_axis_hear(&app.axes[loaded]);
        }
        if (step % (FAKE_HZ / 1000U) == 0 && step > 30U * FAKE_HZ) {
            most = before - fake.duty[loaded] > most ? before - fake.duty[loaded] : most;
        }
        before = step % (FAKE_HZ / 1000U) == 0 ? fake.duty[loaded] : before;
    }
    assert_off(free, TL_WIRE_FAULT_HOST_LOST, 0);
    assert_off(loaded, TL_WIRE_FAULT_HOST_LOST, 0);
    return most;
}

static void test_a_group_that_holds_alone_lets_go_slowly(void) {
    for (uint8_t loaded = 0; loaded < AXES; loaded++) {
        for (uint32_t ticks = 0; ticks < FAKE_HZ / 1000U; ticks++) {
            TEST_ASSERT_LESS_THAN(100, largest_fall(loaded, (uint8_t)((loaded + 1U) % AXES), ticks, 0, HOLD_MS));
        }
    }
    TEST_ASSERT_LESS_THAN(100, largest_fall(1, 0, 0, 700, HOLD_MS)); // it came to rest later
    TEST_ASSERT_LESS_THAN(100, largest_fall(0, 1, 0, 700, HOLD_MS));
    TEST_ASSERT_LESS_THAN(100, largest_fall(1, 0, 0, 0, 0)); // by itself it would hold for ever
}

static void test_a_host_that_is_back_keeps_what_its_group_let_go(void) {
    TEST_ASSERT_EQUAL(0, store(0, 1, TL_WIRE_ESTOP_CLOSED));
    TEST_ASSERT_EQUAL(0, store(1, 1, TL_WIRE_ESTOP_CLOSED));
    all_hold();
    app.axes[1].guard.alone_ms = TL_AXIS_LET_GO;
    tl_axis_hear(&app.axes[1]);
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(0, app.axes[1].guard.sink);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(1).mode);
}

// Whatever its fault is: cleared and switched on it would be driven until the input is looked at again.
static void test_no_fault_is_cleared_while_the_stop_input_is_active(void) {
    all_hold();
    fake.driver_fault[0] = true;
    fake_run_ms(20);
    fake.driver_fault[0] = false;
    fake.estop_closed = true;
    fake_run_ms(5);
    assert_off(0, TL_WIRE_FAULT_DRIVER, 0);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_ESTOP, clear(0));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_FAULT, fake_enable(0, 1));
    assert_off(0, TL_WIRE_FAULT_DRIVER, 0);
    fake.estop_closed = false;
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(0, clear(0));
}

static void test_the_stop_input_switches_every_axis_off_and_stays(void) {
    all_hold();
    move_all();
    fake.estop_closed = true;
    fake_run_ms(2);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_MOVE, fake_status(0).mode); // a contact that bounces is no stop
    fake_run_ms(3);
    for (uint8_t i = 0; i < AXES; i++) {
        assert_off(i, TL_WIRE_FAULT_ESTOP, 0);
        TEST_ASSERT_TRUE((fake_status(i).flags & TL_WIRE_FLAG_ESTOP) != 0);
        TEST_ASSERT_EQUAL(TL_WIRE_REASON_ESTOP, clear(i));
        TEST_ASSERT_EQUAL(TL_WIRE_REASON_FAULT, fake_enable(i, 1));
    }
    fake.estop_closed = false;
    fake_run_ms(100);
    for (uint8_t i = 0; i < AXES; i++) {
        assert_off(i, TL_WIRE_FAULT_ESTOP, 0); // until somebody clears it
        TEST_ASSERT_TRUE((fake_status(i).flags & TL_WIRE_FLAG_ESTOP) == 0);
        TEST_ASSERT_EQUAL(0, clear(i));
    }
    all_hold();
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
}

static void test_the_stop_input_stops_homing_checks_and_axes_that_are_off(void) {
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1)); // not checked yet: a check
    app.axes[1].checked = true;
    TEST_ASSERT_EQUAL(0, fake_enable(1, 1));
    const tl_wire_home_t home = {.axis = 1, .direction = 1, .reach_q8 = 9000 * TL_COUNT_ONE, .silence_us = 60000000};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_HOME, &home));
    fake_run_ms(50);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_CHECK, app.axes[0].mode);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOME, app.axes[1].mode);
    fake.estop_closed = true;
    fake_run_ms(5);
    for (uint8_t i = 0; i < AXES; i++) {
        assert_off(i, TL_WIRE_FAULT_ESTOP, 0);
    }
}

// A contact that opens: its wire may break.
static void test_a_stop_input_that_opens_stops_where_it_is_wired_so(void) {
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, store(0, 0, TL_WIRE_ESTOP_OPEN + 1U));
    fake.estop_closed = true; // released
    for (uint8_t i = 0; i < AXES; i++) {
        TEST_ASSERT_EQUAL(0, store(i, 0, TL_WIRE_ESTOP_OPEN));
        TEST_ASSERT_EQUAL(TL_WIRE_ESTOP_OPEN, settings(i).estop);
    }
    fake_run_ms(5);
    for (uint8_t i = 0; i < AXES; i++) {
        clear(i);
    }
    all_hold();
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
    fake.estop_closed = false;
    fake_run_ms(5);
    for (uint8_t i = 0; i < AXES; i++) {
        assert_off(i, TL_WIRE_FAULT_ESTOP, 0);
    }
}

static void test_a_board_without_the_input_does_not_promise_it(void) {
    fake_port.estop_closed = NULL;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, store(0, 0, TL_WIRE_ESTOP_OPEN));
    TEST_ASSERT_EQUAL(0, store(0, 1, TL_WIRE_ESTOP_CLOSED));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, store(0, TL_WIRE_AXES_MAX + 1U, TL_WIRE_ESTOP_CLOSED));
    all_hold();
    fake_run_ms(20);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_an_axis_takes_its_group_with_it);
    RUN_TEST(test_every_axis_of_a_group_names_the_first_that_failed);
    RUN_TEST(test_axes_without_a_group_are_apart);
    RUN_TEST(test_a_fault_that_is_cleared_at_once_takes_its_group_all_the_same);
    RUN_TEST(test_a_group_is_driven_again_once_the_first_fault_is_cleared);
    RUN_TEST(test_a_group_that_holds_alone_lets_go_slowly);
    RUN_TEST(test_a_host_that_is_back_keeps_what_its_group_let_go);
    RUN_TEST(test_no_fault_is_cleared_while_the_stop_input_is_active);
    RUN_TEST(test_the_stop_input_switches_every_axis_off_and_stays);
    RUN_TEST(test_the_stop_input_stops_homing_checks_and_axes_that_are_off);
    RUN_TEST(test_a_stop_input_that_opens_stops_where_it_is_wired_so);
    RUN_TEST(test_a_board_without_the_input_does_not_promise_it);
    return UNITY_END();
}
