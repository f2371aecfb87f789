// The onset detector against its model in float64 (onset_model.h, onset_follower.h): after every call the same is told
// and counted, whatever motor, image, camera and configuration do.
#include "draws.h"
#include "onset_follower.h"

#include <unity.h>

#ifndef LIVES
#define LIVES 300U
#endif
#define LIFE_MS  24000
#define LEAST_OF (LIVES / 20U) // each reason is told at least so often

static tl_onset_detector_t d;
static tl_history_t history;
static model_t model;
static uint32_t told[8], seen_jumps;

// The plant: a motor that goes from place to place, a play behind it, a camera that sees the tip some time ago.
static struct {
    int32_t q, target, speed, pause_ms, width, tip, slope, jump, noise, frame_ms, true_delay_ms, elsewhere_of, reach;
    int32_t past[512], past_way[512]; // tip, and which way it last went, by the millisecond
} plant;

void setUp(void) {}
void tearDown(void) {}

static int32_t magnitude(int32_t low_bits, int32_t high_bits) { // as often of each size
    const int32_t bits = between(low_bits, high_bits);
    return between(1 << bits, (2 << bits) - 1);
}

static int32_t noise(void) { // about normal
    int32_t sum = 0;
    for (int i = 0; i < 4; i++) {
        sum += between(-plant.noise, plant.noise);
    }
    return sum;
}

static tl_onset_config_t any_config(void) {
    tl_onset_config_t c = tl_onset_defaults();
    c.delay_us = (uint32_t)between(0, 150000);
    c.guard_us = (uint32_t)between(0, 80000);
    c.lost_us = (uint32_t)between(150000, 600000);
    c.timeout_us = (uint32_t)between(1500000, 8000000);
    c.turn = between(300, 3000);
    c.noise_px = between(40, 2000);
    c.curvature = once_in(3) ? 0 : (uint32_t)magnitude(4, 13);
    c.threshold = (uint16_t)between(8 * 16, 30 * 16);
    c.frames_min = (uint8_t)between(3, 6);
    c.frames_max = (uint8_t)between(c.frames_min, 62);
    c.sigma_wanted = magnitude(6, 10);
    c.sigma_usable = c.sigma_wanted + magnitude(6, 12);
    return c;
}

static void begin_life(void) {
    const tl_onset_config_t config = any_config();
    TEST_ASSERT_TRUE(tl_onset_init(&d, &config));
    model_begins(&model, &config);
    tl_history_init(&history);
    memset(&plant, 0, sizeof plant);
    plant.q = plant.target = plant.tip = between(-100000, 100000);
    plant.width = magnitude(11, 17);
    plant.slope = magnitude(2, 7) * (once_in(2) ? 1 : -1);
    plant.jump = once_in(3) ? magnitude(8, 17) : 0;
    plant.noise = magnitude(6, 10);
    plant.frame_ms = between(8, 45);
    plant.true_delay_ms = (int32_t)config.delay_us / 1000 + between(-10, 10);
    plant.true_delay_ms = plant.true_delay_ms < 0 ? 0 : plant.true_delay_ms;
    plant.elsewhere_of = once_in(2) ? between(8, 60) : 100000;
    plant.reach = plant.width * between(2, 6);
    for (uint32_t i = 0; i < 512; i++) {
        plant.past[i] = plant.tip;
    }
}

static void motor_goes(void) {
    if (plant.pause_ms > 0) {
        plant.pause_ms--;
    } else if (plant.q == plant.target) {
        plant.target += once_in(6) ? between(-plant.width, plant.width) : between(-plant.reach, plant.reach);
        plant.target = tl_clamp(plant.target, -3000000, 3000000);
        plant.speed = 1 + plant.width / (plant.frame_ms * between(2, 40));
        plant.pause_ms = once_in(3) ? between(0, 1500) : 0;
    } else {
        plant.q += tl_clamp(plant.target - plant.q, -plant.speed, plant.speed);
    }
    plant.tip = tl_clamp(plant.tip, plant.q - plant.width / 2, plant.q + plant.width / 2);
}

static tl_marker_t frame_at(uint64_t now_us, uint32_t ms, bool away) {
    const uint32_t then = (ms + 512U - (uint32_t)plant.true_delay_ms) % 512U;
    const int32_t tip = (int32_t)((int64_t)plant.past[then] * plant.slope / 256) + plant.past_way[then] * plant.jump;
    const int32_t off = once_in(plant.elsewhere_of) ? magnitude(4, 16) : 0;
    return (tl_marker_t){.arrival_us = now_us + (once_in(200) ? 0 : (uint64_t)between(0, 900)),
                         .u = tip + noise() + off,
                         .v = 30000 - tip / 3 + noise() - off,
                         .sigma = once_in(4) ? magnitude(3, 12) : 0,
                         .valid = !away,
                         .other_motion = once_in(900)};
}

#define SAME(of_model, of_detector) TEST_ASSERT_EQUAL_INT64((int64_t)(of_model), (int64_t)(of_detector))

static void check_told(const tl_onset_t *expected, const tl_onset_t *got) {
    SAME(expected->reason, got->reason);
    SAME(expected->started, got->started);
    SAME(expected->direction, got->direction);
    SAME(expected->frames, got->frames);
    SAME(expected->turn_us, got->turn_us);
    SAME(expected->q1, got->q1);
    TEST_ASSERT_INT32_WITHIN(1, expected->q2, got->q2); // a half may be rounded either way
    TEST_ASSERT_INT32_WITHIN(1, expected->width, got->width);
    TEST_ASSERT_INT32_WITHIN(1 + (uint32_t)(model.slack * expected->sigma), expected->sigma, got->sigma);
    TEST_ASSERT_INT32_WITHIN(1, expected->stop, got->stop);
    TEST_ASSERT_INT32_WITHIN(1 + (uint32_t)(model.slack * expected->sigma_stop), expected->sigma_stop, got->sigma_stop);
    TEST_ASSERT_INT32_WITHIN(1, expected->speed_stop, got->speed_stop);
    TEST_ASSERT_INT32_WITHIN(1, expected->speed_start, got->speed_start);
    TEST_ASSERT_INT32_WITHIN(1, expected->slope, got->slope);
    TEST_ASSERT_INT32_WITHIN(1 + (uint32_t)(model.slack * expected->noise), expected->noise, got->noise);
    TEST_ASSERT_INT64_WITHIN((uint64_t)model.slack_us, (int64_t)expected->start_us, (int64_t)got->start_us);
}

static void check_kept(void) {
    SAME(model.held, d.held);
    SAME(model.known, d.known);
    SAME(model.ignored, d.ignored);
    SAME(model.lost, d.lost);
    SAME(model.missed, d.missed);
    SAME(model.noise_dof, d.noise_dof);
    SAME(model.on_envelope, d.on_envelope);
    if (model.crossing) {
        SAME(model.entered, d.entered);
        SAME(model.all.n, d.all.n);
        SAME(model.all.w, d.all.w);
        SAME(model.all.u, d.all.u);
        SAME(model.all.v, d.all.v);
        SAME(model.all.yy, d.all.yy);
        SAME(model.approach.n, d.approach.n);
    }
    TEST_ASSERT_INT64_WITHIN((uint64_t)model.noise_slack, model.noise_sum, d.noise_sum);
    model.noise_slack = 0; // taken over, so that it does not add up
    model.noise_sum = d.noise_sum;
}

static void check(bool expected, const tl_onset_t *of_model, bool got, const tl_onset_t *of_detector) {
    SAME(expected, got);
    if (got) {
        check_told(of_model, of_detector);
        told[of_detector->reason]++;
        seen_jumps += plant.jump != 0 && of_detector->reason == TL_ONSET_USED ? 1U : 0U;
    }
    check_kept();
}

static void live(uint64_t begin_us) {
    begin_life();
    int32_t to_frame = 1, away_ms = 0, silent_ms = 0;
    for (uint32_t ms = 0; ms < LIFE_MS; ms++) {
        const uint64_t now_us = begin_us + ms * UINT64_C(1000);
        const int32_t before = plant.tip;
        motor_goes();
        plant.past[ms % 512U] = plant.tip;
        const int32_t way = plant.tip > before ? 1 : (plant.tip < before ? -1 : 0);
        plant.past_way[ms % 512U] = way != 0 ? way : plant.past_way[(ms + 511U) % 512U];
        tl_history_push(&history, now_us, plant.q);
        away_ms = away_ms > 0 ? away_ms - 1 : (once_in(4000) ? between(1, 900) : 0);
        silent_ms = silent_ms > 0 ? silent_ms - 1 : (once_in(6000) ? between(1, 1200) : 0);
        tl_onset_t of_model = {0}, of_detector = {0};
        if (--to_frame <= 0 && silent_ms == 0) {
            to_frame = plant.frame_ms + between(0, 3);
            const tl_marker_t marker = frame_at(now_us, ms, away_ms > 0);
            const bool expected = model_sees(&model, &history, &marker, &of_model);
            check(expected, &of_model, tl_onset_sample(&d, &history, &marker, &of_detector), &of_detector);
        }
        if (ms % 50U == 0) {
            const bool expected = model_polls(&model, &history, now_us, &of_model);
            check(expected, &of_model, tl_onset_poll(&d, &history, now_us, &of_detector), &of_detector);
        }
    }
}

static void test_the_detector_is_its_model(void) {
    seed = 1234567U;
    for (uint32_t life = 0; life < LIVES; life++) {
        live(life % 3U == 0 ? 0 : (life % 3U == 1 ? UINT64_C(0xffffffff) - 9000000U : UINT64_C(5000000000)));
    }
    for (uint32_t reason = 0; reason < 8; reason++) {
        TEST_ASSERT_TRUE(told[reason] >= LEAST_OF);
    }
    TEST_ASSERT_TRUE(seen_jumps >= LEAST_OF);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_detector_is_its_model);
    return UNITY_END();
}
