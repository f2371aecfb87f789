// Fixed-point arithmetic as tl_fixed.h says it, in 64-bit and 128-bit numbers, for any arguments and those at their
// ends.
#include "draws.h"
#include "tautline/tl_crc.h"
#include "tautline/tl_fixed.h"
#include "words.h"

#include <stdlib.h>
#include <unity.h>

#define DRAWS 400000

void setUp(void) {
    seed = 662607U;
}
void tearDown(void) {}

static int32_t number(void) { // of any size, often at an end
    static const int32_t ends[] = {INT32_MIN, INT32_MIN + 1, -1, 0, 1, INT32_MAX - 1, INT32_MAX};
    return once_in(6) ? ends[between(0, 6)] : any(32);
}

static int64_t down(int64_t x, int64_t by) {
    const int64_t quotient = x / by;
    return quotient * by > x ? quotient - 1 : quotient;
}

static void test_sums_are_held_at_the_ends(void) {
    for (uint32_t i = 0; i < DRAWS; i++) {
        const int64_t a = number(), b = number();
        TEST_ASSERT_EQUAL_INT64(within(a + b, INT32_MIN, INT32_MAX), tl_add_sat((int32_t)a, (int32_t)b));
        TEST_ASSERT_EQUAL_INT64(within(a - b, INT32_MIN, INT32_MAX), tl_sub_sat((int32_t)a, (int32_t)b));
        TEST_ASSERT_EQUAL_INT64(within(llabs(a), 0, INT32_MAX), tl_abs_sat((int32_t)a));
        const int32_t low = number(), more = number(), high = more < low ? low : more;
        TEST_ASSERT_EQUAL_INT64(within(a, low, high), tl_clamp((int32_t)a, low, high));
    }
}

static void test_products_are_exact(void) {
    for (uint32_t i = 0; i < DRAWS; i++) {
        const uint32_t a = (uint32_t)number(), b = (uint32_t)number(), factor = once_in(8) ? 0xFFFFU : b >> 16;
        TEST_ASSERT_EQUAL_HEX32((uint64_t)a * b >> 32, tl_mul_high(a, b));
        const uint64_t wide = (uint64_t)a << 32 | (uint32_t)number();
        TEST_ASSERT_EQUAL_HEX64(wide * factor, (uint64_t)tl_times((int64_t)wide, factor));
    }
}

// a + (b - a) t / 2^log2, rounded to nearest, half up.
static int64_t between_of(int64_t a, int64_t b, int64_t t, unsigned log2) {
    return a + down((b - a) * t + ((int64_t)1 << (log2 - 1U)), (int64_t)1 << log2);
}

// The bits of t that a finer step has more: a span's last 8 bits are too little for them to count.
static int64_t between_of_fine(int64_t a, int64_t b, int64_t t, unsigned log2) {
    const int64_t more = (int64_t)1 << (log2 - 16U), coarse = t / more, fine = t % more;
    const int64_t rest = down(b - a, 256) * fine * (256 / more);
    return a + down((b - a) * coarse + rest + 32768, 65536);
}

static void test_what_lies_between_is_rounded_to_nearest(void) {
    for (uint32_t i = 0; i < 4U * DRAWS; i++) {
        const int32_t a = any(30), b = once_in(4) ? a + any(17) : any(30);
        const uint32_t t = random_u32() >> 16;
        TEST_ASSERT_EQUAL_INT64(between_of(a, b, t, 16), tl_lerp(a, b, t));
        const unsigned log2 = (unsigned)between(17, 23);
        const uint32_t fine = random_u32() >> (32U - log2);
        const int64_t is = tl_lerp_fine(a, b, fine, log2);
        TEST_ASSERT_EQUAL_INT64(between_of_fine(a, b, fine, log2), is);
        const int64_t one = (int64_t)1 << log2, off = (is - a) * one - ((int64_t)b - a) * fine;
        TEST_ASSERT_TRUE(llabs(off) <= one / 2 + one / 256);
    }
}

static void test_a_ratio_scales_to_a_part_of_2_32_of_itself(void) {
    for (uint32_t i = 0; i < DRAWS; i++) {
        const uint32_t n = 1U + ((uint32_t)any(31) & 0x7FFFFFFEU),
                       d = once_in(10) ? n : 1U + ((uint32_t)any(31) & 0x7FFFFFFEU);
        const tl_scale_t ratio = tl_scale_of(n, d);
        TEST_ASSERT_TRUE(ratio.mantissa >= 0x80000000U);
        const double exact = (double)n / d, is = (double)ratio.mantissa / 4294967296.0;
        const double of =
            ratio.shift >= 0 ? is * (double)((uint64_t)1 << ratio.shift) : is / (double)((uint64_t)1 << -ratio.shift);
        TEST_ASSERT_TRUE(of <= exact * (1.0 + 1e-15) && exact - of <= exact / 2147483648.0);
        const uint32_t x = (uint32_t)any(31) & 0x7FFFFFFFU;
        if ((double)x * exact < 2147483647.0) {
            const uint64_t product = (uint64_t)x * ratio.mantissa;
            const unsigned by = (unsigned)(32 - ratio.shift);
            TEST_ASSERT_EQUAL_UINT32((uint32_t)(by < 64U ? product >> by : 0U), tl_scale(x, ratio));
        }
    }
}

static void test_the_checksum_is_crc_32_in_pieces_too(void) {
    uint8_t bytes[300];
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926U, tl_crc32(0, "123456789", 9));
    for (uint32_t i = 0; i < 300U; i++) {
        bytes[i] = (uint8_t)random_u32();
        const size_t cut = (size_t)between(0, (int32_t)i + 1);
        TEST_ASSERT_EQUAL_HEX32(crc_of(bytes, i + 1U), tl_crc32(tl_crc32(0, bytes, cut), bytes + cut, i + 1U - cut));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_sums_are_held_at_the_ends);
    RUN_TEST(test_products_are_exact);
    RUN_TEST(test_what_lies_between_is_rounded_to_nearest);
    RUN_TEST(test_a_ratio_scales_to_a_part_of_2_32_of_itself);
    RUN_TEST(test_the_checksum_is_crc_32_in_pieces_too);
    return UNITY_END();
}
