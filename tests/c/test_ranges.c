// What settings and limits may be: each field at its least and its most, and one beyond, as tl_wire.h says.
#include "fake_board.h"

#include "tautline/tl_reference.h"

#define COUNTS(n) ((n) * TL_COUNT_ONE)
#define END       TL_AXIS_RANGE_MAX

void setUp(void) {
    fake_new(2);
}
void tearDown(void) {}

static tl_wire_settings_t own;

static int ask(void) {
    own.key = TL_WIRE_KEY;
    return fake_ask(TL_WIRE_SETTINGS, &own);
}

// All at an end of their ranges at which each may be. Nothing else of an axis depends on what it is told here: it is
// off.
static void begin(void) {
    own = app.axes[0].settings;
    own.low_duty_q15 = 0;
}

#define MAY(field, value)                                                                                              \
    do {                                                                                                               \
        begin();                                                                                                       \
        own.field = (value);                                                                                           \
        TEST_ASSERT_EQUAL_MESSAGE(0, ask(), #field " = " #value);                                                      \
        TEST_ASSERT_TRUE_MESSAGE(app.axes[0].settings.field == own.field, #field " = " #value);                        \
    } while (0)

#define MAY_NOT(field, value)                                                                                          \
    do {                                                                                                               \
        begin();                                                                                                       \
        const tl_wire_settings_t before = app.axes[0].settings;                                                        \
        own.field = (value);                                                                                           \
        TEST_ASSERT_EQUAL_MESSAGE(TL_WIRE_REASON_RANGE, ask(), #field " = " #value);                                   \
        TEST_ASSERT_TRUE_MESSAGE(app.axes[0].settings.field == before.field, "nothing has changed");                   \
    } while (0)

#define FROM_TO(field, least, most)                                                                                    \
    do {                                                                                                               \
        MAY(field, least);                                                                                             \
        MAY(field, most);                                                                                              \
        MAY_NOT(field, (least) - 1);                                                                                   \
        MAY_NOT(field, (most) + 1);                                                                                    \
    } while (0)

static void test_the_range_of_each_setting(void) {
    FROM_TO(speed_q8_s, 1, TL_REFERENCE_SPEED_MAX);
    FROM_TO(acceleration_q8_s2, TL_REFERENCE_ACCELERATION_MIN, TL_REFERENCE_ACCELERATION_MAX);
    FROM_TO(duty_q15, 0, 32768);
    FROM_TO(current_ma, 0, (int32_t)fake_port.driver_ma);
    FROM_TO(following_error_q8, COUNTS(1), END);
    FROM_TO(proportional, 0, TL_WIRE_GAIN_MAX);
    FROM_TO(integral, 0, TL_WIRE_GAIN_MAX);
    FROM_TO(derivative, 0, TL_WIRE_GAIN_MAX);
    FROM_TO(feed_forward, 0, TL_WIRE_GAIN_MAX);
    FROM_TO(inertia, 0, TL_WIRE_GAIN_MAX);
    FROM_TO(friction_q15, 0, TL_WIRE_GAIN_MAX);
    FROM_TO(arrive_q8, COUNTS(1), END);
    FROM_TO(stall_ms, 20, 5000);
    MAY(q_low_q8, -END);
    MAY_NOT(q_low_q8, -END - 1);
    MAY(q_high_q8, END);
    MAY_NOT(q_high_q8, END + 1);
    MAY(hold_ms, 0);
    MAY(hold_ms, TL_AXIS_HOLD_MAX_MS);
    MAY_NOT(hold_ms, TL_AXIS_HOLD_MAX_MS + 1U);
    MAY(group, 0);
    MAY(group, 4);
    MAY_NOT(group, 5);
    MAY(commissioned, 0);
    MAY(commissioned, 1);
    MAY_NOT(commissioned, 2);
    MAY_NOT(estop, 2);
}

static void test_a_range_is_not_empty_and_a_low_duty_is_no_higher_than_the_duty(void) {
    begin();
    own.q_low_q8 = COUNTS(7);
    own.q_high_q8 = COUNTS(7);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, ask());
    own.q_high_q8++;
    TEST_ASSERT_EQUAL(0, ask());
    begin();
    own.duty_q15 = 20000;
    own.low_duty_q15 = 20000;
    TEST_ASSERT_EQUAL(0, ask());
    own.low_duty_q15 = 20001;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, ask());
    own.low_duty_q15 = -1;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, ask());
}

#define WITHIN(field, by)                                                                                              \
    do {                                                                                                               \
        tl_wire_limits_t limits = held;                                                                                \
        limits.field -= (by);                                                                                          \
        TEST_ASSERT_EQUAL_MESSAGE(0, fake_ask(TL_WIRE_LIMITS, &limits), #field);                                       \
        limits = held;                                                                                                 \
        TEST_ASSERT_EQUAL_MESSAGE(0, fake_ask(TL_WIRE_LIMITS, &limits), #field);                                       \
        limits.field += (by);                                                                                          \
        TEST_ASSERT_EQUAL_MESSAGE(TL_WIRE_REASON_BEYOND_SETTINGS, fake_ask(TL_WIRE_LIMITS, &limits), #field);          \
        TEST_ASSERT_TRUE_MESSAGE(app.axes[0].limits.field == held.field, "nothing has changed");                       \
    } while (0)

static void test_limits_are_the_settings_at_most(void) {
    begin();
    own.q_low_q8 = COUNTS(-1000);
    own.q_high_q8 = COUNTS(1000);
    own.duty_q15 = 20000;
    own.current_ma = 500;
    TEST_ASSERT_EQUAL(0, ask());
    const tl_wire_limits_t held = app.axes[0].limits;
    WITHIN(q_low_q8, -1);
    WITHIN(q_high_q8, 1);
    WITHIN(speed_q8_s, 1);
    WITHIN(acceleration_q8_s2, 1);
    WITHIN(duty_q15, 1);
    WITHIN(current_ma, 1);
    WITHIN(following_error_q8, 1);
    tl_wire_limits_t limits = held;
    limits.duty_q15 = 0;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    limits.duty_q15 = -1;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_LIMITS, &limits));
    limits = held;
    limits.current_ma = 1;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    limits.current_ma = 0; // not watched
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_SETTINGS, fake_ask(TL_WIRE_LIMITS, &limits));
    begin();
    own.current_ma = 0;
    TEST_ASSERT_EQUAL(0, ask());
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
}

// -- motions: each number of a request at its ends, and one beyond ----------------------------------------------------

// Holds, nothing known of where it is: a homing and a jog may begin again and again.
static void hold(void) {
    fake_new(1);
    app.axes[0].checked = true;
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
}

static int home(tl_wire_home_t request) {
    hold();
    return fake_ask(TL_WIRE_HOME, &request);
}

static int jog(tl_wire_jog_t request) {
    hold();
    return fake_ask(TL_WIRE_JOG, &request);
}

static int move(tl_wire_move_t request) {
    hold();
    fake_ready();
    return fake_ask(TL_WIRE_MOVE, &request);
}

static int follow(tl_wire_follow_t request) {
    hold();
    fake_ready();
    return fake_ask(TL_WIRE_FOLLOW, &request);
}

#define HOME(way, reach, ...) home((tl_wire_home_t){.direction = (way), .reach_q8 = (reach), __VA_ARGS__})
#define RANGE                 TL_WIRE_REASON_RANGE

static void test_the_ranges_of_a_homing(void) {
    const int32_t low = TL_RATIO_ONE / 4; // the settings' low duty
    TEST_ASSERT_EQUAL(0, HOME(1, COUNTS(100), .duty_q15 = low));
    TEST_ASSERT_EQUAL(RANGE, HOME(1, COUNTS(100), .duty_q15 = low + 1));
    TEST_ASSERT_EQUAL(RANGE, HOME(1, COUNTS(100), .duty_q15 = -1));
    TEST_ASSERT_EQUAL(RANGE, HOME(1, COUNTS(100), .speed_q8_s = -1));
    TEST_ASSERT_EQUAL(RANGE, HOME(1, COUNTS(100), .retreat_q8 = -1));
    TEST_ASSERT_EQUAL(0, HOME(1, 1, .retreat_q8 = 0));
    TEST_ASSERT_EQUAL(RANGE, HOME(1, 0, .retreat_q8 = 0));
    TEST_ASSERT_EQUAL(0, HOME(1, END, .retreat_q8 = 0));
    TEST_ASSERT_EQUAL(RANGE, HOME(1, END + 1, .retreat_q8 = 0));
    for (int8_t direction = -3; direction <= 3; direction++) {
        TEST_ASSERT_EQUAL(direction == 1 || direction == -1 ? 0 : RANGE, HOME(direction, COUNTS(100), .retreat_q8 = 0));
    }
    TEST_ASSERT_EQUAL(0, HOME(1, COUNTS(100), .end_q8 = END));
    TEST_ASSERT_EQUAL(0, HOME(1, COUNTS(100), .end_q8 = -END));
    TEST_ASSERT_EQUAL(
        RANGE, HOME(1, COUNTS(100), .end_q8 = END + 1, .retreat_q8 = 1)); // though it goes back to one that may be
    TEST_ASSERT_EQUAL(RANGE, HOME(-1, COUNTS(100), .end_q8 = -END - 1, .retreat_q8 = 1));
    TEST_ASSERT_EQUAL(RANGE, HOME(1, COUNTS(100), .end_q8 = -END, .retreat_q8 = 1)); // goes back to where it may not be
    TEST_ASSERT_EQUAL(RANGE, HOME(-1, COUNTS(100), .end_q8 = END, .retreat_q8 = 1));
    TEST_ASSERT_EQUAL(0, HOME(1, COUNTS(100), .silence_us = 60000000));
    TEST_ASSERT_EQUAL(RANGE, HOME(1, COUNTS(100), .silence_us = 60000001));
}

static void test_the_ranges_of_jogs_and_moves(void) {
    TEST_ASSERT_EQUAL(0, jog((tl_wire_jog_t){.way_q8 = END}));
    TEST_ASSERT_EQUAL(RANGE, jog((tl_wire_jog_t){.way_q8 = END + 1}));
    TEST_ASSERT_EQUAL(0, jog((tl_wire_jog_t){.way_q8 = -END}));
    TEST_ASSERT_EQUAL(RANGE, jog((tl_wire_jog_t){.way_q8 = -END - 1}));
    TEST_ASSERT_EQUAL(RANGE, jog((tl_wire_jog_t){.speed_q8_s = -1}));
    TEST_ASSERT_EQUAL(0, jog((tl_wire_jog_t){.silence_us = 60000000}));
    TEST_ASSERT_EQUAL(RANGE, jog((tl_wire_jog_t){.silence_us = 60000001}));
    TEST_ASSERT_EQUAL(0, move((tl_wire_move_t){.q_q8 = END}));
    TEST_ASSERT_EQUAL(RANGE, move((tl_wire_move_t){.q_q8 = END + 1}));
    TEST_ASSERT_EQUAL(0, move((tl_wire_move_t){.q_q8 = -END}));
    TEST_ASSERT_EQUAL(RANGE, move((tl_wire_move_t){.q_q8 = -END - 1}));
    TEST_ASSERT_EQUAL(RANGE, move((tl_wire_move_t){.speed_q8_s = -1}));
    TEST_ASSERT_EQUAL(0, move((tl_wire_move_t){.silence_us = 60000000}));
    TEST_ASSERT_EQUAL(RANGE, move((tl_wire_move_t){.silence_us = 60000001}));
}

static void test_the_ranges_of_a_follower(void) {
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NO_TABLE, follow((tl_wire_follow_t){.target = 1, .compensation = 2}));
    TEST_ASSERT_EQUAL(RANGE, follow((tl_wire_follow_t){.target = 2}));
    TEST_ASSERT_EQUAL(RANGE, follow((tl_wire_follow_t){.compensation = 3}));
    TEST_ASSERT_EQUAL(0, follow((tl_wire_follow_t){.silence_us = 60000000}));
    TEST_ASSERT_EQUAL(RANGE, follow((tl_wire_follow_t){.silence_us = 60000001}));
    TEST_ASSERT_EQUAL(0, follow((tl_wire_follow_t){.silence_us = 0}));
    tl_wire_set_point_t point = {.at_us = fake.t_us + 10000000};
    TEST_ASSERT_EQUAL(-1, fake_ask(TL_WIRE_SET_POINT, &point)); // taken, and not acknowledged
    point.at_us = fake.t_us + 10000001;
    TEST_ASSERT_EQUAL(RANGE, fake_ask(TL_WIRE_SET_POINT, &point));
}

// The speed that a motion goes at is its plan's.
static void assert_speed(int32_t counts_s) {
    TEST_ASSERT_EQUAL_INT32(tl_reference_speed(COUNTS(counts_s), TL_AXIS_PLAN_HZ), app.axes[0].plan.move.speed);
}

static void test_motions_go_as_fast_as_asked_and_no_faster_than_they_may(void) {
    const tl_wire_limits_t *most = &app.axes[0].limits;
    TEST_ASSERT_EQUAL(0, move((tl_wire_move_t){.q_q8 = COUNTS(100)}));
    assert_speed(most->speed_q8_s / TL_COUNT_ONE);
    TEST_ASSERT_EQUAL(0, move((tl_wire_move_t){.q_q8 = COUNTS(100), .speed_q8_s = COUNTS(1)}));
    assert_speed(1);
    TEST_ASSERT_EQUAL(0, jog((tl_wire_jog_t){.way_q8 = COUNTS(100)}));
    TEST_ASSERT_EQUAL_INT32(app.axes[0].plan.travel.speed / 10, app.axes[0].plan.move.speed);
    TEST_ASSERT_EQUAL(0, jog((tl_wire_jog_t){.way_q8 = COUNTS(100), .speed_q8_s = COUNTS(20000)}));
    TEST_ASSERT_EQUAL_INT32(app.axes[0].plan.travel.speed / 2, app.axes[0].plan.move.speed);
    TEST_ASSERT_EQUAL(0, HOME(1, COUNTS(100), .speed_q8_s = 0));
    TEST_ASSERT_EQUAL_INT32(app.axes[0].plan.travel.speed / 10, app.axes[0].plan.move.speed);
    TEST_ASSERT_EQUAL(0, HOME(1, COUNTS(100), .speed_q8_s = COUNTS(20000)));
    TEST_ASSERT_EQUAL_INT32(app.axes[0].plan.travel.speed / 2, app.axes[0].plan.move.speed);
    TEST_ASSERT_EQUAL(0, HOME(1, COUNTS(100), .speed_q8_s = COUNTS(300)));
    assert_speed(300);
}

// Milliseconds until a move whose host says nothing more is told to be without one.
static uint32_t until_silent(void) {
    uint32_t ms = 0;
    while (!app.axes[0].silent && ms < 3000U) {
        fake_run_ms(1);
        ms++;
    }
    return ms;
}

static void test_a_motion_waits_for_its_host_as_long_as_it_says(void) {
    TEST_ASSERT_EQUAL(0, move((tl_wire_move_t){.q_q8 = COUNTS(1000000), .speed_q8_s = COUNTS(10)}));
    TEST_ASSERT_INT_WITHIN(1, 1001, until_silent()); // tl_wire.h: 0 is a second
    TEST_ASSERT_EQUAL(0,
                      move((tl_wire_move_t){.q_q8 = COUNTS(1000000), .speed_q8_s = COUNTS(10), .silence_us = 250000}));
    TEST_ASSERT_INT_WITHIN(1, 251, until_silent());
    TEST_ASSERT_EQUAL(0, follow((tl_wire_follow_t){.target = 0}));
    TEST_ASSERT_INT_WITHIN(1, 101, until_silent()); // a tenth of one
    TEST_ASSERT_EQUAL(0, follow((tl_wire_follow_t){.silence_us = 250000}));
    TEST_ASSERT_INT_WITHIN(1, 251, until_silent());
}

// docs/safety.md: a motor that is switched off while a host was away may be switched on again, and moves.
static void test_switching_on_again_forgets_the_silence(void) {
    TEST_ASSERT_EQUAL(0, move((tl_wire_move_t){.q_q8 = COUNTS(1000), .silence_us = 20000}));
    while (!app.axes[0].silent) {
        fake_run_ms(1);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_STOPPING_OFF, app.axes[0].mode);
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1)); // before it rests
    fake_run_ms(500);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, app.axes[0].mode);
    TEST_ASSERT_EQUAL(0, fake_enable(0, 0));
    fake_run_ms(100);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, app.axes[0].mode);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[0].fault);
}

// -- what is counted -------------------------------------------------------------------------------------------------

static void test_every_frame_and_every_late_step_is_counted(void) {
    const tl_wire_get_counters_t clears = {.clear = 1}, reads = {.clear = 0};
    fake_ask(TL_WIRE_GET_COUNTERS, &clears);
    for (uint32_t i = 0; i < 5U; i++) {
        fake_status(0);
    }
    for (uint32_t i = 0; i < 3U; i++) {
        fake.t_us += 5000; // 25 periods
        fake_step();
        fake_run_ms(2);
    }
    fake_ask(TL_WIRE_GET_COUNTERS, &reads);
    const tl_wire_counters_t found = heard[TL_WIRE_COUNTERS].counters;
    TEST_ASSERT_EQUAL(6, found.frames_in); // with this request
    TEST_ASSERT_EQUAL(3, found.overruns);
    fake_ask(TL_WIRE_GET_COUNTERS, &clears);
    fake_ask(TL_WIRE_GET_COUNTERS, &reads);
    TEST_ASSERT_EQUAL(1, heard[TL_WIRE_COUNTERS].counters.frames_in);
    TEST_ASSERT_EQUAL(0, heard[TL_WIRE_COUNTERS].counters.overruns);
}

// -- a table that was not sent whole ---------------------------------------------------------------------------------

static void test_a_table_half_sent_is_gone_with_its_sender(void) {
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = fake_table(blob, 0, 1);
    for (int again = 0; again < 2; again++) {
        fake_new(1);
        tl_app_bus(&app, true);
        TEST_ASSERT_EQUAL(TL_UPLOAD_OK, tl_app_table_data(&app, 0, 0, blob, 256));
        tl_app_bus(&app, again != 0);      // he leaves, or another one comes
        tl_upload_t result = TL_UPLOAD_OK; // who sends the rest
        for (uint32_t at = 256; at < size && result == TL_UPLOAD_OK; at += 256U) {
            result = tl_app_table_data(&app, 0, at, blob + at, size - at < 256U ? size - at : 256U);
        }
        TEST_ASSERT_TRUE(result != TL_UPLOAD_OK || tl_app_table_end(&app, 0) != TL_UPLOAD_OK);
        TEST_ASSERT_EQUAL(TL_WIRE_TABLE_NONE, app.tables.in_use[0].state);
        TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_range_of_each_setting);
    RUN_TEST(test_a_range_is_not_empty_and_a_low_duty_is_no_higher_than_the_duty);
    RUN_TEST(test_limits_are_the_settings_at_most);
    RUN_TEST(test_the_ranges_of_a_homing);
    RUN_TEST(test_the_ranges_of_jogs_and_moves);
    RUN_TEST(test_the_ranges_of_a_follower);
    RUN_TEST(test_motions_go_as_fast_as_asked_and_no_faster_than_they_may);
    RUN_TEST(test_a_motion_waits_for_its_host_as_long_as_it_says);
    RUN_TEST(test_switching_on_again_forgets_the_silence);
    RUN_TEST(test_every_frame_and_every_late_step_is_counted);
    RUN_TEST(test_a_table_half_sent_is_gone_with_its_sender);
    return UNITY_END();
}
