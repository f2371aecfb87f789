// A whole calibration through the app, on an instrument with 300 counts of backlash that a camera sees 80 ms late: what
// is told of each reversal and of the end (tl_wire.h), and that nothing of it is left for the next one.
#include "fake_board.h"

#define WIDTH   300.0 // counts
#define LATE_MS 80U
#define FRAME   20U // ms
#define LONGEST 200000U

static double tip, seen[LATE_MS];
static uint32_t ms, onsets, progresses, frames;
static tl_wire_onset_t onset[64];
static tl_wire_progress_t progress;

void setUp(void) {
    fake_new(2);
    fake_ready();
    tip = 0.0;
    memset(seen, 0, sizeof(seen));
    ms = onsets = progresses = frames = 0;
    fake_listen();
    memset(heard_count, 0, sizeof(heard_count));
}
void tearDown(void) {}

static void begin(void) {
    const tl_wire_motion_start_t start = fake_calibration();
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    memset(heard_count, 0, sizeof(heard_count));
}

// A reversal is told once, and the progress with it.
static void hears(void) {
    fake_listen();
    if (heard_count[TL_WIRE_ONSET] > 0U) {
        TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_ONSET]);
        onset[onsets % 64U] = heard[TL_WIRE_ONSET].onset;
        TEST_ASSERT_EQUAL(onsets, heard[TL_WIRE_ONSET].onset.index);
        TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_PROGRESS]);
        TEST_ASSERT_EQUAL(TL_WIRE_MOTION_RUNNING, heard[TL_WIRE_PROGRESS].progress.state);
        onsets++;
    }
    if (heard_count[TL_WIRE_PROGRESS] > 0U) {
        const tl_wire_progress_t now = heard[TL_WIRE_PROGRESS].progress;
        TEST_ASSERT_EQUAL(0, now.axis);
        TEST_ASSERT_EQUAL(onsets, now.reversals);
        TEST_ASSERT_TRUE(now.permille >= progress.permille || progresses == 0U);
        progress = now;
        progresses++;
    }
}

static void pass(bool markers) {
    const double q = fake.position[0];
    tip = q - tip > WIDTH / 2.0 ? q - WIDTH / 2.0 : (tip - q > WIDTH / 2.0 ? q + WIDTH / 2.0 : tip);
    const double shown = seen[ms % LATE_MS];
    seen[ms % LATE_MS] = tip;
    memset(heard_count, 0, sizeof(heard_count));
    if (markers && ms % FRAME == 0U) {
        const tl_wire_marker_t marker = {.valid = 1,
                                         .arrival_us = fake.t_us,
                                         .u_q12 = (int32_t)((400.0 + shown * 0.05) * TL_PX_ONE),
                                         .v_q12 = 200 * TL_PX_ONE};
        uint8_t frame[TL_WIRE_FRAME_MAX];
        tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_MARKER, 1, &marker));
        frames++;
    }
    hears();
    memset(heard_count, 0, sizeof(heard_count));
    fake_run_ms(1);
    hears();
    ms++;
}

static void test_each_reversal_is_told_and_then_the_end(void) {
    begin();
    while (app.calibration.axis != NULL && ms < LONGEST) {
        pass(true);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_MOTION_COMPLETE, progress.state);
    TEST_ASSERT_EQUAL(1000, progress.permille);
    TEST_ASSERT_EQUAL(4 * 3 + 2, onsets); // tl_motion.h, of three cycles at one speed
    TEST_ASSERT_EQUAL(onsets + 1U, progresses);
    TEST_ASSERT_TRUE(progress.t_us == fake.t_us);
    for (uint32_t i = 0; i < onsets; i++) {
        TEST_ASSERT_EQUAL(0, onset[i].axis);
        TEST_ASSERT_EQUAL(0, onset[i].reason);
        TEST_ASSERT_INT_WITHIN(15 * TL_COUNT_ONE, (int32_t)WIDTH * TL_COUNT_ONE, onset[i].width_q8);
        TEST_ASSERT_INT_WITHIN(1, onset[i].width_q8, abs(onset[i].q2_q8 - onset[i].q1_q8));
        TEST_ASSERT_TRUE(onset[i].turn_us < onset[i].start_us && onset[i].start_us < fake.t_us);
        TEST_ASSERT_EQUAL(onset[i].q2_q8 > onset[i].q1_q8 ? 1 : -1, onset[i].direction);
    }
    const tl_wire_motion_start_t asked = fake_calibration();
    for (uint32_t i = 0; i + 1U < onsets; i++) {
        const int32_t stroke = abs(onset[i + 1U].q1_q8 - onset[i].q1_q8);
        if (i % 7U % 2U == 1U) { // back: it ends soon after its onset, well before its most
            TEST_ASSERT_TRUE(stroke < asked.stroke_max_q8 - 100 * TL_COUNT_ONE);
        }
    }
    TEST_ASSERT_EQUAL(frames, app.counters.markers + app.counters.markers_dropped);
    TEST_ASSERT_EQUAL(0, app.counters.onsets_dropped);
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, app.axes[0].mode);
    TEST_ASSERT_NULL(app.axes[0].history);
    TEST_ASSERT_TRUE(ms < LONGEST);
}

static void test_what_found_no_room_is_counted(void) {
    begin();
    uint32_t dropped = 0;
    while (app.calibration.axis != NULL && ms < LONGEST && dropped == 0U) {
        const uint32_t tail = app.outbox.tail;
        app.outbox.head = tail + TL_APP_QUEUE; // nobody reads
        const uint32_t before = onsets;
        pass(false);
        onsets = before;
        if (ms % FRAME == 0U) {
            const tl_wire_marker_t marker = {.valid = 1,
                                             .arrival_us = fake.t_us,
                                             .u_q12 = (int32_t)((400.0 + seen[ms % LATE_MS] * 0.05) * TL_PX_ONE),
                                             .v_q12 = 200 * TL_PX_ONE};
            uint8_t frame[TL_WIRE_FRAME_MAX];
            app.outbox.head = app.outbox.tail + TL_APP_QUEUE;
            tl_app_receive(&app, frame, tl_wire_frame(frame, TL_WIRE_MARKER, 1, &marker));
            dropped = app.counters.onsets_dropped;
        }
        app.outbox.tail = app.outbox.head;
    }
    TEST_ASSERT_EQUAL(1, dropped);
    TEST_ASSERT_EQUAL(1, app.counters.events_dropped); // its progress
}

// The host is lost, and comes back: a calibration of its own is not lost for that.
static void test_a_lost_host_is_not_the_next_one_s(void) {
    begin();
    for (uint32_t i = 0; i < 500U; i++) {
        pass(true);
    }
    tl_app_bus(&app, false);
    fake_run_ms(300);
    tl_app_bus(&app, true);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_HOST_LOST, app.axes[0].fault);
    TEST_ASSERT_EQUAL(0, fake_status(0).fault_value);
    const tl_wire_clear_fault_t clear = {.axis = 0};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_CLEAR_FAULT, &clear));
    begin();
    onsets = 0;
    for (uint32_t i = 0; i < 500U; i++) {
        pass(true);
    }
    const tl_wire_motion_stop_t stop = {.axis = 0};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_STOP, &stop));
    for (uint32_t i = 0; i < 300U; i++) {
        pass(true);
    }
    TEST_ASSERT_EQUAL(TL_WIRE_MOTION_STOPPED, progress.state);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[0].fault);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, app.axes[0].mode);
}

static void test_a_motion_may_go_to_the_ends_of_what_settings_allow(void) {
    const tl_wire_get_limits_t get = {.axis = 0};
    fake_ask(TL_WIRE_GET_LIMITS, &get);
    tl_wire_limits_t limits = heard[TL_WIRE_LIMITS].limits;
    tl_wire_motion_start_t start = fake_calibration();
    limits.q_low_q8 = start.low_q8;
    limits.q_high_q8 = start.high_q8;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    fake_run_ms(5);
    start.low_q8--;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_MOTION_START, &start));
    start.low_q8++;
    start.high_q8++;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_MOTION_START, &start));
    start.high_q8--;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_each_reversal_is_told_and_then_the_end);
    RUN_TEST(test_what_found_no_room_is_counted);
    RUN_TEST(test_a_lost_host_is_not_the_next_one_s);
    RUN_TEST(test_a_motion_may_go_to_the_ends_of_what_settings_allow);
    return UNITY_END();
}
