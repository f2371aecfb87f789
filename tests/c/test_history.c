#include "tautline/tl_history.h"

#include <unity.h>

static tl_history_t history;

void setUp(void) {
    tl_history_init(&history);
}
void tearDown(void) {}

static void check(tl_us_t t_us, tl_count_q8_t expected) {
    tl_count_q8_t q = 0;
    TEST_ASSERT_EQUAL(TL_HISTORY_OK, tl_history_at(&history, t_us, &q));
    TEST_ASSERT_EQUAL_INT32(expected, q);
}

static void check_status(tl_us_t t_us, tl_history_status_t expected) {
    tl_count_q8_t q = 12345;
    TEST_ASSERT_EQUAL(expected, tl_history_at(&history, t_us, &q));
    TEST_ASSERT_EQUAL_INT32(12345, q); // never an invented position
}

static void test_an_empty_history_knows_nothing(void) {
    check_status(0, TL_HISTORY_NOT_YET);
    check_status(1000000, TL_HISTORY_NOT_YET);
}

static void test_one_push_is_one_position(void) {
    tl_history_push(&history, 5000, -77);
    check(5000, -77);
    check_status(4999, TL_HISTORY_TOO_OLD);
    check_status(5001, TL_HISTORY_NOT_YET);
}

static void test_between_milliseconds_it_is_linear_and_rounded(void) {
    tl_history_push(&history, 1000, 0);
    tl_history_push(&history, 2000, 1000);
    tl_history_push(&history, 3000, -1);
    check(1000, 0);
    check(1001, 1);
    check(1500, 500);
    check(2000, 1000);
    check(2499, 1000 - 499); // 1001 counts fall in 1000 us: 499.499
    check(2999, 0);
    check(3000, -1);
}

static void test_it_reaches_back_half_a_second_and_no_less(void) {
    const tl_us_t start = 7000000;
    for (uint32_t ms = 0; ms <= 2000; ms++) {
        tl_history_push(&history, start + 1000U * ms, (tl_count_q8_t)(ms * 256));
        if (ms >= TL_HISTORY_SPAN_MS) {
            check(start + 1000U * (ms - TL_HISTORY_SPAN_MS), (tl_count_q8_t)((ms - TL_HISTORY_SPAN_MS) * 256));
            check_status(start + 1000U * (ms - TL_HISTORY_SPAN_MS) - 2000, TL_HISTORY_TOO_OLD);
        }
    }
}

static void test_faster_ticks_that_are_no_whole_milliseconds(void) {
    for (uint32_t i = 0; i < 4000; i++) { // 3 kHz: 333 us and some; q = t / 8
        const uint32_t t = 333U * i + i / 3U;
        tl_history_push(&history, t, (tl_count_q8_t)(t / 8U));
    }
    for (uint32_t t = 900000; t < 1300000; t += 777) {
        tl_count_q8_t q;
        TEST_ASSERT_EQUAL(TL_HISTORY_OK, tl_history_at(&history, t, &q));
        TEST_ASSERT_INT32_WITHIN(1, (int32_t)(t / 8U), q);
    }
}

static void test_a_short_pause_is_bridged_a_long_one_forgets(void) {
    tl_history_push(&history, 10000, 0);
    tl_history_push(&history, 10000 + 1000 * TL_HISTORY_GAP_MS, 1600);
    check(10000 + 500 * TL_HISTORY_GAP_MS, 800);
    const tl_us_t later = 10000 + 1000 * TL_HISTORY_GAP_MS + 1000 * TL_HISTORY_GAP_MS + 1;
    tl_history_push(&history, later, 5);
    check(later, 5);
    check_status(10000, TL_HISTORY_TOO_OLD);
}

static void test_time_that_does_not_rise_is_ignored(void) {
    tl_history_push(&history, 5000, 1);
    tl_history_push(&history, 5000, 2);
    tl_history_push(&history, 4000, 3);
    check(5000, 1);
    check_status(5500, TL_HISTORY_NOT_YET);
}

static void test_the_whole_range_of_positions(void) {
    tl_history_push(&history, 1000, INT32_MIN);
    tl_history_push(&history, 2000, INT32_MAX);
    tl_history_push(&history, 3000, INT32_MIN);
    check(1000, INT32_MIN);
    check(2000, INT32_MAX);
    tl_count_q8_t q;
    TEST_ASSERT_EQUAL(TL_HISTORY_OK, tl_history_at(&history, 1500, &q));
    TEST_ASSERT_INT32_WITHIN(1, 0, q);
    TEST_ASSERT_EQUAL(TL_HISTORY_OK, tl_history_at(&history, 2500, &q));
    TEST_ASSERT_INT32_WITHIN(1, 0, q);
}

static void test_the_write_count_may_wrap(void) {
    tl_history_push(&history, 1000, 0);
    history.count = UINT32_MAX - 300U; // 49 days on; the ring's size divides 2^32
    for (uint32_t ms = 2; ms < 1000; ms++) {
        tl_history_push(&history, 1000U * ms, (tl_count_q8_t)ms);
    }
    check(999000, 999);
    check(600000, 600);
    check(500000, 500);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_an_empty_history_knows_nothing);
    RUN_TEST(test_one_push_is_one_position);
    RUN_TEST(test_between_milliseconds_it_is_linear_and_rounded);
    RUN_TEST(test_it_reaches_back_half_a_second_and_no_less);
    RUN_TEST(test_faster_ticks_that_are_no_whole_milliseconds);
    RUN_TEST(test_a_short_pause_is_bridged_a_long_one_forgets);
    RUN_TEST(test_time_that_does_not_rise_is_ignored);
    RUN_TEST(test_the_whole_range_of_positions);
    RUN_TEST(test_the_write_count_may_wrap);
    return UNITY_END();
}
