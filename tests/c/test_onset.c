#include "tautline/tl_onset.h"

#include <string.h>
#include <unity.h>

#define FRAME_US 40000U
#define WIDTH    (500 * TL_COUNT_ONE)

static tl_onset_config_t config;
static tl_onset_detector_t detector;
static tl_history_t history;
static tl_onset_t found[64];
static uint32_t count;
static tl_us_t now_us;
static tl_us_t frame_us;
static tl_count_q8_t motor, tip, width; // the plant: a play
static int32_t slope;                   // px Q12 for a count
static tl_px_q12_t jump;                // of the image, with the tip's direction
static int32_t tip_direction;
static bool valid, other_motion;
static uint32_t noise_seed;
static tl_px_q12_t noise;

static void begin(void) {
    TEST_ASSERT_TRUE(tl_onset_init(&detector, &config));
    tl_history_init(&history);
    count = 0;
    now_us = 1000000;
    frame_us = now_us;
    motor = 0;
    tip = 0;
    tip_direction = 1;
}

void setUp(void) {
    config = tl_onset_defaults();
    config.delay_us = 0;
    slope = TL_PX_ONE / 16;
    width = WIDTH;
    jump = 0;
    valid = true;
    other_motion = false;
    noise_seed = 1;
    noise = TL_PX_ONE / 50;
    begin();
}
void tearDown(void) {}

static int32_t random_noise(void) { // sum of three uniforms, standard deviation `noise`
    int32_t sum = 0;
    for (int i = 0; i < 3; i++) {
        noise_seed = noise_seed * 1664525U + 1013904223U;
        sum += (int32_t)(noise_seed >> 16 & 2047U) - 1024;
    }
    return (int32_t)((int64_t)sum * noise / 1024);
}

/// One millisecond on.
static void step(tl_count_q8_t to, bool frames) {
    now_us += 1000;
    motor = to;
    const tl_count_q8_t low = to - width / 2;
    const tl_count_q8_t high = to + width / 2;
    if (tip < low || tip > high) {
        tip_direction = tip < low ? 1 : -1;
        tip = tip < low ? low : high;
    }
    tl_history_push(&history, now_us, motor);
    if (frames && now_us >= frame_us) {
        frame_us += FRAME_US;
        const int32_t image = (int32_t)((int64_t)tip * slope / 256) + tip_direction * jump / 2;
        const tl_marker_t marker = {now_us,
                                    100 * TL_PX_ONE + image + random_noise(),
                                    50 * TL_PX_ONE - image / 2 + random_noise(),
                                    0,
                                    valid,
                                    other_motion};
        count += tl_onset_sample(&detector, &history, &marker, &found[count]) ? 1U : 0U;
    }
    count += tl_onset_poll(&detector, &history, now_us, &found[count]) ? 1U : 0U;
    TEST_ASSERT_TRUE(count < 60);
}

/// At 350 counts/s to `q` counts.
static void go(int32_t q) {
    const tl_count_q8_t target = q * TL_COUNT_ONE;
    while (motor != target) {
        const int32_t left = target - motor;
        step(motor + tl_clamp(left, -90, 90), true);
    }
}

static void wait_ms(uint32_t ms, bool frames) {
    while (ms-- > 0) {
        step(motor, frames);
    }
}

/// On the envelope at 1000 counts, then turned, the way back begun.
static void enter(void) {
    go(1000);
    go(990);
    count = 0;
}

static void check_reason(tl_onset_reason_t reason) {
    TEST_ASSERT_EQUAL_UINT32(1, count);
    TEST_ASSERT_EQUAL(reason, found[0].reason);
}

static void test_a_clear_reversal_is_measured_within_a_count_or_two(void) {
    enter();
    go(300);
    check_reason(TL_ONSET_USED);
    TEST_ASSERT_EQUAL_INT8(-1, found[0].direction);
    TEST_ASSERT_INT32_WITHIN(TL_COUNT_ONE, 1000 * TL_COUNT_ONE, found[0].q1);
    TEST_ASSERT_INT32_WITHIN(2 * TL_COUNT_ONE, WIDTH, found[0].width);
    TEST_ASSERT_EQUAL_INT32(found[0].q1 - found[0].width, found[0].q2);
    TEST_ASSERT_TRUE(found[0].started);
    TEST_ASSERT_TRUE(found[0].sigma > TL_COUNT_ONE / 4 && found[0].sigma < 3 * TL_COUNT_ONE / 2);
    TEST_ASSERT_INT32_WITHIN(3 * TL_COUNT_ONE, 0, found[0].stop); // delay 0 is true
    TEST_ASSERT_TRUE(found[0].sigma_stop < 2 * TL_COUNT_ONE);
    TEST_ASSERT_INT32_WITHIN(4 * TL_COUNT_ONE, 351 * TL_COUNT_ONE, found[0].speed_start);
    TEST_ASSERT_INT32_WITHIN(4 * TL_COUNT_ONE, 351 * TL_COUNT_ONE, found[0].speed_stop);
    TEST_ASSERT_INT32_WITHIN(20, 4096 * 5 / 72, found[0].slope); // sqrt(1 + 1/4) / 16 px a count = 286
    const int64_t crossing_us = (int64_t)found[0].start_us - (int64_t)found[0].turn_us;
    TEST_ASSERT_INT64_WITHIN(8000, 1422222, crossing_us); // 500 counts at 90/256 counts a millisecond
}

static void test_both_directions_and_many_in_a_row(void) {
    go(1000);
    count = 0;
    for (int i = 0; i < 10; i++) {
        go(300);
        go(1000);
    }
    TEST_ASSERT_EQUAL_UINT32(20, count);
    for (uint32_t i = 0; i < count; i++) {
        TEST_ASSERT_EQUAL(TL_ONSET_USED, found[i].reason);
        TEST_ASSERT_EQUAL_INT8(i % 2 == 0 ? -1 : 1, found[i].direction);
        TEST_ASSERT_INT32_WITHIN(2 * TL_COUNT_ONE, WIDTH, found[i].width);
    }
}

static void test_from_the_middle_of_the_backlash_it_does_not_count(void) {
    go(200); // the tip rested all the way: the play was centred
    go(-700);
    check_reason(TL_ONSET_NOT_ON_ENVELOPE);
    TEST_ASSERT_TRUE(found[0].started);
    TEST_ASSERT_EQUAL_INT32(TL_ONSET_UNKNOWN, found[0].width);
    TEST_ASSERT_EQUAL_INT32(TL_ONSET_UNKNOWN, found[0].q2);
    count = 0;
    go(200); // that start put it on the envelope
    check_reason(TL_ONSET_USED);
}

static void test_a_short_stroke_gives_a_lower_bound(void) {
    enter();
    go(600);
    go(610);
    check_reason(TL_ONSET_NO_START);
    TEST_ASSERT_FALSE(found[0].started);
    TEST_ASSERT_EQUAL_INT32(TL_ONSET_UNKNOWN, found[0].sigma);
    TEST_ASSERT_TRUE(found[0].width <= 400 * TL_COUNT_ONE);
    TEST_ASSERT_TRUE(found[0].width >= 300 * TL_COUNT_ONE);
    count = 0;
    go(1200); // it was not on an envelope there
    check_reason(TL_ONSET_NOT_ON_ENVELOPE);
}

static void test_another_degree_of_freedom_spoils_it(void) {
    enter();
    go(800);
    other_motion = true;
    go(700);
    other_motion = false;
    go(300);
    check_reason(TL_ONSET_OTHER_MOTION);
    TEST_ASSERT_FALSE(found[0].started);
}

static void test_a_lost_marker_spoils_it_a_short_loss_does_not(void) {
    enter();
    go(800);
    valid = false;
    wait_ms(300, true);
    valid = true;
    go(300);
    check_reason(TL_ONSET_USED);
    TEST_ASSERT_INT32_WITHIN(2 * TL_COUNT_ONE, WIDTH, found[0].width);
    TEST_ASSERT_TRUE(detector.lost >= 7);

    count = 0;
    go(600);
    valid = false;
    wait_ms(600, true);
    valid = true;
    check_reason(TL_ONSET_MARKER_LOST);
}

static void test_no_frames_at_all_are_a_lost_marker(void) {
    enter();
    go(800);
    wait_ms(600, false);
    check_reason(TL_ONSET_MARKER_LOST);
}

static void test_a_motor_that_waits_for_ever_times_out(void) {
    config.timeout_us = 3000000;
    begin();
    enter();
    go(800);
    wait_ms(4000, true);
    check_reason(TL_ONSET_TIMED_OUT);
}

/// When the first reversal was told: nothing but polls comes, or frames too. Not within 60 s: 0.
static tl_us_t told_us(bool frames) {
    const tl_us_t most_us = now_us + 60000000U;
    while (count == 0 && now_us < most_us) {
        step(motor, frames);
    }
    return count == 0 ? 0 : now_us;
}

static void test_a_marker_is_lost_so_long_after_it_was_last_seen(void) {
    const uint32_t lag_us = 60000; // of a poll, for frames that are late
    for (int frames = 0; frames < 2; frames++) {
        for (uint32_t delay_us = 0; delay_us <= 200000; delay_us += 200000) {
            setUp();
            config.delay_us = delay_us;
            config.lost_us = 700000;
            begin();
            enter();
            valid = false; // frames come, none shows it
            const tl_us_t told = told_us(frames != 0);
            check_reason(TL_ONSET_MARKER_LOST);
            const tl_us_t known_us = detector.seen_us > found[0].turn_us ? detector.seen_us : found[0].turn_us;
            const uint32_t due_us = delay_us + 700000, after_us = (uint32_t)(told - known_us);
            TEST_ASSERT_TRUE(after_us > due_us + (frames != 0 ? 0 : lag_us));
            TEST_ASSERT_TRUE(after_us <= due_us + (frames != 0 ? FRAME_US : lag_us) + 1000);
        }
    }
}

static void test_a_crossing_times_out_so_long_after_its_turn(void) {
    config.timeout_us = 5000000;
    begin();
    enter();
    const tl_us_t told = told_us(true);
    check_reason(TL_ONSET_TIMED_OUT);
    const uint32_t after_us = (uint32_t)(told - found[0].turn_us);
    TEST_ASSERT_TRUE(after_us > 5000000 && after_us <= 5000000 + FRAME_US + 1000); // a frame says so first
    TEST_ASSERT_FALSE(found[0].started);
    TEST_ASSERT_EQUAL_INT32(TL_ONSET_UNKNOWN, found[0].q2);
    TEST_ASSERT_EQUAL_INT32(TL_ONSET_UNKNOWN, found[0].sigma);
}

/// A stated sigma is a weight of 16 (noise_px / sigma)^2, rounded, 1 to 64.
static void test_a_frame_counts_by_its_stated_sigma(void) {
    static const struct {
        tl_px_q12_t sigma;
        int32_t weight;
    } of[] = {{0, 16}, {-1, 16}, {410, 16}, {820, 4}, {205, 64}, {200, 64}, {1, 64}, {207, 63}, {1640, 1}, {4000, 1}};
    config.noise_px = 410;
    for (unsigned i = 0; i < sizeof of / sizeof of[0]; i++) {
        begin();
        for (int n = 1; n <= 3; n++) { // the next one tells whether to believe it
            now_us += FRAME_US;
            for (uint32_t ms = FRAME_US / 1000; ms > 0; ms--) {
                tl_history_push(&history, now_us - ms * 1000 + 1000, n * 100);
            }
            const tl_marker_t marker = {now_us, n * 1000, 0, of[i].sigma, true, false};
            tl_onset_sample(&detector, &history, &marker, &found[0]);
        }
        TEST_ASSERT_EQUAL_INT32(of[i].weight, detector.waiting.weight);
    }
}

static void test_a_backlash_narrower_than_two_frames_is_too_few_samples(void) {
    width = 18 * TL_COUNT_ONE;
    enter();
    go(300);
    check_reason(TL_ONSET_TOO_FEW_SAMPLES);
    TEST_ASSERT_EQUAL_INT32(TL_ONSET_UNKNOWN, found[0].width);
}

static void test_an_image_that_hardly_moves_is_said_to(void) {
    config.sigma_usable = 4 * TL_COUNT_ONE;
    noise = TL_PX_ONE / 20;
    slope = TL_PX_ONE / 400; // 0.035 px a frame
    begin();
    go(2000);
    go(1000);
    go(2000);
    count = 0;
    go(1000);
    TEST_ASSERT_TRUE(count >= 1);
    TEST_ASSERT_EQUAL(TL_ONSET_SLOPE_TOO_SMALL, found[0].reason);
    TEST_ASSERT_TRUE(found[0].sigma > config.sigma_usable);
    TEST_ASSERT_INT32_WITHIN(4 * found[0].sigma, WIDTH, found[0].width); // uncertain, and honest
}

static void test_a_jump_at_the_onset_leaves_one_frame_of_doubt(void) {
    jump = 8 * TL_PX_ONE;
    go(1000);
    go(300);
    go(1000);
    count = 0;
    go(300);
    check_reason(TL_ONSET_USED);
    const int32_t frame = 14 * TL_COUNT_ONE;
    TEST_ASSERT_INT32_WITHIN(frame / 2 + TL_COUNT_ONE, WIDTH, found[0].width);
    TEST_ASSERT_INT32_WITHIN(TL_COUNT_ONE, frame * 10 / 35, found[0].sigma); // frame / sqrt(12)
}

static void test_a_wrong_delay_shows_in_the_stop(void) {
    config.delay_us = 20000; // the frames have none
    begin();
    go(1000);
    go(300);
    go(1000);
    count = 0;
    go(300);
    check_reason(TL_ONSET_USED);
    // true - nominal = -20 ms: 7 counts short of the turn, and the width as much too small
    TEST_ASSERT_INT32_WITHIN(2 * TL_COUNT_ONE, -7 * TL_COUNT_ONE, found[0].stop);
    TEST_ASSERT_INT32_WITHIN(2 * TL_COUNT_ONE, WIDTH - 7 * TL_COUNT_ONE, found[0].width);
}

static void test_a_marker_elsewhere_for_one_frame_is_left_out(void) {
    enter();
    go(800);
    const tl_onset_sample_t before = detector.believed;
    jump = 400 * TL_PX_ONE;
    wait_ms(FRAME_US / 1000, true);
    jump = 0;
    wait_ms(2 * FRAME_US / 1000, true); // the second frame after it decides
    go(790);
    TEST_ASSERT_EQUAL_UINT32(1, detector.lost);
    TEST_ASSERT_INT32_WITHIN(TL_PX_ONE, before.u, detector.believed.u);
    go(300);
    check_reason(TL_ONSET_USED);
    TEST_ASSERT_INT32_WITHIN(2 * TL_COUNT_ONE, WIDTH, found[0].width);
}

static void test_a_jittering_motor_tells_nothing(void) {
    enter();
    for (int i = 0; i < 40; i++) {
        step(motor + (i % 2 == 0 ? 5 : -5) * TL_COUNT_ONE, true);
    }
    TEST_ASSERT_EQUAL_UINT32(0, count);
}

static void test_a_still_image_is_no_onset(void) {
    slope = 0;
    for (int i = 0; i < 30; i++) {
        go(i % 2 == 0 ? 2000 : -2000);
    }
    for (uint32_t i = 0; i < count; i++) {
        TEST_ASSERT_FALSE(found[i].started);
    }
}

static void test_frames_out_of_order_are_ignored(void) {
    const tl_marker_t marker = {5000000, 0, 0, 0, true, false};
    tl_onset_t onset;
    TEST_ASSERT_FALSE(tl_onset_sample(&detector, &history, &marker, &onset));
    TEST_ASSERT_FALSE(tl_onset_sample(&detector, &history, &marker, &onset));
    TEST_ASSERT_EQUAL_UINT32(1, detector.ignored);
    TEST_ASSERT_EQUAL_UINT32(1, detector.lost); // the history held nothing
}

/// tl_onset.h says each.
static void test_the_defaults_are_the_header_s(void) {
    const tl_onset_config_t made = tl_onset_defaults();
    TEST_ASSERT_EQUAL_UINT32(80000, made.delay_us);
    TEST_ASSERT_EQUAL_UINT32(20000, made.guard_us);
    TEST_ASSERT_EQUAL_UINT32(400000, made.lost_us);
    TEST_ASSERT_EQUAL_UINT32(30000000, made.timeout_us);
    TEST_ASSERT_EQUAL_INT32(4 * 256, made.turn);
    TEST_ASSERT_EQUAL_INT32(384, made.sigma_wanted);
    TEST_ASSERT_EQUAL_INT32(25 * 256, made.sigma_usable);
    TEST_ASSERT_EQUAL_INT32(409, made.noise_px); // 0.1 px Q12
    TEST_ASSERT_EQUAL_UINT32(400, made.curvature);
    TEST_ASSERT_EQUAL_UINT32(384, made.threshold);
    TEST_ASSERT_EQUAL(4, made.frames_min);
    TEST_ASSERT_EQUAL(32, made.frames_max);
}

static void test_configurations_out_of_range_are_refused(void) {
    const tl_onset_config_t good = tl_onset_defaults();
    TEST_ASSERT_TRUE(tl_onset_init(&detector, &good));
#define TRY(expected, field, value)                                                                                    \
    do {                                                                                                               \
        tl_onset_config_t one = good;                                                                                  \
        one.field = (value);                                                                                           \
        TEST_ASSERT_EQUAL_MESSAGE(expected, tl_onset_init(&detector, &one), #field " = " #value);                      \
    } while (0)
#define FROM_TO(field, least, most)                                                                                    \
    do {                                                                                                               \
        TRY(true, field, least);                                                                                       \
        TRY(true, field, most);                                                                                        \
        TRY(false, field, (least) - 1);                                                                                \
        TRY(false, field, (most) + 1);                                                                                 \
    } while (0)
    TRY(true, delay_us, 0);
    TRY(true, delay_us, 400000);
    TRY(false, delay_us, 400001);
    TRY(true, guard_us, 0);
    TRY(true, guard_us, 400000);
    TRY(false, guard_us, 400001);
    FROM_TO(timeout_us, 1, 600000000);
    FROM_TO(lost_us, 1, 10000000);
    TRY(true, turn, 1);
    TRY(false, turn, 0);
    TRY(true, sigma_wanted, 1);
    TRY(false, sigma_wanted, 0);
    TRY(true, sigma_usable, good.sigma_wanted);
    TRY(false, sigma_usable, good.sigma_wanted - 1);
    FROM_TO(noise_px, 1, 8 * TL_PX_ONE);
    TRY(true, curvature, (1U << 20) - 1U);
    TRY(false, curvature, 1U << 20);
    TRY(true, threshold, 1);
    TRY(false, threshold, 0);
    FROM_TO(frames_min, 3, 32);
    FROM_TO(frames_max, 4, TL_ONSET_WINDOW - 2);
}

/// The sums of a long level are halved with what has left the window: 128 frames become (128 + 64) / 2.
static void test_a_long_level_fades(void) {
    enter();
    int32_t most = 0;
    for (uint32_t ms = 0; ms < 12000; ms++) {
        const int32_t before = detector.all.n;
        step(motor, true);
        most = detector.all.n > most ? detector.all.n : most;
        TEST_ASSERT_TRUE(detector.all.n >= before || (before == 127 && detector.all.n == 96));
    }
    TEST_ASSERT_EQUAL_INT32(127, most);
}

static void test_another_motion_forgets_the_window(void) {
    enter();
    go(800);
    other_motion = true;
    wait_ms(FRAME_US / 1000, true);
    TEST_ASSERT_EQUAL(0, detector.held);
    TEST_ASSERT_EQUAL(0, detector.known);
    TEST_ASSERT_FALSE(detector.on_envelope);
}

/// What a reversal forgets and counts.
static void test_the_frames_of_a_reversal_are_counted(void) {
    enter();
    go(300);
    check_reason(TL_ONSET_USED);
    const int32_t from = (int32_t)((found[0].turn_us + config.guard_us - 1000000U + FRAME_US - 1U) / FRAME_US);
    const int32_t until = (int32_t)((detector.arrival_us - 1000000U) / FRAME_US); // the first came at a second
    TEST_ASSERT_TRUE(found[0].frames <= until - from + 1);
    TEST_ASSERT_TRUE(found[0].frames * (int32_t)FRAME_US > 1422222); // it lasted at least until the onset
}

/// Anything at all may come over USB. The sanitizers watch.
static void test_any_input_is_survived(void) {
    uint32_t r = 12345;
    for (uint32_t round = 0; round < 20; round++) {
        begin();
        tl_us_t t = round % 2 == 0 ? 0 : UINT64_MAX / 2;
        for (uint32_t i = 0; i < 3000; i++) {
            r = r * 1664525U + 1013904223U;
            t += r >> 20;
            tl_history_push(&history, t, (int32_t)(r ^ r << 13) >> (round % 24));
            if (i % 7 == 0) {
                const tl_marker_t marker = {t,
                                            (int32_t)(r * 77777U) >> (round % 20),
                                            (int32_t)(r * 1234567U),
                                            (int32_t)(r << 7) >> (round % 28),
                                            (r & 31U) != 0,
                                            (r & 1023U) == 0};
                tl_onset_t onset;
                (void)tl_onset_sample(&detector, &history, &marker, &onset);
                (void)tl_onset_poll(&detector, &history, t, &onset);
            }
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_clear_reversal_is_measured_within_a_count_or_two);
    RUN_TEST(test_both_directions_and_many_in_a_row);
    RUN_TEST(test_from_the_middle_of_the_backlash_it_does_not_count);
    RUN_TEST(test_a_short_stroke_gives_a_lower_bound);
    RUN_TEST(test_another_degree_of_freedom_spoils_it);
    RUN_TEST(test_a_lost_marker_spoils_it_a_short_loss_does_not);
    RUN_TEST(test_no_frames_at_all_are_a_lost_marker);
    RUN_TEST(test_a_motor_that_waits_for_ever_times_out);
    RUN_TEST(test_a_marker_is_lost_so_long_after_it_was_last_seen);
    RUN_TEST(test_a_crossing_times_out_so_long_after_its_turn);
    RUN_TEST(test_a_frame_counts_by_its_stated_sigma);
    RUN_TEST(test_a_backlash_narrower_than_two_frames_is_too_few_samples);
    RUN_TEST(test_an_image_that_hardly_moves_is_said_to);
    RUN_TEST(test_a_jump_at_the_onset_leaves_one_frame_of_doubt);
    RUN_TEST(test_a_wrong_delay_shows_in_the_stop);
    RUN_TEST(test_a_marker_elsewhere_for_one_frame_is_left_out);
    RUN_TEST(test_a_jittering_motor_tells_nothing);
    RUN_TEST(test_a_still_image_is_no_onset);
    RUN_TEST(test_frames_out_of_order_are_ignored);
    RUN_TEST(test_the_defaults_are_the_header_s);
    RUN_TEST(test_a_long_level_fades);
    RUN_TEST(test_another_motion_forgets_the_window);
    RUN_TEST(test_the_frames_of_a_reversal_are_counted);
    RUN_TEST(test_configurations_out_of_range_are_refused);
    RUN_TEST(test_any_input_is_survived);
    return UNITY_END();
}
