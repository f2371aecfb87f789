// Wide-range numbers against float64, which has 53 bits where they have 31.
#include "tl_real.h"

#include <math.h>
#include <stdlib.h>
#include <unity.h>

#define ROUNDS 200000

void setUp(void) {}
void tearDown(void) {}

static uint64_t state;

static uint64_t random_u64(void) { // xorshift
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return state;
}

static double value(tl_real_t a) {
    return ldexp((double)(int32_t)(uint32_t)((uint64_t)a >> 32), (int32_t)(uint32_t)a);
}

// Of any size and exponent, either sign, 0 among them.
static tl_real_t any(void) {
    const int64_t m = (int64_t)random_u64() >> random_u64() % 64U;
    return tl_real(random_u64() % 16U == 0U ? 0 : m, (int32_t)(random_u64() % 80U) - 40);
}

// A mantissa of 31 bits that is cut off is right to 2^-30 of it; two cuts in one operation, 2^-29.
static void near(double expected, tl_real_t got) {
    TEST_ASSERT_TRUE(fabs(value(got) - expected) <= ldexp(fabs(expected), -29));
    const int64_t m = (int32_t)(uint32_t)((uint64_t)got >> 32);
    TEST_ASSERT_TRUE(got == 0 || llabs(m) >> 30 == 1); // as its header says, and so its sign may be read
}

static void test_operations_are_those_of_float64(void) {
    state = 88172645463325252U;
    for (int i = 0; i < ROUNDS; i++) {
        const tl_real_t a = any(), b = any();
        const double x = value(a), y = value(b);
        near(x * y, tl_real_mul(a, b));
        near(x * x, tl_real_square(a));
        near(x > 0 ? sqrt(x) : 0.0, tl_real_sqrt(a));
        near(ldexp(x, 17), tl_real_shift(a, 17));
        near(ldexp(x, -9), tl_real_shift(a, -9));
        if (b != 0) {
            near(x / y, tl_real_div(a, b));
        }
        // A difference of near numbers loses what these had: to 2^-29 of the larger one
        const double most = ldexp(fmax(fabs(x), fabs(y)), -29);
        TEST_ASSERT_TRUE(fabs(value(tl_real_add(a, b)) - (x + y)) <= most);
        TEST_ASSERT_TRUE(fabs(value(tl_real_sub(a, b)) - (x - y)) <= most);
        TEST_ASSERT_FALSE(tl_real_less(a, a));
        TEST_ASSERT_TRUE(fabs(x - y) <= most || tl_real_less(a, b) == (x < y));
    }
}

static void test_a_number_is_its_integer_to_31_bits(void) {
    state = 1181783497276652981U;
    for (int i = 0; i < ROUNDS; i++) {
        const int64_t m = (int64_t)random_u64() >> random_u64() % 64U;
        near((double)m, tl_real(m, 0));
    }
    for (int32_t bits = 0; bits < 63; bits++) { // at the edges of every size
        for (int64_t more = -1; more <= 1; more++) {
            const int64_t m = ((int64_t)1 << bits) + more;
            near((double)m, tl_real(m, 0));
            near(-(double)m, tl_real(-m, 0));
        }
    }
    TEST_ASSERT_EQUAL_INT64(0, tl_real(0, 12));
}

static void test_fixed_point_is_rounded_and_saturates(void) {
    state = 2545U;
    for (int i = 0; i < ROUNDS; i++) {
        const tl_real_t a = any();
        const int32_t bits = (int32_t)(random_u64() % 24U);
        const double exact = ldexp(value(a), bits);
        const int32_t got = tl_real_to_q(a, bits);
        if (fabs(exact) >= 2147483648.0) {
            TEST_ASSERT_EQUAL_INT32(exact < 0 ? INT32_MIN : INT32_MAX, got);
        } else {
            TEST_ASSERT_TRUE(fabs(got - exact) <= 0.5);
        }
    }
    TEST_ASSERT_EQUAL_INT32(1, tl_real_to_q(tl_real(1, -1), 0)); // halves away from 0
    TEST_ASSERT_EQUAL_INT32(-1, tl_real_to_q(tl_real(-1, -1), 0));
    TEST_ASSERT_EQUAL_INT32(0, tl_real_to_q(tl_real(INT32_MAX, -32), 0));          // just below a half
    TEST_ASSERT_EQUAL_INT32(0x20000001, tl_real_to_q(tl_real(0x40000001, -1), 0)); // half of the last bit
    TEST_ASSERT_EQUAL_INT32(-0x20000001, tl_real_to_q(tl_real(-0x40000001, -1), 0));
}

static void test_a_division_by_nothing_is_larger_than_any(void) {
    TEST_ASSERT_TRUE(tl_real_less(tl_real(INT64_MAX, 1000), tl_real_div(tl_real(1, 0), 0)));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_operations_are_those_of_float64);
    RUN_TEST(test_a_number_is_its_integer_to_31_bits);
    RUN_TEST(test_fixed_point_is_rounded_and_saturates);
    RUN_TEST(test_a_division_by_nothing_is_larger_than_any);
    return UNITY_END();
}
