// The hinge of one reversal and what it proves, against its equations in float64 (tl_hinge.h, tl_confirm.h).
#include "tl_confirm.h"

#include <math.h>
#include <string.h>
#include <unity.h>

#define WINDOWS 400
// Of the gain: in a plane a line and a level under noise pass each other by a little, and where they are nearest is the
// best knot but for that (in windows of few samples 1e-5).
#define PASSING 1e-4
#define NEAR    1e-6 // sums are exact; a dozen operations of 31 bits are left

static tl_onset_detector_t d;
static uint32_t seed;

void setUp(void) {}
void tearDown(void) {}

static int32_t between(int32_t low, int32_t high) { // xorshift
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return low + (int32_t)(seed % (uint32_t)(high - low + 1));
}

static double value(tl_real_t a) {
    return ldexp((double)(int32_t)(uint32_t)((uint64_t)a >> 32), (int32_t)(uint32_t)a);
}

static void near(double expected, tl_real_t got, double relative, const char *what) {
    TEST_ASSERT_TRUE_MESSAGE(fabs(value(got) - expected) <= relative * fabs(expected), what);
}

// A level, then a line, under noise; `jump` px Q12 between them. The motor goes on by about `step` Q8 counts a frame:
// below 2^17 in all, so that no travel is rounded.
static void window(int32_t frames, int32_t step, int32_t knot, int32_t slope, int32_t noise, int32_t jump) {
    const tl_onset_config_t config = tl_onset_defaults();
    TEST_ASSERT_TRUE(tl_onset_init(&d, &config));
    d.direction = (int8_t)(between(0, 1) ? 1 : -1);
    d.oldest = (uint8_t)between(0, TL_ONSET_WINDOW - 1);
    d.reference_u = between(-400000, 400000);
    d.reference_v = between(-400000, 400000);
    d.reversal.q1 = between(-1000000, 1000000);
    int32_t x = between(step / 2, step);
    for (int32_t i = 0; i < frames; i++, x += between(step / 2, 3 * step / 2)) {
        const int32_t beyond = x > knot ? (x - knot) / 64 * slope + jump : 0;
        const int32_t u = between(-noise, noise), v = between(-noise, noise), weight = between(8, 24);
        d.window[(d.oldest + (uint32_t)i) % TL_ONSET_WINDOW] = (tl_onset_sample_t){
            .q = d.reversal.q1 + d.direction * x,
            .u = d.reference_u + beyond + u,
            .v = d.reference_v - beyond / 2 + v,
            .weight = weight,
        };
        d.held++;
        const tl_hinge_point_t point = tl_hinge_image(&d, i);
        tl_hinge_add(&d.all, &point);
    }
}

// -- the equations ---------------------------------------------------------------------------------------------------

typedef struct {
    double n, w, x, xx, u, v, xu, xv, yy;
} sums_t;

static double travel(int32_t i) { // from the turn, Q8 counts
    return (double)d.direction * (tl_hinge_sample(&d, i)->q - d.reversal.q1);
}

// Of the samples from `first` up to `end`, x from `knot`.
static sums_t sums(int32_t first, int32_t end, double knot) {
    sums_t s = {0};
    for (int32_t i = first; i < end; i++) {
        const tl_onset_sample_t *sample = tl_hinge_sample(&d, i);
        const double w = sample->weight, x = travel(i) - knot;
        const double u = trunc((sample->u - d.reference_u) / 16.0), v = trunc((sample->v - d.reference_v) / 16.0);
        s.n += 1.0;
        s.w += w;
        s.x += w * x;
        s.xx += w * x * x;
        s.u += w * u;
        s.v += w * v;
        s.xu += w * x * u;
        s.xv += w * x * v;
        s.yy += w * (u * u + v * v);
    }
    return s;
}

static double scatter(sums_t s) {
    return s.yy - (s.u * s.u + s.v * s.v) / s.w;
}

typedef struct {
    double gain, cxx, slope;
} hinge_t;

static hinge_t at_knot(int32_t first, double knot) {
    const sums_t b = sums(first, d.held, knot), a = sums(0, d.held, knot);
    const double cu = a.w * b.xu - b.x * a.u, cv = a.w * b.xv - b.x * a.v, cxx = a.w * b.xx - b.x * b.x;
    const double c2 = cu * cu + cv * cv;
    return (hinge_t){cxx > 0.0 ? c2 / (a.w * cxx) : -1.0, cxx, cxx > 0.0 ? sqrt(c2) / cxx : 0.0};
}

static int32_t walk_begins(void) {
    return d.held > d.config.frames_max + 2 ? d.held - d.config.frames_max - 2 : 0;
}

static void check_fit(const tl_hinge_t *fit) {
    const sums_t all = sums(0, d.held, 0.0);
    const int32_t first = d.held - fit->beyond;
    const double knot = value(fit->knot);
    TEST_ASSERT_TRUE(travel(first - 1) - 1.0 <= knot && knot <= travel(first) + 1.0);
    const hinge_t here = at_knot(first, knot);
    near(here.gain, fit->gain, NEAR, "gain");
    near(here.slope, fit->slope, NEAR, "slope");
    TEST_ASSERT_TRUE(fabs(scatter(all) - here.gain - value(fit->residual)) <= NEAR * scatter(all));
    const sums_t b = sums(first, d.held, knot), level = sums(0, first, 0.0);
    const double variance = (b.xx / (b.w * b.xx - b.x * b.x) + 1.0 / level.w) / (here.slope * here.slope);
    near(variance, fit->variance, NEAR, "variance");
    near(travel(d.held - 1) - knot, fit->span, NEAR, "span");
    TEST_ASSERT_TRUE((double)fit->level.w == level.w && (double)fit->level.u == level.u &&
                     (double)fit->level.v == level.v && (double)fit->level.yy == level.yy &&
                     (double)fit->level.n == level.n);
    for (int32_t k = walk_begins(); k < d.held - 1; k++) { // and no sample would have been a better knot
        TEST_ASSERT_TRUE(at_knot(k + 1, travel(k)).gain <= here.gain * (1.0 + NEAR));
    }
    for (int32_t x = (int32_t)travel(first - 1); x <= (int32_t)travel(first); x++) { // nor another place of its span
        TEST_ASSERT_TRUE(at_knot(first, x).gain <= here.gain * (1.0 + PASSING));
    }
}

static void test_the_hinge_is_the_one_with_the_largest_gain(void) {
    seed = 2463534242U;
    for (int32_t i = 0; i < WINDOWS; i++) {
        const int32_t frames = between(6, TL_ONSET_WINDOW), step = between(300, 900), slope = between(40, 200);
        const int32_t knot = between(step * frames / 3, step * frames * 2 / 3), noise = between(1, 100);
        window(frames, step, knot, slope, noise, 0);
        tl_hinge_t fit;
        TEST_ASSERT_TRUE(tl_hinge_fit(&d, &fit));
        check_fit(&fit);
        const double glance = value(tl_hinge_glance(&d));
        TEST_ASSERT_TRUE(glance > 0.0 && glance <= value(fit.gain) * (1.0 + NEAR));
        double expected = 0.0; // of the knots with 2, 4, 8 .. samples beyond
        for (int32_t beyond = 2; d.held - 1 - beyond >= walk_begins(); beyond *= 2) {
            expected = fmax(expected, at_knot(d.held - beyond, travel(d.held - 1 - beyond)).gain);
        }
        near(expected, tl_hinge_glance(&d), NEAR, "glance");
    }
}

// Travel beyond 17 bits is rounded to them, 2^-17 of it, and no more than that is lost.
static void test_a_long_travel_is_scaled(void) {
    seed = 192837U;
    for (int32_t i = 0; i < WINDOWS; i++) {
        const int32_t frames = between(8, 40), step = between(20000, 60000);
        window(frames, step, step * (frames / 2), between(2, 6), 3, 0);
        tl_hinge_t fit;
        TEST_ASSERT_TRUE(tl_hinge_scale(&d, walk_begins(), tl_hinge_sample(&d, walk_begins())->q) > 0);
        TEST_ASSERT_TRUE(tl_hinge_fit(&d, &fit));
        const int32_t first = d.held - fit.beyond;
        const hinge_t here = at_knot(first, value(fit.knot));
        near(here.gain, fit.gain, 1e-3, "gain");
        near(here.slope, fit.slope, 1e-3, "slope");
        const sums_t b = sums(first, d.held, value(fit.knot)), level = sums(0, first, 0.0);
        const double variance = (b.xx / (b.w * b.xx - b.x * b.x) + 1.0 / level.w) / (here.slope * here.slope);
        near(variance, fit.variance, 1e-3, "variance");
        near(travel(d.held - 1) - value(fit.knot), fit.span, 1e-3, "span");
        const double seen = value(tl_hinge_blind(&d, fit.slope, fit.gain)); // as much as from its own knot
        TEST_ASSERT_TRUE(seen >= travel(first - 2) && seen <= travel(first));
    }
}

// What is left is a number (tl_real.h), and none where rounding would make it less.
static void test_a_hinge_without_noise_leaves_next_to_nothing(void) {
    seed = 97531U;
    int32_t none = 0;
    for (int32_t i = 0; i < WINDOWS; i++) {
        const int32_t frames = between(6, 30), slope = 32 * between(1, 6);
        window(frames, 0, 1, 0, 0, 0);
        d.all = (tl_onset_sums_t){0};
        for (int32_t k = 0; k < frames; k++) { // in whole steps of what the image is read to
            tl_onset_sample_t *sample = &d.window[(d.oldest + (uint32_t)k) % TL_ONSET_WINDOW];
            const int32_t beyond = k > frames / 2 ? (k - frames / 2) * slope : 0;
            sample->q = d.reversal.q1 + d.direction * 64 * k;
            sample->u = d.reference_u + beyond;
            sample->v = d.reference_v - beyond / 2;
            const tl_hinge_point_t point = tl_hinge_image(&d, k);
            tl_hinge_add(&d.all, &point);
        }
        tl_hinge_t fit;
        TEST_ASSERT_TRUE(tl_hinge_fit(&d, &fit));
        TEST_ASSERT_TRUE(value(fit.residual) >= 0.0 && value(fit.residual) <= NEAR * value(fit.gain));
        TEST_ASSERT_EQUAL(value(fit.residual) == 0.0, fit.residual == 0);
        none += fit.residual == 0 ? 1 : 0;
    }
    TEST_ASSERT_TRUE(none > 0 && none < WINDOWS);
}

// The window may hold two alone of all that were seen: a level, and a line from the one to the other.
static void test_two_samples_of_three_are_enough(void) {
    seed = 13579U;
    for (int32_t frames = 2; frames < 8; frames++) {
        window(frames, 500, 500 * frames - 800, 100, 10, 0);
        const uint32_t dropped = (uint32_t)frames - 2U;
        d.oldest = (uint8_t)((d.oldest + dropped) % TL_ONSET_WINDOW);
        d.held = 2;
        tl_hinge_t fit;
        TEST_ASSERT_EQUAL(frames > 2, tl_hinge_fit(&d, &fit));
        if (frames > 2) {
            TEST_ASSERT_EQUAL_INT32(1, fit.beyond);
            TEST_ASSERT_EQUAL_INT32(frames - 1, fit.level.n);
            TEST_ASSERT_TRUE(value(fit.variance) > 1e30); // one sample beyond says nothing of where its line begins
        }
        d.held = 1;
        TEST_ASSERT_FALSE(tl_hinge_fit(&d, &fit));
    }
}

static void test_how_far_a_knot_as_good_may_be(void) {
    seed = 88675123U;
    int32_t spread = 0;
    for (int32_t i = 0; i < WINDOWS; i++) {
        const int32_t frames = between(8, 40), step = between(300, 900), slope = between(2, 60);
        window(frames, step, step * frames / 2, slope, between(100, 2000), 0);
        tl_hinge_t fit;
        TEST_ASSERT_TRUE(tl_hinge_fit(&d, &fit));
        const double share = between(1, 60) / 100.0, loss = value(fit.gain) * share;
        double expected = 0.0;
        for (int32_t k = walk_begins(); k < d.held - 1; k++) {
            if (at_knot(k + 1, travel(k)).gain >= value(fit.gain) - loss) {
                expected = fmax(expected, fabs(travel(k) - value(fit.knot)));
            }
        }
        const tl_real_t got = tl_hinge_spread(&d, &fit, tl_real((int64_t)(loss * 16.0), -4));
        TEST_ASSERT_TRUE(fabs(value(got) - expected) <= 1e-5 * expected);
        spread += expected > 0.0 ? 1 : 0;
    }
    TEST_ASSERT_TRUE(spread > WINDOWS / 2);
}

static void test_what_would_have_stayed_unseen(void) {
    seed = 521288629U;
    int32_t seen = 0;
    for (int32_t i = 0; i < WINDOWS; i++) {
        const int32_t frames = between(8, 60), step = between(300, 900);
        window(frames, step, 1 << 20, 0, between(10, 300), 0);
        d.reversal.q1 += d.direction * between(0, 1) * between(0, step * frames); // some lie before the turn
        const double slope = between(1, 100) / 64.0, gain = ldexp(1.0, between(10, 40));
        double expected = 0.0;
        for (int32_t k = d.held - 2; k >= walk_begins(); k--) {
            const hinge_t hinge = at_knot(k + 1, travel(k));
            if (slope * slope * hinge.cxx / sums(0, d.held, 0.0).w >= gain) {
                expected = fmax(travel(k), 0.0);
                break;
            }
        }
        const tl_real_t got = tl_hinge_blind(&d, tl_real((int64_t)(slope * 64.0), -6), tl_real((int64_t)gain, 0));
        TEST_ASSERT_TRUE(value(got) == expected);
        seen += expected > 0.0 ? 1 : 0;
    }
    TEST_ASSERT_TRUE(seen > WINDOWS / 4 && seen < WINDOWS);
}

static void test_a_break_is_where_level_and_line_leave_least(void) {
    seed = 362436069U;
    for (int32_t i = 0; i < WINDOWS; i++) {
        const int32_t frames = between(8, 40), step = between(300, 1500), knot = step * frames / 2;
        const int32_t slope = between(20, 100), noise = between(1, 300);
        const bool clear = between(0, 3) > 0; // else there is none, and what noise makes the most of is found
        window(frames, step, knot, clear ? slope : 0, clear ? noise : 50 + noise, clear ? between(20000, 60000) : 0);
        double most = -1.0;
        int32_t at = -1;
        for (int32_t k = walk_begins(); k <= d.held - 4; k++) {
            const sums_t b = sums(k + 1, d.held, 0.0);
            const double det = b.w * b.xx - b.x * b.x, cu = b.w * b.xu - b.x * b.u, cv = b.w * b.xv - b.x * b.v;
            const double line = (cu * cu + cv * cv) / (b.w * det);
            const double gain = scatter(sums(0, d.held, 0.0)) - scatter(sums(0, k + 1, 0.0)) - scatter(b) + line;
            at = gain > most ? k : at;
            most = fmax(gain, most);
        }
        tl_hinge_break_t fit;
        TEST_ASSERT_TRUE(tl_hinge_break(&d, &fit));
        near(most, fit.gain, NEAR, "gain");
        TEST_ASSERT_EQUAL_INT32((int32_t)travel(at), fit.low);
        TEST_ASSERT_EQUAL_INT32((int32_t)travel(at + 1), fit.high);
        TEST_ASSERT_EQUAL_INT32(d.held - 1 - at, fit.beyond);
        TEST_ASSERT_EQUAL_INT32(at + 1, fit.level.n);
    }
}

// Travel in 17 bits and a sign: the scale is the smallest that leaves them.
static void test_the_scale_is_the_smallest(void) {
    for (int32_t bits = 0; bits < 12; bits++) {
        const int32_t most = (1 << (17 + bits)) - 1;
        const int32_t travels[] = {most, most + 1, -most - 1, -most - 2};
        for (uint32_t i = 0; i < 8U; i++) {
            window(3, 1, 1, 1, 1, 0);
            d.direction = (int8_t)(i < 4U ? 1 : -1);
            for (uint32_t k = 0; k < 3U; k++) {
                d.window[(d.oldest + k) % TL_ONSET_WINDOW].q = k == 1U ? 5000 + d.direction * travels[i % 4U] : 5000;
            }
            TEST_ASSERT_EQUAL_INT32(i % 2U == 0U ? bits : bits + 1, tl_hinge_scale(&d, 0, 5000));
            TEST_ASSERT_EQUAL_INT32(0, tl_hinge_scale(&d, 2, 5000)); // of those from there on
        }
    }
}

static void test_a_motor_that_rests_has_no_hinge(void) {
    seed = 24680U;
    for (int32_t frames = 3; frames < 20; frames++) {
        window(frames, 0, 1 << 20, 0, 100, 0);
        for (int32_t i = 0; i < TL_ONSET_WINDOW; i++) {
            d.window[i].q = d.reversal.q1 + 77;
        }
        tl_hinge_t fit;
        tl_hinge_break_t broken;
        TEST_ASSERT_FALSE(tl_hinge_fit(&d, &fit));
        TEST_ASSERT_FALSE(tl_hinge_break(&d, &broken));
        TEST_ASSERT_TRUE(tl_hinge_glance(&d) == 0);
    }
}

// Where a line by least squares comes to the level's mean, how sure that is, and what the line explains.
static void test_a_line_meets_a_level(void) {
    seed = 86420U;
    for (int32_t i = 0; i < WINDOWS; i++) {
        window(between(6, 20), between(300, 900), 0, between(40, 200), 300, 0);
        const int32_t first = between(2, d.held - 3), scale = between(0, 4);
        tl_onset_sums_t line = {0};
        for (int32_t k = first; k < d.held; k++) {
            const tl_hinge_point_t point = tl_hinge_point(&d, k, tl_hinge_sample(&d, first)->q, 0);
            tl_hinge_add(&line, &point);
        }
        const tl_onset_sums_t level = tl_hinge_without(&d.all, &line);
        tl_hinge_meeting_t meeting;
        TEST_ASSERT_TRUE(tl_hinge_meet(&line, &level, scale, &meeting));
        const sums_t b = sums(first, d.held, travel(first)), a = sums(0, first, 0.0);
        const double det = b.w * b.xx - b.x * b.x;
        const double bu = (b.w * b.xu - b.x * b.u) / det, bv = (b.w * b.xv - b.x * b.v) / det, b2 = bu * bu + bv * bv;
        const double off = (bu * (a.u / a.w - b.u / b.w) + bv * (a.v / a.w - b.v / b.w)) / b2;
        near(b2 * det / b.w, meeting.gain, NEAR, "gain");
        near(ldexp(sqrt(b2), -scale), meeting.slope, NEAR, "slope");
        near(ldexp((1.0 / a.w + 1.0 / b.w + off * off * b.w / det) / b2, 2 * scale), meeting.variance, 1e-4,
             "variance");
        const double x = ldexp(b.x / b.w + off, scale), way = ldexp(fabs(b.x / b.w) + fabs(off), scale);
        TEST_ASSERT_TRUE(fabs(value(meeting.x) - x) <= NEAR * way + ldexp(1e-4, scale));
    }
}

static void test_a_line_is_determined_by_two_samples_and_a_level_by_one(void) {
    const tl_onset_sums_t level = {.w = 16, .n = 1};
    const tl_onset_sums_t line = {.w = 32, .x = 64, .xx = 160, .u = 320, .v = 64, .xu = 720, .xv = 130, .n = 2};
    tl_hinge_meeting_t meeting;
    TEST_ASSERT_TRUE(tl_hinge_meet(&line, &level, 0, &meeting));
    tl_onset_sums_t other = level;
    other.n = 0;
    TEST_ASSERT_FALSE(tl_hinge_meet(&line, &other, 0, &meeting));
    other = line;
    other.n = 1;
    TEST_ASSERT_FALSE(tl_hinge_meet(&other, &level, 0, &meeting));
    other = line;
    other.xx = 128; // w xx = x^2: both samples at one place
    TEST_ASSERT_FALSE(tl_hinge_meet(&other, &level, 0, &meeting));
    other.xx = 129; // the least that tells them apart
    other.w = 32;
    TEST_ASSERT_TRUE(tl_hinge_meet(&other, &level, 0, &meeting));
    other = (tl_onset_sums_t){.w = 1, .xx = 1, .u = 1, .xu = 3, .n = 2}; // a determinant of 1
    TEST_ASSERT_TRUE(tl_hinge_meet(&other, &level, 0, &meeting));
    other = line;
    other.xu = 640; // the image does not move along it
    other.xv = 128;
    TEST_ASSERT_FALSE(tl_hinge_meet(&other, &level, 0, &meeting));
}

// -- what it proves --------------------------------------------------------------------------------------------------

static void test_the_gain_that_confirms(void) {
    const tl_onset_config_t config = tl_onset_defaults();
    TEST_ASSERT_TRUE(tl_onset_init(&d, &config));
    for (int32_t dof = 1; dof < 200; dof++) {
        const double nu = d.noise_dof + dof, x = config.threshold / 16.0 / nu, unit = 300.0;
        const double expected = nu * (pow(1.0 + x / 256.0, 256.0) - 1.0) * unit; // e^x to x^2 / 512
        near(expected, tl_confirm_required(&d, tl_real(300, 0), dof), 1e-5, "required");
        TEST_ASSERT_TRUE(fabs(expected / (nu * (exp(x) - 1.0) * unit) - 1.0) < x * x / 256.0 + x / 256.0);
    }
}

static void test_what_curvature_and_the_encoder_add_to_a_knot(void) {
    tl_onset_config_t config = tl_onset_defaults();
    for (int32_t i = 1; i < 200; i++) {
        config.curvature = (uint32_t)(i * 37);
        const double span = i * 1234.0, curvature = ldexp(config.curvature, -20) / 256.0; // of a Q8 count
        const double bias = curvature * span * span / 12.0;
        const tl_real_t along = tl_real((int64_t)span, 0);
        near(bias * bias, tl_confirm_curvature_bias2(&config, along), NEAR, "bias");
        const double steps = 2.0 * 256.0 * 256.0 / 12.0; // of two encoder positions
        near(i * 0.5 * 3.0 + steps + bias * bias,
             tl_confirm_knot_variance(&config, tl_real(i, -1), tl_real(3, 0), along), NEAR, "variance");
    }
}

static void test_noise_is_remembered_once_it_is_measured(void) {
    tl_onset_config_t config = tl_onset_defaults();
    config.noise_px = 160 * 16;
    TEST_ASSERT_TRUE(tl_onset_init(&d, &config));
    const double prior = 8.0 * 16.0 * 160.0 * 160.0; // eight degrees of freedom of the stated noise
    near((prior + 5000.0) / (8.0 + 3.0), tl_confirm_unit_variance(&d, tl_real(5000, 0), 3), NEAR, "stated");
    tl_confirm_remember(&d, tl_real(160, 0), 15); // too few to forget what was stated
    TEST_ASSERT_EQUAL_INT32(23, d.noise_dof);
    near((prior + 160.0 + 5000.0) / (23.0 + 3.0), tl_confirm_unit_variance(&d, tl_real(5000, 0), 3), NEAR, "both");
    tl_confirm_remember(&d, tl_real(16000, 0), 16);
    TEST_ASSERT_EQUAL_INT32(16, d.noise_dof);
    near((16000.0 + 5000.0) / (16.0 + 3.0), tl_confirm_unit_variance(&d, tl_real(5000, 0), 3), NEAR, "measured");
    tl_confirm_remember(&d, tl_real(16000, 0), 0);
    TEST_ASSERT_EQUAL_INT32(16, d.noise_dof);
    tl_confirm_remember(&d, tl_real(512000, 0), 497); // one more than is kept: half of it
    TEST_ASSERT_EQUAL_INT32(256, d.noise_dof);
    TEST_ASSERT_EQUAL_INT64(264000, d.noise_sum);
    near(26.0, tl_confirm_unit_variance(&d, tl_real(-264000, 0), 1), NEAR, "never below the image's own resolution");
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_hinge_is_the_one_with_the_largest_gain);
    RUN_TEST(test_a_long_travel_is_scaled);
    RUN_TEST(test_a_hinge_without_noise_leaves_next_to_nothing);
    RUN_TEST(test_two_samples_of_three_are_enough);
    RUN_TEST(test_how_far_a_knot_as_good_may_be);
    RUN_TEST(test_what_would_have_stayed_unseen);
    RUN_TEST(test_a_break_is_where_level_and_line_leave_least);
    RUN_TEST(test_the_scale_is_the_smallest);
    RUN_TEST(test_a_motor_that_rests_has_no_hinge);
    RUN_TEST(test_a_line_meets_a_level);
    RUN_TEST(test_a_line_is_determined_by_two_samples_and_a_level_by_one);
    RUN_TEST(test_the_gain_that_confirms);
    RUN_TEST(test_what_curvature_and_the_encoder_add_to_a_knot);
    RUN_TEST(test_noise_is_remembered_once_it_is_measured);
    return UNITY_END();
}
