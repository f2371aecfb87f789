// The reference against its equations: limits in ticks, the shortest time that they allow, braking, what it says.
#include "tautline/tl_fixed.h"
#include "tautline/tl_reference.h"

#include <math.h>
#include <stdlib.h>
#include <unity.h>

#define COUNTS(n) ((tl_count_q8_t)((n) * TL_COUNT_ONE))
#define END       COUNTS(100000)
#define SLACK     4.0

static tl_reference_t reference;

void setUp(void) {
    reference = (tl_reference_t){.low = -END, .high = END};
    tl_reference_set(&reference, 0);
}
void tearDown(void) {}

static const int32_t speeds[] = {20, 700, 5000, 16000, 30000};         // counts/s
static const int32_t accelerations[] = {1000, 20000, 200000, 1000000}; // counts/s2
static const uint32_t rates[] = {1000, 5000};

#define EACH(i, of) for (unsigned i = 0; i < sizeof(of) / sizeof((of)[0]); i++)

static void test_limits_in_ticks_are_those_in_seconds(void) {
    EACH(s, speeds) EACH(a, accelerations) EACH(r, rates) {
        const tl_reference_limits_t limits = tl_reference_limits(COUNTS(speeds[s]), COUNTS(accelerations[a]), rates[r]);
        const double v = speeds[s] / (double)rates[r], acceleration = accelerations[a] / pow(rates[r], 2.0);
        // Q24, cut off; the speed in two parts. 4 counts/tick2 at most.
        TEST_ASSERT_DOUBLE_WITHIN(1.0, v * (1 << 24), limits.speed);
        TEST_ASSERT_DOUBLE_WITHIN(1.0, fmin(acceleration, 4.0) * (1 << 24), limits.acceleration);
        TEST_ASSERT_EQUAL_INT32(limits.speed, tl_reference_speed(COUNTS(speeds[s]), rates[r]));
        // From its greatest speed it stops within v^2 / 2a and at most two ticks, which it then has to begin to.
        const double stop = v * v / 2.0 / fmin(acceleration, 4.0);
        TEST_ASSERT_TRUE(limits.stop >= floor(stop * 256.0) &&
                         limits.stop <= (stop * (1.0 + 1.0 / limits.acceleration) + 2.0 * v) * 256.0 + 2.0);
    }
    TEST_ASSERT_EQUAL_INT32(tl_reference_speed(TL_REFERENCE_SPEED_MAX, 1000),
                            tl_reference_speed(TL_REFERENCE_SPEED_MAX + COUNTS(1), 1000));
    TEST_ASSERT_TRUE(tl_reference_speed(TL_REFERENCE_SPEED_MAX - COUNTS(1), 1000) <
                     tl_reference_speed(TL_REFERENCE_SPEED_MAX, 1000));
    TEST_ASSERT_EQUAL_INT32(tl_reference_speed(1, 1000), tl_reference_speed(-COUNTS(5), 1000)); // the least there is
    TEST_ASSERT_EQUAL_INT32(65, tl_reference_speed(1, 1000));                                   // 2^16 / 1000
    const tl_reference_limits_t least = tl_reference_limits(COUNTS(100), 1, 1000),
                                most = tl_reference_limits(COUNTS(100), INT32_MAX, 1000);
    TEST_ASSERT_EQUAL_INT32(tl_reference_limits(COUNTS(100), TL_REFERENCE_ACCELERATION_MIN, 1000).acceleration,
                            least.acceleration);
    TEST_ASSERT_EQUAL_INT32(tl_reference_limits(COUNTS(100), TL_REFERENCE_ACCELERATION_MAX, 1000).acceleration,
                            most.acceleration);
}

// From rest to rest over d no motion is shorter than d/v + v/a, or 2 sqrt(d/a) where v is not reached. Speeds change in
// ticks, and what stopping takes is rounded up: some ticks more; many where a high limit of speed leaves a low
// acceleration few bits: asked for is what comes to its speed within a tenth of a second, as the defaults do.
static void test_a_way_takes_the_time_that_the_limits_ask_for(void) {
    static const double ways[] = {0.5, 3.0, 40.0, 63.0, 65.0, 500.0, 6000.0};
    EACH(s, speeds) EACH(a, accelerations) EACH(r, rates) EACH(w, ways) {
        const double v = speeds[s], acceleration = fmin(accelerations[a], 4.0 * pow(rates[r], 2.0)), d = ways[w];
        const double least = d > v * v / acceleration ? d / v + v / acceleration : 2.0 * sqrt(d / acceleration);
        if (v > acceleration / 10.0 || least * rates[r] > 40000.0) {
            continue;
        }
        const tl_reference_limits_t limits = tl_reference_limits(COUNTS(speeds[s]), COUNTS(accelerations[a]), rates[r]);
        for (int way = -1; way <= 1; way += 2) {
            setUp();
            const tl_count_q8_t target = way * COUNTS(d);
            uint32_t ticks = 0;
            do {
                tl_reference_step(&reference, target, &limits);
                ticks++;
            } while (!tl_reference_rests_at(&reference, target) && ticks < 60000U);
            TEST_ASSERT_TRUE(ticks >= floor(least * rates[r] * 0.999) - 2.0);
            TEST_ASSERT_TRUE_MESSAGE(ticks <= ceil(least * rates[r] * 1.01) + SLACK, "too late");
        }
    }
}

// v falls by a in each tick: n = v / a of them, and what they cover.
static void test_braking_takes_the_ticks_that_a_speed_holds(void) {
    const tl_reference_limits_t limits = tl_reference_limits(COUNTS(16000), COUNTS(200000), 1000);
    for (int way = -1; way <= 1; way += 2) {
        setUp();
        for (uint32_t i = 0; i < 50U; i++) { // ten counts/s a tick squared, below the limit at first
            tl_reference_step(&reference, way * COUNTS(5000), &limits);
        }
        int32_t v = reference.velocity;
        int64_t at = (int64_t)reference.q * 65536 + reference.fraction;
        TEST_ASSERT_EQUAL_INT32(way * 50 * limits.acceleration, v); // as fast as it may
        bool rests = false;
        while (!rests) {
            v -= way * limits.acceleration;
            at += v;
            rests = tl_reference_brake(&reference, &limits);
            TEST_ASSERT_EQUAL_INT32(v, reference.velocity);
            TEST_ASSERT_EQUAL_INT64(at, (int64_t)reference.q * 65536 + reference.fraction);
            TEST_ASSERT_EQUAL(v == 0, rests);
            TEST_ASSERT_EQUAL_INT32(reference.q, reference.target);
        }
        TEST_ASSERT_TRUE(tl_reference_brake(&reference, &limits)); // and stays
        TEST_ASSERT_EQUAL_INT64(at, (int64_t)reference.q * 65536 + reference.fraction);
    }
}

static void test_lowered_limits_are_braked_to_by_what_they_allow(void) {
    const tl_reference_limits_t fast = tl_reference_limits(COUNTS(10000), COUNTS(200000), 1000),
                                slow = tl_reference_limits(COUNTS(1000), COUNTS(20000), 1000);
    for (int way = -1; way <= 1; way += 2) {
        setUp();
        for (uint32_t i = 0; i < 200U; i++) {
            tl_reference_step(&reference, way * COUNTS(50000), &fast);
        }
        TEST_ASSERT_EQUAL_INT32(way * fast.speed, reference.velocity);
        while (abs(reference.velocity) > slow.speed) {
            const int32_t before = reference.velocity;
            tl_reference_step(&reference, way * COUNTS(50000), &slow);
            const int32_t next = abs(before) - slow.acceleration;
            TEST_ASSERT_EQUAL_INT32(way * (next > slow.speed ? next : slow.speed), reference.velocity);
        }
    }
}

static void test_it_says_when_its_target_is_clamped_and_when_it_is_behind(void) {
    const tl_reference_limits_t limits = tl_reference_limits(COUNTS(1000), COUNTS(1000000), 1000);
    reference.low = COUNTS(-10);
    reference.high = COUNTS(10);
    tl_reference_step(&reference, COUNTS(10), &limits);
    TEST_ASSERT_FALSE(reference.clamped);
    TEST_ASSERT_TRUE(reference.behind); // a count a tick
    for (uint32_t i = 0; i < 20U; i++) {
        tl_reference_step(&reference, COUNTS(10) + 1, &limits);
        TEST_ASSERT_TRUE(reference.clamped);
    }
    TEST_ASSERT_FALSE(reference.behind);
    TEST_ASSERT_TRUE(tl_reference_rests_at(&reference, COUNTS(10)));
    for (uint32_t i = 0; i < 40U; i++) {
        tl_reference_step(&reference, COUNTS(-10) - 1, &limits);
        TEST_ASSERT_TRUE(reference.clamped);
    }
    TEST_ASSERT_TRUE(tl_reference_rests_at(&reference, COUNTS(-10)));
    TEST_ASSERT_FALSE(tl_reference_rests_at(&reference, COUNTS(-10) + 1));
    tl_reference_step(&reference, COUNTS(-10), &limits);
    TEST_ASSERT_FALSE(reference.clamped);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_limits_in_ticks_are_those_in_seconds);
    RUN_TEST(test_a_way_takes_the_time_that_the_limits_ask_for);
    RUN_TEST(test_braking_takes_the_ticks_that_a_speed_holds);
    RUN_TEST(test_lowered_limits_are_braked_to_by_what_they_allow);
    RUN_TEST(test_it_says_when_its_target_is_clamped_and_when_it_is_behind);
    return UNITY_END();
}
