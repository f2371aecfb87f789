// Number types, look-ups and their inverses at their corners. Accuracy over random tables: tests/host.
#include "table_fixture.h"

#include <unity.h>

static tl_lookup_t lookup;
static uint32_t flags;

void setUp(void) {
    flags = 0;
}
void tearDown(void) {}

static void load(const tl_table_t *table) {
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_derive(&lookup, table, TL_TABLE_ANY_AXIS));
}

static void test_sums_saturate(void) {
    static const int32_t values[] = {INT32_MIN, INT32_MIN + 1, -5, -1, 0, 1, 7, INT32_MAX - 1, INT32_MAX};
    const size_t count = sizeof values / sizeof values[0];
    for (size_t i = 0; i < count; i++) {
        for (size_t j = 0; j < count; j++) {
            const int64_t sum = (int64_t)values[i] + values[j], difference = (int64_t)values[i] - values[j];
            const int64_t most = INT32_MAX, least = INT32_MIN;
            TEST_ASSERT_EQUAL_INT64(sum > most ? most : (sum < least ? least : sum), tl_add_sat(values[i], values[j]));
            TEST_ASSERT_EQUAL_INT64(difference > most ? most : (difference < least ? least : difference),
                                    tl_sub_sat(values[i], values[j]));
        }
    }
    TEST_ASSERT_EQUAL_INT32(INT32_MAX, tl_abs_sat(INT32_MIN));
    TEST_ASSERT_EQUAL_INT32(5, tl_abs_sat(-5));
}

static void test_the_upper_half_of_a_product_is_exact(void) {
    uint32_t seed = 7;
    static const uint32_t corners[] = {0, 1, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000U, 0xFFFF0000U, 0xFFFFFFFFU};
    for (int i = 0; i < 20000; i++) {
        seed = seed * 1664525U + 1013904223U;
        const uint32_t a = i < 64 ? corners[i / 8] : seed;
        seed = seed * 1664525U + 1013904223U;
        const uint32_t b = i < 64 ? corners[i % 8] : seed;
        TEST_ASSERT_EQUAL_HEX32((uint32_t)((uint64_t)a * b >> 32), tl_mul_high(a, b));
    }
}

static void test_interpolation_is_rounded_to_nearest(void) {
    TEST_ASSERT_EQUAL_INT32(10, tl_lerp(10, 20, 0));
    TEST_ASSERT_EQUAL_INT32(15, tl_lerp(10, 20, 0x8000));
    TEST_ASSERT_EQUAL_INT32(5, tl_lerp(20, -10, 0x8000));
    TEST_ASSERT_EQUAL_INT32(20, tl_lerp(10, 20, 0xFFFF));
    TEST_ASSERT_EQUAL_INT32(-TL_TABLE_VALUE_MAX, tl_lerp(-TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX, 0));
    TEST_ASSERT_INT32_WITHIN(1, 0, tl_lerp(-TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX, 0x8000));
    TEST_ASSERT_INT32_WITHIN(1, 0, tl_lerp(TL_TABLE_VALUE_MAX, -TL_TABLE_VALUE_MAX, 0x8000));
}

static void test_fine_interpolation_is_rounded_to_nearest_too(void) {
    uint32_t seed = 11;
    for (int i = 0; i < 20000; i++) {
        seed = seed * 1664525U + 1013904223U;
        const int32_t a = (int32_t)(seed >> 2) - (1 << 29);
        seed = seed * 1664525U + 1013904223U;
        const int32_t b = i % 2 ? (int32_t)(seed >> 2) - (1 << 29) : a + (int32_t)(seed >> 8) - (1 << 23);
        const unsigned log2 = 17U + (unsigned)i % 7U;
        seed = seed * 1664525U + 1013904223U;
        const int64_t t = seed >> (32U - log2), difference = (int64_t)b - a;
        const int64_t twice = (2 * difference * t) >> log2; // rounded down: half of it is within 1 of the nearest
        TEST_ASSERT_INT64_WITHIN(1, 2 * (int64_t)a + twice, 2 * (int64_t)tl_lerp_fine(a, b, (uint32_t)t, log2));
    }
}

static void test_a_scale_is_the_ratio(void) {
    static const uint32_t values[] = {1, 2, 3, 7, 255, 256, 65535, 65537, 1U << 23, 0x3FFFFFFF, 0x7FFFFFFF};
    const size_t count = sizeof values / sizeof values[0];
    for (size_t i = 0; i < count; i++) {
        for (size_t j = 0; j < count; j++) {
            const tl_scale_t ratio = tl_scale_of(values[i], values[j]);
            TEST_ASSERT_GREATER_OR_EQUAL_UINT32(0x80000000U, ratio.mantissa);
            for (size_t k = 0; k < count; k++) {
                const uint64_t exact = (uint64_t)values[k] * values[i] / values[j];
                if (exact <= INT32_MAX) {
                    TEST_ASSERT_UINT32_WITHIN(1, (uint32_t)exact, tl_scale(values[k], ratio));
                }
            }
        }
    }
}

static void test_nodes_are_exact_and_the_ends_are_held(void) {
    tl_table_t table = table_fixture(1);
    for (unsigned i = 0; i < table.nodes; i++) {
        table.width[i] += (int32_t)(2 * i * i);
    }
    load(&table);
    for (unsigned i = 0; i < table.nodes; i++) {
        const int32_t p = table.q0 + (int32_t)(i << 14);
        TEST_ASSERT_EQUAL_INT32(table.width[i], tl_lookup_width(&lookup, p, &flags));
        TEST_ASSERT_EQUAL_INT32(table.angle[i], tl_lookup_angle(&lookup, p, &flags));
        TEST_ASSERT_INT32_WITHIN(1, p, tl_lookup_angle_inverse(&lookup, table.angle[i], &flags));
        TEST_ASSERT_INT32_WITHIN(1, p, tl_lookup_p_low(&lookup, p + table.width[i] / 2, p, &flags));
        TEST_ASSERT_INT32_WITHIN(1, p, tl_lookup_p_high(&lookup, p - table.width[i] / 2, p, &flags));
    }
    TEST_ASSERT_EQUAL_HEX32(0, flags);
    TEST_ASSERT_EQUAL_INT32(table.width[0], tl_lookup_width(&lookup, table.q0 - 1, &flags));
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_BELOW, flags);
    TEST_ASSERT_EQUAL_INT32(table.width[0], tl_lookup_width(&lookup, INT32_MIN, &flags));
    flags = 0;
    TEST_ASSERT_EQUAL_INT32(table.angle[157], tl_lookup_angle(&lookup, table.q0 + (157 << 14) + 1, &flags));
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_ABOVE, flags);
    TEST_ASSERT_EQUAL_INT32(table.angle[157], tl_lookup_angle(&lookup, INT32_MAX, &flags));
}

// For every step: nodes are 2^step_log2 Q8 counts apart, and a place is rounded to 2^-16 of that, to a bit of c.
static void test_between_nodes_a_table_is_straight_whatever_its_step(void) {
    for (uint8_t log2 = 0; log2 <= 20; log2++) {
        tl_table_t table = table_fixture(1);
        const int32_t step = (int32_t)1 << log2;
        table.step_log2 = log2;
        table.q0 = table.q_min = -78 * step;
        table.q_max = 79 * step;
        for (unsigned i = 0; i < table.nodes; i++) {
            table.width[i] = 0;
            table.angle[i] = (int32_t)(i * i) * 300 - 1000000;
        }
        load(&table);
        for (unsigned i = 0; i + 1U < table.nodes; i++) {
            for (int32_t part = 0; part < 8; part++) {
                const int32_t into = (int32_t)((int64_t)step * part / 8);
                const double exact = table.angle[i] + (double)(table.angle[i + 1U] - table.angle[i]) * into / step;
                TEST_ASSERT_DOUBLE_WITHIN(1.5, exact,
                                          tl_lookup_angle(&lookup, table.q0 + (int32_t)i * step + into, &flags));
            }
        }
    }
}

static void test_a_falling_f_flags_the_end_in_p(void) {
    const tl_table_t table = table_fixture(-1);
    load(&table);
    TEST_ASSERT_EQUAL_INT32(-1, lookup.turn);
    TEST_ASSERT_EQUAL_INT32(table.q0, tl_lookup_angle_inverse(&lookup, table.angle[0] + 1, &flags));
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_BELOW, flags);
    flags = 0;
    TEST_ASSERT_EQUAL_INT32(table.q0 + (157 << 14), tl_lookup_angle_inverse(&lookup, INT32_MIN, &flags));
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_ABOVE, flags);
    TEST_ASSERT_TRUE(lookup.c_low < lookup.c_high);
    TEST_ASSERT_EQUAL_INT32(table.angle[0], lookup.c_high);
}

// Exactly at the bound: |dB| = 2 step - 1, where one of the envelopes all but stands still.
static void test_the_steepest_width_has_an_inverse(void) {
    tl_table_t table = table_fixture(1);
    const int32_t rise = (2 << 14) - 1;
    for (unsigned i = 0; i < table.nodes; i++) {
        table.width[i] = i % 2 == 0 ? 1000 : 1000 + rise;
    }
    load(&table);
    for (int32_t q = table.q_min; q <= table.q_max; q += 1021) {
        const int32_t low = tl_lookup_p_low(&lookup, q, q, &flags), high = tl_lookup_p_high(&lookup, q, q, &flags);
        TEST_ASSERT_INT32_WITHIN(4, 2 * q, 2 * low + tl_lookup_width(&lookup, low, &flags));
        TEST_ASSERT_INT32_WITHIN(4, 2 * q, 2 * high - tl_lookup_width(&lookup, high, &flags));
    }
}

// Wherever the search begins: in its own span, beside it, beyond the grid, at both of a span's ends.
static void test_where_p_is_sought_first_changes_nothing(void) {
    tl_table_t table = table_fixture(1);
    for (unsigned i = 0; i < table.nodes; i++) {
        table.width[i] += (int32_t)(i * 7919U % 16384U);
    }
    load(&table);
    for (unsigned i = 0; i < table.nodes; i++) {
        for (int32_t by = -1; by <= 1; by++) {
            const int32_t p = table.q0 + (int32_t)(i << 14), half = table.width[i] / 2;
            const int32_t low = tl_lookup_p_low(&lookup, p + half + by, INT32_MIN, &flags);
            const int32_t high = tl_lookup_p_high(&lookup, p - half + by, INT32_MIN, &flags);
            TEST_ASSERT_INT32_WITHIN(4, p, low);
            TEST_ASSERT_INT32_WITHIN(4, p, high);
            for (unsigned k = 0; k <= table.nodes; k++) {
                for (int32_t side = -1; side <= 0; side++) {
                    const int32_t near = table.q0 + (int32_t)(k << 14) + side;
                    TEST_ASSERT_EQUAL_INT32(low, tl_lookup_p_low(&lookup, p + half + by, near, &flags));
                    TEST_ASSERT_EQUAL_INT32(high, tl_lookup_p_high(&lookup, p - half + by, near, &flags));
                }
            }
            TEST_ASSERT_EQUAL_INT32(low, tl_lookup_p_low(&lookup, p + half + by, INT32_MAX, &flags));
            TEST_ASSERT_EQUAL_INT32(high, tl_lookup_p_high(&lookup, p - half + by, INT32_MAX, &flags));
        }
    }
}

static void test_without_nodes_a_table_is_the_coarse_line(void) {
    tl_table_t table = table_fixture(-1);
    table.nodes = 0;
    table.q0 = 0;
    table.step_log2 = 0;
    load(&table);
    for (int32_t p = table.q_min; p <= table.q_max; p += 9973) {
        const int64_t exact = 60 * (int64_t)TL_DEG_ONE * -p / table.q_max;
        TEST_ASSERT_EQUAL_INT32(0, tl_lookup_width(&lookup, p, &flags));
        TEST_ASSERT_INT32_WITHIN(2, (int32_t)exact, tl_lookup_angle(&lookup, p, &flags));
        TEST_ASSERT_INT32_WITHIN(2, p, tl_lookup_angle_inverse(&lookup, (int32_t)exact, &flags));
        TEST_ASSERT_EQUAL_INT32(p, tl_lookup_p_low(&lookup, p, 0, &flags));
        TEST_ASSERT_EQUAL_INT32(p, tl_lookup_p_high(&lookup, p, 0, &flags));
    }
    TEST_ASSERT_EQUAL_HEX32(0, flags);
    TEST_ASSERT_EQUAL_INT32(table.q_max, tl_lookup_angle_inverse(&lookup, INT32_MIN, &flags));
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_ABOVE, flags);
    TEST_ASSERT_FALSE(tl_lookup_is_flat(&lookup, 0));
}

static void test_flat_spans_are_marked(void) {
    tl_table_t table = table_fixture(1);
    table.slope_min_q28 = 4096; // 64 of the last bit of c a span
    table.flat_speed_q8 = 1000;
    for (unsigned i = 81; i < table.nodes; i++) {
        table.angle[i] += 63 - 50332;
    }
    load(&table);
    TEST_ASSERT_TRUE(lookup.has_flat);
    const int32_t p = table.q0 + (80 << 14);
    TEST_ASSERT_FALSE(tl_lookup_is_flat(&lookup, p - 1));
    TEST_ASSERT_TRUE(tl_lookup_is_flat(&lookup, p));
    TEST_ASSERT_TRUE(tl_lookup_is_flat(&lookup, p + (1 << 14) - 1));
    TEST_ASSERT_FALSE(tl_lookup_is_flat(&lookup, p + (1 << 14)));
    TEST_ASSERT_FALSE(tl_lookup_is_flat(&lookup, INT32_MIN));
}

static void test_a_refused_blob_is_not_loaded(void) {
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    tl_table_t table = table_fixture(1);
    const size_t size = tl_table_encode(&table, blob, sizeof blob);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_load(&lookup, blob, size, 0));
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_AXIS, tl_lookup_load(&lookup, blob, size, 3));
    blob[100] ^= 1;
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_CRC, tl_lookup_load(&lookup, blob, size, 0));
    table.width[3] = -1;
    TEST_ASSERT_EQUAL_INT(TL_TABLE_BAD_WIDTH_NEGATIVE, tl_lookup_derive(&lookup, &table, 0));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_sums_saturate);
    RUN_TEST(test_the_upper_half_of_a_product_is_exact);
    RUN_TEST(test_interpolation_is_rounded_to_nearest);
    RUN_TEST(test_fine_interpolation_is_rounded_to_nearest_too);
    RUN_TEST(test_a_scale_is_the_ratio);
    RUN_TEST(test_nodes_are_exact_and_the_ends_are_held);
    RUN_TEST(test_between_nodes_a_table_is_straight_whatever_its_step);
    RUN_TEST(test_a_falling_f_flags_the_end_in_p);
    RUN_TEST(test_the_steepest_width_has_an_inverse);
    RUN_TEST(test_where_p_is_sought_first_changes_nothing);
    RUN_TEST(test_without_nodes_a_table_is_the_coarse_line);
    RUN_TEST(test_flat_spans_are_marked);
    RUN_TEST(test_a_refused_blob_is_not_loaded);
    return UNITY_END();
}
