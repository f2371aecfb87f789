// What the board tells of an axis is what the axis has, and what a host sets arrives where it belongs.
#include "fake_board.h"
#include "tautline/tl_crc.h"

void setUp(void) {
    fake_new(1);
    fake_ready();
}
void tearDown(void) {}

static uint32_t table_crc; // of all of its blob but the CRC itself

static void follow(void) {
    uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = fake_table(blob, 0, 1);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
    table_crc = tl_crc32(0, blob, size - 4U);
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    fake_run_ms(5);
    const tl_wire_follow_t follow = {.axis = 0, .target = 1, .compensation = 2, .silence_us = 3000000};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_FOLLOW, &follow));
    const tl_wire_set_point_t point = {.axis = 0, .value = 9 * TL_DEG_ONE, .at_us = fake.t_us + 500000U};
    TEST_ASSERT_EQUAL(-1, fake_ask(TL_WIRE_SET_POINT, &point)); // answered where it is refused only
}

static void test_a_status_is_what_is_measured(void) {
    follow();
    fake.current_ma = 321;
    fake.supply_mv = 5432;
    fake_run_ms(200); // on its way
    const tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(321, status.current_ma);
    TEST_ASSERT_EQUAL(5432, status.supply_mv);
    TEST_ASSERT_EQUAL(fake_encoder(&fake, 0) * TL_COUNT_ONE, status.q_q8);
    TEST_ASSERT_INT_WITHIN(20 * TL_COUNT_ONE, status.q_q8, status.q_ref_q8);
    TEST_ASSERT_EQUAL(fake.duty[0], status.duty_q15);
    TEST_ASSERT_NOT_EQUAL(0, status.duty_q15);
    TEST_ASSERT_INT_WITHIN(TL_DEG_ONE, 9 * TL_DEG_ONE * 2 / 5, status.c_ref_q16); // 0.2 s of 0.5
    TEST_ASSERT_EQUAL(32768, status.strength_q15);
    TEST_ASSERT_EQUAL_HEX32(table_crc, status.table_crc);
    TEST_ASSERT_EQUAL(1, status.table_sequence);
    TEST_ASSERT_EQUAL(fake.t_us, status.t_us);
}

// Each sample is the axis at its own time: its measured place, where it should be, the play and the angles.
static void test_telemetry_is_the_axis_at_each_time(void) {
    enum { MS = 400 };
    static struct {
        tl_us_t t_us;
        tl_count_q8_t q, q_ref, p;
        tl_deg_q16_t c_ref;
        int32_t duty;
    } was[MS * 5];
    follow();
    const tl_wire_telemetry_t on = {.axis = 0, .divider = 3};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_TELEMETRY, &on));
    uint32_t seen = 0, steps = 0, differ = 0;
    while (steps < MS * 5U) {
        fake_step();
        const tl_axis_t *axis = &app.axes[0];
        was[steps].t_us = fake.t_us;
        was[steps].q = fake_encoder(&fake, 0) * TL_COUNT_ONE;
        was[steps].q_ref = axis->path.q;
        was[steps].p = axis->tip.play.p;
        was[steps].c_ref = axis->tip.c_ref;
        was[steps].duty = fake.duty[0];
        steps++;
        memset(heard_count, 0, sizeof(heard_count));
        fake_listen();
        for (uint32_t i = 0; heard_count[TL_WIRE_BATCH] > 0 && i < 8U; i++) {
            const tl_wire_batch_t *batch = &heard[TL_WIRE_BATCH].batch;
            TEST_ASSERT_EQUAL(3000, batch->period_us);
            uint32_t at = 0;
            while (at < steps && was[at].t_us != batch->t_us + i * 3000U) {
                at++;
            }
            TEST_ASSERT_TRUE(at < steps);
            TEST_ASSERT_EQUAL(was[at].q, batch->q_q8[i]);
            TEST_ASSERT_EQUAL(was[at].q_ref, batch->q_ref_q8[i]);
            TEST_ASSERT_EQUAL(was[at].p, batch->p_q8[i]);
            TEST_ASSERT_EQUAL(was[at].c_ref, batch->c_ref_q16[i]);
            TEST_ASSERT_EQUAL(was[at].duty, batch->duty_q15[i]);
            TEST_ASSERT_EQUAL(tl_play_angle(&(tl_play_t){.lookup = &app.axes[0].tip.lookup, .p = was[at].p}),
                              batch->c_est_q16[i]);
            differ += was[at].q != was[at].q_ref && was[at].q != was[at].p ? 1U : 0U;
            seen++;
        }
    }
    TEST_ASSERT_TRUE(seen >= MS / 3 - 8 && differ > seen / 2U);
}

static tl_wire_motion_start_t motion(void) {
    tl_wire_motion_start_t start = fake_calibration();
    start.high_q8 = 2001 * TL_COUNT_ONE;
    start.speed_q8_s[1] = 500 * TL_COUNT_ONE;
    start.delay_us = 70000;
    return start;
}

static void test_a_calibration_is_what_was_asked_for(void) {
    const tl_onset_config_t defaults = tl_onset_defaults();
    const tl_onset_config_t *onset = &app.calibration.work.detector.config;
    tl_wire_motion_start_t start = motion();
    fake_enable(0, 1);
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    const tl_motion_config_t *made = &app.calibration.work.motion.config;
    TEST_ASSERT_EQUAL(start.cycles, made->cycles);
    TEST_ASSERT_EQUAL(start.low_q8, made->low);
    TEST_ASSERT_EQUAL(start.high_q8, made->high);
    TEST_ASSERT_EQUAL(2, made->speed_count);
    TEST_ASSERT_EQUAL_INT32_ARRAY(start.speed_q8_s, made->speed, 2);
    TEST_ASSERT_EQUAL(start.transit_q8_s, made->transit);
    TEST_ASSERT_EQUAL(start.acceleration_q8_s2, made->acceleration);
    TEST_ASSERT_EQUAL(start.approach_q8, made->approach);
    TEST_ASSERT_EQUAL(start.stroke_max_q8, made->stroke_max);
    TEST_ASSERT_EQUAL(start.host_timeout_us, made->host_timeout_us);
    TEST_ASSERT_EQUAL(70000, onset->delay_us);
    TEST_ASSERT_EQUAL(defaults.guard_us, onset->guard_us); // nothing else was said
    TEST_ASSERT_EQUAL(defaults.turn, onset->turn);
    TEST_ASSERT_EQUAL(defaults.frames_max, onset->frames_max);

    setUp();
    start.guard_us = 21000;
    start.lost_us = 410000;
    start.timeout_us = 31000000;
    start.turn_q8 = 5 * TL_COUNT_ONE;
    start.sigma_wanted_q8 = 500;
    start.sigma_usable_q8 = 6000;
    start.noise_q12 = 450;
    start.curvature = 300;
    start.threshold_q4 = 400;
    start.frames_min = 5;
    start.frames_max = 30;
    fake_enable(0, 1);
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    TEST_ASSERT_EQUAL(start.guard_us, onset->guard_us);
    TEST_ASSERT_EQUAL(start.lost_us, onset->lost_us);
    TEST_ASSERT_EQUAL(start.timeout_us, onset->timeout_us);
    TEST_ASSERT_EQUAL(start.turn_q8, onset->turn);
    TEST_ASSERT_EQUAL(start.sigma_wanted_q8, onset->sigma_wanted);
    TEST_ASSERT_EQUAL(start.sigma_usable_q8, onset->sigma_usable);
    TEST_ASSERT_EQUAL(start.noise_q12, onset->noise_px);
    TEST_ASSERT_EQUAL(start.curvature, onset->curvature);
    TEST_ASSERT_EQUAL(start.threshold_q4, onset->threshold);
    TEST_ASSERT_EQUAL(start.frames_min, onset->frames_min);
    TEST_ASSERT_EQUAL(start.frames_max, onset->frames_max);
}

static void test_a_frame_without_a_marker_is_none_for_the_detector(void) {
    const tl_wire_motion_start_t start = motion();
    fake_enable(0, 1);
    fake_run_ms(5);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOTION_START, &start));
    fake_run_ms(150); // the history reaches back by more than the delay
    for (uint8_t valid = 0; valid <= 1; valid++) {
        const tl_wire_marker_t marker = {.valid = valid, .arrival_us = fake.t_us, .u_q12 = 4000, .v_q12 = 5000};
        fake_ask(TL_WIRE_MARKER, &marker);
        fake_run_ms(40);
        TEST_ASSERT_EQUAL(1, app.calibration.work.detector.lost); // the first
    }
}

#define MOTION_IS(reason, change)                                                                                      \
    do {                                                                                                               \
        tl_wire_motion_start_t start = motion();                                                                       \
        change;                                                                                                        \
        TEST_ASSERT_EQUAL_MESSAGE(TL_WIRE_REASON_##reason, fake_ask(TL_WIRE_MOTION_START, &start), #change);           \
    } while (0)

static void test_a_motion_that_cannot_be_is_refused_with_its_reason(void) {
    fake_enable(0, 1);
    fake_run_ms(5);
    MOTION_IS(MOTION_RANGE, start.high_q8 = start.low_q8 + start.stroke_max_q8);
    MOTION_IS(MOTION_SPEED, start.speed_q8_s[0] = 0);
    MOTION_IS(MOTION_SPEED, start.speed_q8_s[1] = start.transit_q8_s + 1);
    MOTION_IS(MOTION_ACCELERATION, start.acceleration_q8_s2 = 1);
    MOTION_IS(MOTION_STROKE, start.approach_q8 = TL_COUNT_ONE - 1);
    MOTION_IS(MOTION_CYCLES, start.cycles = 0);
    MOTION_IS(MOTION_CYCLES, start.cycles = 101);
    MOTION_IS(RANGE, start.host_timeout_us = 0);
    MOTION_IS(ONSET, start.frames_min = 2);
}

// Gains and duties at their ends: each is taken, one beyond is not.
static void test_settings_have_their_ends(void) {
    tl_wire_settings_t own = tl_axis_default_settings(&fake_port, 0);
    TEST_ASSERT_EQUAL(0, tl_axis_check_settings(&fake_port, &own));
    int32_t *gains[] = {&own.proportional, &own.integral, &own.derivative,
                        &own.feed_forward, &own.inertia,  &own.friction_q15};
    for (unsigned i = 0; i < sizeof(gains) / sizeof(gains[0]); i++) {
        const int32_t was = *gains[i];
        const int32_t refused[] = {-1, TL_WIRE_GAIN_MAX + 1}, taken[] = {0, TL_WIRE_GAIN_MAX};
        for (unsigned k = 0; k < 2; k++) {
            *gains[i] = refused[k];
            TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, tl_axis_check_settings(&fake_port, &own));
            *gains[i] = taken[k];
            TEST_ASSERT_EQUAL(0, tl_axis_check_settings(&fake_port, &own));
        }
        *gains[i] = was;
    }
    own.low_duty_q15 = 0;
    TEST_ASSERT_EQUAL(0, tl_axis_check_settings(&fake_port, &own));
    own.low_duty_q15 = -1;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, tl_axis_check_settings(&fake_port, &own));
    own.low_duty_q15 = own.duty_q15;
    TEST_ASSERT_EQUAL(0, tl_axis_check_settings(&fake_port, &own));
    own.low_duty_q15 = own.duty_q15 + 1;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, tl_axis_check_settings(&fake_port, &own));
}

static void test_a_position_is_within_four_million_counts(void) {
    static const struct {
        int32_t q_q8;
        int reason;
    } places[] = {{TL_AXIS_RANGE_MAX, 0},
                  {-TL_AXIS_RANGE_MAX, 0},
                  {TL_AXIS_RANGE_MAX + 1, TL_WIRE_REASON_RANGE},
                  {-TL_AXIS_RANGE_MAX - 1, TL_WIRE_REASON_RANGE}};
    for (unsigned i = 0; i < sizeof(places) / sizeof(places[0]); i++) {
        const tl_wire_set_position_t here = {.axis = 0, .q_q8 = places[i].q_q8};
        TEST_ASSERT_EQUAL(places[i].reason, fake_ask(TL_WIRE_SET_POSITION, &here));
    }
}

static void test_a_lost_bus_is_one_however_often_it_is_said(void) {
    tl_app_bus(&app, false);
    tl_app_bus(&app, false);
    TEST_ASSERT_EQUAL(1, app.counters.bus_losses);
    tl_app_bus(&app, true);
    tl_app_bus(&app, false);
    TEST_ASSERT_EQUAL(2, app.counters.bus_losses);
}

// While nobody follows, a strength is kept for who will: the compensator is not touched.
static void test_a_strength_is_heard_by_an_axis_that_follows(void) {
    follow();
    fake_run_ms(600); // at its target, pushed from below
    const tl_count_q8_t before = app.axes[0].path.q;
    const tl_wire_strength_t none = {.axis = 0, .strength_q15 = 0};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_STRENGTH, &none));
    fake_run_ms(1000);
    const int32_t width = tl_lookup_width(&app.axes[0].tip.lookup, app.axes[0].tip.compensator.p, &(uint32_t){0});
    TEST_ASSERT_INT_WITHIN(TL_COUNT_ONE, before - width / 2, app.axes[0].path.q);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_status_is_what_is_measured);
    RUN_TEST(test_telemetry_is_the_axis_at_each_time);
    RUN_TEST(test_a_calibration_is_what_was_asked_for);
    RUN_TEST(test_a_frame_without_a_marker_is_none_for_the_detector);
    RUN_TEST(test_a_motion_that_cannot_be_is_refused_with_its_reason);
    RUN_TEST(test_settings_have_their_ends);
    RUN_TEST(test_a_position_is_within_four_million_counts);
    RUN_TEST(test_a_lost_bus_is_one_however_often_it_is_said);
    RUN_TEST(test_a_strength_is_heard_by_an_axis_that_follows);
    return UNITY_END();
}
