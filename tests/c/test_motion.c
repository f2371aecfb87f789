#include "tautline/tl_motion.h"

#include <unity.h>

#define RATE 1000U

static tl_motion_t motion;
static tl_motion_config_t config;

void setUp(void) {
    motion = (tl_motion_t){0};
    config = (tl_motion_config_t){
        .low = -1000 * TL_COUNT_ONE,
        .high = 1000 * TL_COUNT_ONE,
        .speed = {350 * TL_COUNT_ONE, 700 * TL_COUNT_ONE},
        .speed_count = 1,
        .cycles = 3,
        .transit = 4000 * TL_COUNT_ONE,
        .acceleration = 50000 * TL_COUNT_ONE,
        .approach = 50 * TL_COUNT_ONE,
        .stroke_max = 200 * TL_COUNT_ONE,
        .host_timeout_us = 0,
        .rate_hz = RATE,
    };
}
void tearDown(void) {}

static void start_at(tl_count_q8_t q) {
    TEST_ASSERT_EQUAL(TL_MOTION_OK, tl_motion_start(&motion, &config, q));
}

static void refuse(tl_motion_error_t expected) {
    TEST_ASSERT_EQUAL(expected, tl_motion_start(&motion, &config, 0));
    TEST_ASSERT_EQUAL(TL_MOTION_IDLE, tl_motion_state(&motion)); // nothing changed
    setUp();
}

static void refuse_again(tl_motion_error_t expected) { // the one that runs goes on
    const tl_motion_t before = motion;
    TEST_ASSERT_EQUAL(expected, tl_motion_start(&motion, &config, 0));
    TEST_ASSERT_EQUAL_MEMORY(&before, &motion, sizeof(before));
}

static void start_refused_at(tl_count_q8_t q) {
    config.stroke_max = 200 * TL_COUNT_ONE;
    TEST_ASSERT_EQUAL(TL_MOTION_BAD_RANGE, tl_motion_start(&motion, &config, q));
}

static void test_a_motion_at_a_limit_itself_may_be(void) {
    config.high = config.low + 2 * config.stroke_max + 1;
    start_at(0);
    setUp();
    config.low = -(1 << 30); // 4 M counts
    config.high = 1 << 30;
    start_at(1 << 30);
    start_at(-(1 << 30));
    config.stroke_max = 1 << 30; // half of the range: it has to exceed both
    refuse_again(TL_MOTION_BAD_RANGE);
    config.stroke_max--;
    start_at(0);
    config.stroke_max = (1 << 30) + 1;
    refuse_again(TL_MOTION_BAD_STROKE);
    start_refused_at((1 << 30) + 1);
    start_refused_at(-(1 << 30) - 1);
    setUp();
    config.stroke_max = 2 * config.approach;
    config.acceleration = 200000 * TL_COUNT_ONE; // stops within it
    start_at(0);
    config.approach = TL_COUNT_ONE;
    config.stroke_max = 200 * TL_COUNT_ONE;
    start_at(0);
    config.speed_count = TL_MOTION_SPEEDS;
    for (uint32_t i = 0; i < TL_MOTION_SPEEDS; i++) {
        config.speed[i] = TL_COUNT_ONE / 4 + (int32_t)i;
    }
    start_at(0);
    config.speed[1] = TL_COUNT_ONE / 4 - 1;
    refuse_again(TL_MOTION_BAD_SPEED);
    config.speed[1] = config.transit;
    start_at(0);
    setUp();
    for (config.cycles = 1; config.cycles <= 100; config.cycles = (uint8_t)(config.cycles + 99)) {
        start_at(0);
    }
    setUp();
    for (config.rate_hz = 1000; config.rate_hz <= 10000; config.rate_hz += 9000) {
        start_at(0);
    }
    config.rate_hz = 999;
    refuse_again(TL_MOTION_BAD_RATE);
    setUp();
    config.stroke_max = 100000 * TL_COUNT_ONE;
    config.low = -300000 * TL_COUNT_ONE;
    config.high = 300000 * TL_COUNT_ONE;
    config.acceleration = 1000000 * TL_COUNT_ONE;
    config.transit = 100000 * TL_COUNT_ONE; // 100 counts a tick
    start_at(0);
}

// v^2 / 2a from transit, and half a tick at it, fits a stroke to the count.
static void test_a_stroke_holds_the_way_to_rest(void) {
    config.acceleration = 40960 * TL_COUNT_ONE; // a power of two's share of a count a tick^2: 0.04096
    config.transit = 4096 * TL_COUNT_ONE;       // 4.096 counts a tick, 100 ticks of braking
    const double ticks = 100.0 + 1.0, way = 4.096 / 2.0 * ticks;
    config.approach = 10 * TL_COUNT_ONE;
    config.stroke_max = (int32_t)((way + 0.1) * TL_COUNT_ONE);
    start_at(0);
    config.stroke_max = (int32_t)((way - 0.1) * TL_COUNT_ONE);
    refuse_again(TL_MOTION_BAD_ACCELERATION);
}

static void test_a_motion_that_cannot_be_is_refused_with_its_reason(void) {
    config.high = config.low + 2 * config.stroke_max;
    refuse(TL_MOTION_BAD_RANGE);
    config.low = INT32_MIN;
    refuse(TL_MOTION_BAD_RANGE);
    config.speed_count = 0;
    refuse(TL_MOTION_BAD_SPEED);
    config.speed_count = TL_MOTION_SPEEDS + 1;
    refuse(TL_MOTION_BAD_SPEED);
    config.speed[0] = config.transit + 1;
    refuse(TL_MOTION_BAD_SPEED);
    config.speed[0] = 0;
    refuse(TL_MOTION_BAD_SPEED);
    config.acceleration = 0;
    refuse(TL_MOTION_BAD_ACCELERATION);
    config.acceleration = 10000 * TL_COUNT_ONE; // 800 counts to brake from transit, the stroke is 200
    refuse(TL_MOTION_BAD_ACCELERATION);
    config.approach = 0;
    refuse(TL_MOTION_BAD_STROKE);
    config.stroke_max = config.approach;
    refuse(TL_MOTION_BAD_STROKE);
    config.cycles = 0;
    refuse(TL_MOTION_BAD_CYCLES);
    config.cycles = 101;
    refuse(TL_MOTION_BAD_CYCLES);
    config.rate_hz = 0;
    refuse(TL_MOTION_BAD_RATE);
    config.rate_hz = 10001;
    refuse(TL_MOTION_BAD_RATE);
    config.acceleration = INT32_MAX;
    config.transit = 100001 * TL_COUNT_ONE; // over 100 counts a tick
    refuse(TL_MOTION_BAD_RATE);
}

static void test_idle_rests_at_zero(void) {
    const tl_motion_reference_t r = tl_motion_tick(&motion);
    TEST_ASSERT_EQUAL_INT32(0, r.q);
    TEST_ASSERT_EQUAL_INT32(0, r.velocity);
    TEST_ASSERT_EQUAL_UINT16(0, tl_motion_progress(&motion));
    tl_motion_stop(&motion);
    tl_motion_onset(&motion, 1);
    TEST_ASSERT_EQUAL(TL_MOTION_IDLE, tl_motion_state(&motion));
}

/// Ticks to the end; an onset 100 counts after each turn if `onsets`. Counts turns and measures the extremes.
static uint32_t run(bool onsets, int32_t *lowest, int32_t *highest) {
    uint32_t turns = 0;
    int32_t direction = 0;
    int32_t turn_q = 0;
    int32_t last = tl_motion_tick(&motion).q;
    *lowest = last;
    *highest = last;
    for (uint32_t i = 0; i < 200000 && tl_motion_state(&motion) == TL_MOTION_RUNNING; i++) {
        const tl_motion_reference_t r = tl_motion_tick(&motion);
        const int32_t step = r.q - last;
        if (step != 0 && (direction == 0 || (step > 0) != (direction > 0))) {
            turns += direction != 0 ? 1U : 0U;
            direction = step > 0 ? 1 : -1;
            turn_q = last;
        }
        const int32_t stroke = direction > 0 ? r.q - turn_q : turn_q - r.q;
        if (onsets && stroke > 100 * TL_COUNT_ONE) {
            tl_motion_onset(&motion, (int8_t)direction);
        }
        last = r.q;
        *lowest = last < *lowest ? last : *lowest;
        *highest = last > *highest ? last : *highest;
    }
    return turns;
}

static void test_every_pass_has_its_reversals_with_and_without_onsets(void) {
    int32_t lowest;
    int32_t highest;
    config.speed_count = 2;
    for (int onsets = 0; onsets < 2; onsets++) {
        start_at(0);
        // first to the low end; then 2 passes for each of 2 speeds, 2 cycles + 1 reversals each
        TEST_ASSERT_EQUAL_UINT32(4U * (2U * config.cycles + 1U), run(onsets != 0, &lowest, &highest));
        TEST_ASSERT_EQUAL(TL_MOTION_COMPLETE, tl_motion_state(&motion));
        TEST_ASSERT_EQUAL_UINT16(1000, tl_motion_progress(&motion));
        TEST_ASSERT_EQUAL_INT32(config.low, lowest);
        TEST_ASSERT_EQUAL_INT32(config.high, highest);
    }
}

static void test_an_onset_ends_the_stroke_after_the_approach(void) {
    start_at(config.low);
    int32_t last = config.low;
    int32_t highest = config.low;
    for (;;) { // up by the stroke that makes sure of the envelope, and back to the low end
        last = tl_motion_tick(&motion).q;
        highest = last > highest ? last : highest;
        if (highest > config.low && last == config.low) {
            break;
        }
    }
    TEST_ASSERT_EQUAL_INT32(config.low + config.stroke_max, highest);
    while (last < config.low + 60 * TL_COUNT_ONE) {
        last = tl_motion_tick(&motion).q;
    }
    tl_motion_onset(&motion, -1); // late, of a reversal long gone: nothing
    tl_motion_onset(&motion, 1);
    // The first turning point is half a step beyond the approach after the onset; three steps lead to the far
    // end.
    const int32_t first = last + config.approach;
    highest = last;
    while ((last = tl_motion_tick(&motion).q) >= highest) {
        highest = last;
    }
    TEST_ASSERT_INT32_WITHIN(3 * TL_COUNT_ONE, first + (config.high - first) / 6, highest);
    // The way back ends `approach` after the onset, plus braking.
    while (last > highest - 80 * TL_COUNT_ONE) {
        last = tl_motion_tick(&motion).q;
    }
    const int32_t onset = last;
    tl_motion_onset(&motion, -1);
    int32_t lowest = last;
    while ((last = tl_motion_tick(&motion).q) <= lowest) {
        lowest = last;
    }
    TEST_ASSERT_TRUE(onset - lowest >= config.approach);
    TEST_ASSERT_TRUE(onset - lowest <= config.approach + 3 * TL_COUNT_ONE); // 350^2 / 2 / 50000 is 1.2
}

static void test_stop_is_at_rest_within_the_limits_and_says_so(void) {
    start_at(0);
    for (uint32_t i = 0; i < 100; i++) {
        (void)tl_motion_tick(&motion);
    }
    const tl_motion_reference_t moving = tl_motion_tick(&motion);
    TEST_ASSERT_INT32_WITHIN(TL_COUNT_ONE, -config.transit, moving.velocity);
    tl_motion_stop(&motion);
    TEST_ASSERT_EQUAL(TL_MOTION_STOPPING, tl_motion_state(&motion));
    int32_t q = moving.q;
    while (tl_motion_state(&motion) == TL_MOTION_STOPPING) {
        q = tl_motion_tick(&motion).q;
    }
    TEST_ASSERT_EQUAL(TL_MOTION_STOPPED, tl_motion_state(&motion));
    TEST_ASSERT_TRUE(moving.q - q <= 160 * TL_COUNT_ONE); // 4000^2 / 2 / 50000
    TEST_ASSERT_EQUAL_INT32(q, tl_motion_tick(&motion).q);
    TEST_ASSERT_EQUAL_INT32(0, tl_motion_tick(&motion).velocity);
    TEST_ASSERT_TRUE(tl_motion_progress(&motion) < 1000);
}

static void test_a_silent_host_stops_it_a_frame_keeps_it_going(void) {
    config.host_timeout_us = 100000;
    start_at(0);
    for (uint32_t i = 0; i < 500; i++) {
        if (i % 99 == 0) {
            tl_motion_frame(&motion);
        }
        (void)tl_motion_tick(&motion);
        TEST_ASSERT_EQUAL(TL_MOTION_RUNNING, tl_motion_state(&motion));
    }
    for (uint32_t i = 0; i < 300; i++) {
        (void)tl_motion_tick(&motion);
    }
    TEST_ASSERT_EQUAL(TL_MOTION_HOST_LOST, tl_motion_state(&motion));
    tl_motion_frame(&motion); // too late
    TEST_ASSERT_EQUAL_INT32(0, tl_motion_tick(&motion).velocity);
    TEST_ASSERT_EQUAL(TL_MOTION_HOST_LOST, tl_motion_state(&motion));
}

static void test_slow_speeds_are_exact(void) {
    config.speed[0] = TL_COUNT_ONE / 4; // a quarter count a second
    config.transit = TL_COUNT_ONE / 4;
    config.acceleration = TL_COUNT_ONE * 10;
    start_at(1000 * TL_COUNT_ONE);
    for (uint32_t i = 0; i < 100000; i++) {
        (void)tl_motion_tick(&motion);
    }
    // 100 s at 0.25 counts/s less half the time of acceleration (25 ms)
    TEST_ASSERT_INT32_WITHIN(2, 1000 * TL_COUNT_ONE - 25 * TL_COUNT_ONE, tl_motion_tick(&motion).q);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_motion_at_a_limit_itself_may_be);
    RUN_TEST(test_a_stroke_holds_the_way_to_rest);
    RUN_TEST(test_a_motion_that_cannot_be_is_refused_with_its_reason);
    RUN_TEST(test_idle_rests_at_zero);
    RUN_TEST(test_every_pass_has_its_reversals_with_and_without_onsets);
    RUN_TEST(test_an_onset_ends_the_stroke_after_the_approach);
    RUN_TEST(test_stop_is_at_rest_within_the_limits_and_says_so);
    RUN_TEST(test_a_silent_host_stops_it_a_frame_keeps_it_going);
    RUN_TEST(test_slow_speeds_are_exact);
    return UNITY_END();
}
