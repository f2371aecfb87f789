// Fractions without a division (tl_ratio.h), and the encoder history, against their definitions.
#include "random_u32.h"
#include "tautline/tl_history.h"
#include "tl_ratio.h"

#include <unity.h>

void setUp(void) {
    seed = 301029U;
}
void tearDown(void) {}

static uint32_t any(void) { // 1 to 2^31 - 1, as often of each size, and beside powers of two
    const uint32_t bits = random_u32() % 31U;
    const uint32_t one = 1U << bits, value = one + random_u32() % one;
    const uint32_t beside = one - 2U + random_u32() % 4U;
    return random_u32() % 4U == 0U && beside > 0U && beside < 1U << 31 ? beside : value;
}

static uint32_t bits_of(uint32_t x) {
    uint32_t bits = 0;
    while ((uint64_t)x >> bits != 0U) {
        bits++;
    }
    return bits;
}

static uint64_t to_20_bits(uint32_t x, uint32_t bits) {
    return bits <= 20U ? (uint64_t)x << (20U - bits) : x >> (bits - 20U);
}

static void check_ratio(uint32_t whole) {
    const uint32_t bits = bits_of(whole), ratio = tl_ratio_of(whole);
    TEST_ASSERT_EQUAL_UINT32(bits, tl_bits(whole));
    const uint64_t reciprocal = ((uint64_t)1 << 30) / to_20_bits(whole, bits);
    TEST_ASSERT_EQUAL_UINT32((uint64_t)bits << 11 | (reciprocal > 2047U ? 2047U : reciprocal), ratio);
}

static void test_a_ratio_is_its_definition(void) {
    TEST_ASSERT_EQUAL_UINT32(0, tl_bits(0));
    TEST_ASSERT_EQUAL_UINT32(32, tl_bits(UINT32_MAX));
    for (uint32_t whole = 1; whole < 70000U; whole++) {
        check_ratio(whole);
    }
    for (uint32_t i = 0; i < 100000U; i++) {
        check_ratio(any());
    }
}

static void test_a_fraction_is_the_quotient(void) {
    for (uint32_t i = 0; i < 200000U; i++) {
        const uint32_t whole = any(), part = i % 8U == 0U ? (i % 16U == 0U ? 0U : whole - 1U) : random_u32() % whole;
        const double exact = (double)part / whole * 2147483648.0;
        const double got = tl_fraction(part, whole, tl_ratio_of(whole));
        // 2^-19 of the whole; what 20 bits leave of both on top
        const double cut = bits_of(whole) > 20U ? 1.0 / 524288.0 : 0.0;
        TEST_ASSERT_TRUE(got <= exact + cut * 2147483648.0 && got >= exact - (1.0 / 524288.0 + cut) * 2147483648.0);
    }
}

// -- history ----------------------------------------------------------------------------------------------------------

static int64_t straight(int64_t a, int64_t b, int64_t numerator, int64_t denominator) { // halves go to b
    const int64_t way = (b > a ? b - a : a - b) * numerator;
    const int64_t part = way / denominator + (way % denominator + denominator / 2) / denominator;
    return b > a ? a + part : a - part;
}

static tl_history_t history;
static struct {
    uint64_t begun, pushed;
    int64_t q, count; // whole milliseconds since it began
    int64_t kept[512 * 8];
} m;

static void push(uint64_t t, int32_t q) {
    tl_history_push(&history, t, q);
    if (m.count > 0 && t <= m.pushed) {
        return;
    }
    if (m.count == 0 || t - m.pushed > 16000U) {
        m.begun = t;
        m.count = 0;
        m.kept[m.count++] = q;
    }
    for (; t - m.begun >= (uint64_t)m.count * 1000U; m.count++) {
        const uint64_t at = m.begun + (uint64_t)m.count * 1000U;
        m.kept[m.count] = straight(q, m.q, (int64_t)(t - at), (int64_t)(t - m.pushed));
    }
    m.pushed = t;
    m.q = q;
}

static void look(uint64_t t) {
    tl_count_q8_t got = 12345;
    const tl_history_status_t status = tl_history_at(&history, t, &got);
    const uint64_t newest = m.begun + (uint64_t)(m.count - 1) * 1000U;
    const uint64_t span = (uint64_t)(m.count < 502 ? m.count : 502) - 1U;
    if (m.count == 0 || t > newest) {
        TEST_ASSERT_EQUAL(TL_HISTORY_NOT_YET, status);
    } else if (newest - t > span * 1000U) {
        TEST_ASSERT_EQUAL(TL_HISTORY_TOO_OLD, status);
    } else {
        TEST_ASSERT_EQUAL(TL_HISTORY_OK, status);
        const uint64_t steps = (newest - t) / 1000U, rest = (newest - t) % 1000U;
        const int64_t newer = m.kept[(uint64_t)m.count - 1U - steps];
        TEST_ASSERT_EQUAL_INT64(
            rest == 0U ? newer : straight(newer, m.kept[(uint64_t)m.count - 2U - steps], (int64_t)rest, 1000), got);
        return;
    }
    TEST_ASSERT_EQUAL_INT32(12345, got);
}

static void test_the_history_is_straight_between_milliseconds(void) {
    for (uint32_t life = 0; life < 60U; life++) {
        tl_history_init(&history);
        m.count = 0;
        look(0);
        uint64_t t = life % 3U == 0U ? 0U : (uint64_t)random_u32() << (life % 12U);
        const uint32_t most_us = life % 2U == 0U ? 200U : 900U;
        int32_t q = (int32_t)random_u32() / 4;
        for (uint32_t i = 0; i < 4000U && m.count < 4000; i++) {
            const uint32_t what = random_u32() % 1500U;
            t += what == 0U ? 15990U + random_u32() % 20U : (what < 9U ? 0U : 1U + random_u32() % most_us);
            q = what == 9U ? (int32_t)random_u32() : (int32_t)((uint32_t)q + random_u32() % 4001U - 2000U);
            push(what == 10U && t > 5U ? t - 5U : t, q);
            t = t < m.pushed ? m.pushed : t;
            look(m.pushed - m.pushed % 7U + random_u32() % 9U);
            const uint64_t back = random_u32() % 520000U;
            look(m.pushed > back ? m.pushed - back : 0U);
            look(m.begun + (uint64_t)(m.count > 502 ? m.count - 502 : 0) * 1000U - (random_u32() & 1U));
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_ratio_is_its_definition);
    RUN_TEST(test_a_fraction_is_the_quotient);
    RUN_TEST(test_the_history_is_straight_between_milliseconds);
    return UNITY_END();
}
