// Look-ups against what tl_lookup.h promises, in long double, in tables of any size and any shape: on each span, at
// each node, beyond both ends.
#include "draws.h"
#include "table_fixture.h"

#include <math.h>
#include <stdlib.h>
#include <unity.h>

#define TABLES 220
#define POINTS 400

static tl_table_t table;
static tl_lookup_t lookup;
static int64_t step, last; // of the grid; its last node

void setUp(void) {
    seed = 577215U;
}
void tearDown(void) {}

static int64_t position(int64_t node) {
    return table.q0 + node * step;
}

static void any_grid(void) {
    static const uint16_t ends[] = {2, 3, 4, 5, 128, 129, 130, 255, 256, 257};
    table.nodes = between(0, 2) == 0 ? (uint16_t)between(2, 257) : ends[between(0, 9)];
    int log2 = between(3, 21);
    while (((int64_t)table.nodes << log2) > 1 << 29) {
        log2--;
    }
    table.step_log2 = (uint8_t)log2;
    step = (int64_t)1 << log2;
    last = table.nodes - 1;
    const int32_t room = (int32_t)((1 << 29) - last * step / 2);
    table.q0 = (int32_t)(between(-room, room) - last * step / 2);
    table.q_min = (int32_t)position(0) + between(0, (int32_t)(last * step / 3));
    table.q_max = (int32_t)position(last) - between(0, (int32_t)(last * step / 3));
}

static void any_table(void) {
    tl_table_reason_t reason;
    do {
        table = table_fixture(1);
        any_grid();
        const int32_t sign = between(0, 1) == 0 ? 1 : -1, rise = between(1, 22);
        int64_t angle = between(-(1 << 28), 1 << 28), width = abs(any(20));
        const int32_t steep = between(0, 3);
        for (int64_t i = 0; i <= last; i++) {
            table.angle[i] = (int32_t)angle;
            table.width[i] = (int32_t)width;
            angle += sign * (1 + (int64_t)abs(any((uint32_t)rise)));
            const int64_t most = steep == 0 ? 2 * step - 1 : step * steep / 3;
            width += most > INT32_MAX ? 0 : between((int32_t)-most, (int32_t)most);
            width = width < 0 ? 0 : (width > 1 << 27 ? 1 << 27 : width);
        }
        table.coarse_c_min = -sign * (abs(any(28)) + 1);
        table.coarse_c_max = sign * (abs(any(28)) + 1);
        reason = tl_lookup_derive(&lookup, &table, TL_TABLE_ANY_AXIS);
    } while (reason != TL_TABLE_OK);
}

// -- functions of p ---------------------------------------------------------------------------------------------------

static long double straight(const int32_t *values, int64_t p) {
    const int64_t offset = p - table.q0, i = offset / step;
    const long double part = (long double)(offset - i * step) / (long double)step;
    return values[i] + (i < last ? ((long double)values[i + 1] - values[i]) * part : 0);
}

static void check_function(const int32_t *values, int64_t p, int32_t got, uint32_t flags) {
    const int64_t first = position(0), end = position(last);
    TEST_ASSERT_EQUAL_UINT32(p < first ? TL_LOOKUP_BELOW : (p > end ? TL_LOOKUP_ABOVE : 0U), flags);
    const int64_t held = p < first ? first : (p > end ? end : p);
    const long double expected = straight(values, held);
    // rounded; by 16 bits of the span at a time
    TEST_ASSERT_TRUE(fabsl(expected - got) <= (step <= 65536 ? 0.5L : 0.5L + 1.0L / 256));
}

static int32_t somewhere(void) { // on a node and beside it, in a span, at the ends, beyond
    const int64_t node = between(0, (int32_t)last);
    switch (between(0, 4)) {
    case 0:
        return (int32_t)(position(node) + between(-1, 1));
    case 1:
        return (int32_t)(position(between(0, 1) == 0 ? 0 : last) + any(20));
    case 2:
        return between(0, 9) == 0 ? (between(0, 1) == 0 ? INT32_MIN : INT32_MAX) : any(31);
    default:
        return (int32_t)(position(0) + (int64_t)(random_u32() % (uint32_t)(last * step)));
    }
}

static void test_width_and_angle_are_straight_between_nodes_and_held_beyond(void) {
    for (uint32_t i = 0; i < TABLES; i++) {
        any_table();
        for (uint32_t k = 0; k < POINTS; k++) {
            const int32_t p = somewhere();
            uint32_t flags = 0;
            const int32_t width = tl_lookup_width(&lookup, p, &flags);
            check_function(table.width, p, width, flags);
            flags = 0;
            const int32_t angle = tl_lookup_angle(&lookup, p, &flags);
            check_function(table.angle, p, angle, flags);
        }
    }
}

// -- inverses ---------------------------------------------------------------------------------------------------------

// The place in [0, last] steps where a rising function of the node comes to y.
typedef int64_t (*of_node_t)(int64_t node);

static long double solved(of_node_t f, int64_t y) {
    int64_t low = 0, high = last; // f(low) <= y < f(high)
    while (high - low > 1) {
        const int64_t middle = (low + high) / 2;
        low = f(middle) <= y ? middle : low;
        high = f(middle) <= y ? high : middle;
    }
    return (long double)position(low) +
           (long double)(y - f(low)) * (long double)step / (long double)(f(low + 1) - f(low));
}

static void check_inverse(long double expected, int32_t got) {
    const long double bound = fmaxl(2.0L, ldexpl((long double)step, -19)) + 0.5L; // 1/128 count, 2^-19 of a step
    TEST_ASSERT_TRUE(fabsl(expected - got) <= bound);
}

static int64_t turned_angle(int64_t node) {
    return table.angle[last] > table.angle[0] ? table.angle[node] : -(int64_t)table.angle[node];
}

static void check_angle_inverse(int32_t c) {
    uint32_t flags = 0;
    const int32_t got = tl_lookup_angle_inverse(&lookup, c, &flags);
    const int64_t y = table.angle[last] > table.angle[0] ? c : -(int64_t)c;
    const bool below = y<turned_angle(0), above = y> turned_angle(last);
    TEST_ASSERT_EQUAL_UINT32(below ? TL_LOOKUP_BELOW : (above ? TL_LOOKUP_ABOVE : 0U), flags);
    if (below || y >= turned_angle(last)) {
        TEST_ASSERT_EQUAL_INT64(position(below ? 0 : last), got);
    } else {
        check_inverse(solved(turned_angle, y), got);
    }
}

static int64_t twice_low(int64_t node) {
    return 2 * position(node) + table.width[node];
}
static int64_t twice_high(int64_t node) {
    return 2 * position(node) - table.width[node];
}

static void check_envelope(int32_t q, int32_t near, bool low) {
    uint32_t flags = 0;
    const int32_t got = low ? tl_lookup_p_low(&lookup, q, near, &flags) : tl_lookup_p_high(&lookup, q, near, &flags);
    const of_node_t f = low ? twice_low : twice_high;
    const int64_t y = 2 * (int64_t)q;
    TEST_ASSERT_EQUAL_UINT32(y < f(0) ? TL_LOOKUP_BELOW : (y > f(last) ? TL_LOOKUP_ABOVE : 0U), flags);
    if (y < f(0) || y >= f(last)) { // B held
        const long double half = table.width[y < f(0) ? 0 : last] / 2.0L, p = low ? q - half : q + half;
        TEST_ASSERT_TRUE(fabsl(fminl(fmaxl(p, INT32_MIN), INT32_MAX) - got) <= 0.5L);
    } else {
        check_inverse(solved(f, y), got);
    }
    uint32_t again = 0;
    const int32_t elsewhere =
        low ? tl_lookup_p_low(&lookup, q, any(31), &again) : tl_lookup_p_high(&lookup, q, any(31), &again);
    TEST_ASSERT_EQUAL_INT32(got, elsewhere); // where it may be changes nothing
}

static void test_inverses_are_where_the_function_is(void) {
    for (uint32_t i = 0; i < TABLES; i++) {
        any_table();
        for (uint32_t k = 0; k < POINTS; k++) {
            const int32_t node = between(0, (int32_t)last), from = table.angle[0], to = table.angle[last];
            const int32_t c = k % 3U == 0U
                                  ? table.angle[node] + between(-1, 1)
                                  : (k % 3U == 1U ? any(31) : between(from < to ? from : to, from < to ? to : from));
            check_angle_inverse(c);
            const int32_t q = somewhere();
            check_envelope(q, k % 2U == 0U ? q : somewhere(), k % 4U < 2U);
            const int64_t at = k % 4U < 2U ? twice_low(node) : twice_high(node);
            check_envelope((int32_t)(at / 2) + between(-1, 1), any(31), k % 4U < 2U);
        }
        for (int64_t node = 0; node <= last; node++) { // each of them is found
            check_angle_inverse(table.angle[node]);
        }
    }
}

static void test_the_coarse_kinematics_is_a_line(void) {
    for (uint32_t i = 0; i < TABLES; i++) {
        any_table();
        const long double range = (long double)table.q_max - table.q_min;
        const long double rise = (long double)table.coarse_c_max - table.coarse_c_min;
        for (uint32_t k = 0; k < 40U; k++) {
            const int32_t q = k < 6U ? (k < 3U ? table.q_min : table.q_max) + between(-1, 1) : somewhere();
            uint32_t flags = 0;
            const int32_t c = tl_lookup_coarse(&lookup, q, &flags);
            TEST_ASSERT_EQUAL_UINT32(q < table.q_min ? TL_LOOKUP_BELOW : (q > table.q_max ? TL_LOOKUP_ABOVE : 0U),
                                     flags);
            const long double held = fminl(fmaxl(q, table.q_min), table.q_max) - table.q_min;
            TEST_ASSERT_TRUE(fabsl(table.coarse_c_min + rise * held / range - c) <= 1 + ldexpl(fabsl(rise), -31));
            const int32_t angle =
                k < 6U ? (k < 3U ? table.coarse_c_min : table.coarse_c_max) + between(-1, 1) : any(29);
            flags = 0;
            const int32_t p = tl_lookup_coarse_inverse(&lookup, angle, &flags);
            const long double share = ((long double)angle - table.coarse_c_min) / rise;
            TEST_ASSERT_EQUAL_UINT32(share < 0 ? TL_LOOKUP_BELOW : (share > 1 ? TL_LOOKUP_ABOVE : 0U), flags);
            TEST_ASSERT_TRUE(fabsl(table.q_min + range * fminl(fmaxl(share, 0), 1) - p) <=
                             1 + ldexpl(range, -31)); // cut off, as the ratio is
        }
    }
}

// -- the warp of several plays ----------------------------------------------------------------------------------------

static int64_t centre(int64_t node) {
    return table.centre[node];
}

// Y that rises by a period over B at each place: what such a table has to have. B changes slowly here.
static void any_warp(void) {
    do {
        any_grid();
    } while (step < 64 || last * step > 1 << 26);
    const tl_table_t grid = table;
    tl_table_reason_t reason;
    do {
        table = table_fixture_several(1);
        table.nodes = grid.nodes;
        table.step_log2 = grid.step_log2;
        table.q0 = grid.q0;
        table.q_min = (int32_t)position(0);
        table.q_max = (int32_t)position(last);
        const double width = (double)step * between(2, 30), slope = between(-10, 10) / 1000.0 / (double)last;
        const uint32_t log2 = (uint32_t)between(12, 22);
        table.period_log2 = (uint8_t)log2;
        double y = any(20), rise = 0.0;
        for (int64_t i = 0; i <= last; i++) {
            const double here = width * (1.0 + slope * (double)i);
            table.width[i] = (int32_t)here;
            table.centre[i] = (int32_t)y;
            rise = (double)step * ldexp(1.0, (int)log2) / here;
            y += rise < 1.0 ? 1.0 : rise;
            table.angle[i] = (int32_t)i * 1000;
        }
        reason = fabs(y) < 1 << 28 ? tl_lookup_derive(&lookup, &table, TL_TABLE_ANY_AXIS) : TL_TABLE_BAD_WARP;
    } while (reason != TL_TABLE_OK);
}

static void test_the_warp_goes_on_beyond_the_grid_as_the_width_says(void) {
    for (uint32_t i = 0; i < TABLES; i++) {
        any_warp();
        const long double period = ldexpl(1, table.period_log2);
        for (uint32_t k = 0; k < POINTS / 4U; k++) {
            const int32_t p = k % 2U == 0U ? somewhere() : (int32_t)(position(k % 4U == 1U ? 0 : last) + any(22));
            const int64_t first = position(0), end = position(last);
            const int64_t held = p < first ? first : (p > end ? end : p);
            const long double per_count = period / table.width[p < first ? 0 : last];
            const long double beyond = fmaxl(fminl((long double)(p - held) * per_count, 1 << 29), -(1 << 29));
            if (llabs(p - held) < 1 << 29) {
                const long double expected = straight(table.centre, held) + beyond;
                TEST_ASSERT_TRUE(fabsl(expected - tl_lookup_centre(&lookup, p)) <= 1.51L + per_count);
            }
            const int32_t y = k % 3U == 0U ? table.centre[between(0, (int32_t)last)] + between(-1, 1)
                                           : (k % 3U == 1U ? table.centre[k % 2U == 0U ? 0 : last] + any(22)
                                                           : between(table.centre[0], table.centre[last]));
            const int32_t got = tl_lookup_centre_inverse(&lookup, y);
            if (y >= table.centre[0] && y < table.centre[last]) {
                check_inverse(solved(centre, y), got);
            } else {
                const bool below = y < table.centre[0];
                const long double away = (long double)y - table.centre[below ? 0 : last];
                const long double counts = away * table.width[below ? 0 : last] / period;
                if (fabsl(counts) < 1 << 28) {
                    TEST_ASSERT_TRUE(fabsl((long double)position(below ? 0 : last) + counts - got) <= 1.01L);
                }
            }
        }
        for (int64_t node = 0; node < last; node++) {
            check_inverse((long double)position(node), tl_lookup_centre_inverse(&lookup, table.centre[node]));
        }
    }
}

// -- loading ----------------------------------------------------------------------------------------------------------

static int64_t down(int64_t x) { // half of it, rounded down
    return x >= 0 ? x / 2 : (x - 1) / 2;
}

static void check_loaded(const tl_lookup_t *l) {
    const int32_t turn = table.angle[last] < table.angle[0] ? -1 : 0;
    TEST_ASSERT_EQUAL_INT32(table.q0, l->q0);
    TEST_ASSERT_EQUAL_UINT32(table.step_log2, l->step_log2);
    TEST_ASSERT_EQUAL_INT64(last * step, l->extent);
    TEST_ASSERT_EQUAL_INT32(turn, l->turn);
    TEST_ASSERT_EQUAL_INT32(table.angle[0] ^ turn, l->angle_first);
    TEST_ASSERT_EQUAL_INT32(table.angle[last] ^ turn, l->angle_last);
    TEST_ASSERT_EQUAL_INT64(down(twice_low(0)), l->low_first);
    TEST_ASSERT_EQUAL_INT64(down(twice_low(last) + 1), l->low_last);
    TEST_ASSERT_EQUAL_INT64(down(twice_high(0)), l->high_first);
    TEST_ASSERT_EQUAL_INT64(down(twice_high(last) + 1), l->high_last);
    uint32_t flags = 0, flat = 0;
    const int32_t a = tl_lookup_angle(l, table.q_min, &flags), b = tl_lookup_angle(l, table.q_max, &flags);
    TEST_ASSERT_EQUAL_INT32(a < b ? a : b, l->c_low);
    TEST_ASSERT_EQUAL_INT32(a < b ? b : a, l->c_high);
    TEST_ASSERT_EQUAL_UINT32(tl_table_flat_below(&table), l->flat_below);
    for (int64_t i = 0; i < last; i++) {
        flat |= (uint32_t)llabs((int64_t)table.angle[i + 1] - table.angle[i]) < l->flat_below ? 1U : 0U;
        TEST_ASSERT_EQUAL(flat != 0U && (uint32_t)llabs((int64_t)table.angle[i + 1] - table.angle[i]) < l->flat_below,
                          tl_lookup_is_flat(l, (int32_t)position(i)));
    }
    TEST_ASSERT_EQUAL_UINT32(flat, l->has_flat);
    TEST_ASSERT_FALSE(tl_lookup_is_flat(l, (int32_t)position(last)));
    TEST_ASSERT_FALSE(tl_lookup_is_flat(l, (int32_t)position(0) - 1));
    TEST_ASSERT_EQUAL_UINT32(table.plays, l->plays);
    TEST_ASSERT_EQUAL_INT32(table.plays != 0U ? table.narrow : 0, l->narrow);
    TEST_ASSERT_EQUAL_INT32(table.plays != 0U ? 1 << (table.period_log2 - 1) : 0, l->half);
    if ((table.has & TL_TABLE_HAS_encoder) != 0U) {
        const uint64_t share = ((uint64_t)1 << 52) / (uint64_t)table.encoder.period_q12; // of a turn, Q48
        TEST_ASSERT_EQUAL_UINT64(share, (uint64_t)l->phase << 16 | l->phase_rest);
    }
}

static void test_loading_says_all_anew(void) {
    for (uint32_t i = 0; i < TABLES; i++) {
        i % 2U == 0U ? any_table() : any_warp();
        table.flat_speed_q8 = TL_COUNT_ONE;
        table.slope_min_q28 = abs(any(20));
        if (i % 3U == 0U) {
            table.has = TL_TABLE_HAS_encoder;
            table.encoder = (tl_table_encoder_t){.period_q12 = between(1 << 20, 1 << 28), .sine = 100};
        }
        memset(&lookup, i % 4U < 2U ? 0xA5 : 0, sizeof lookup); // whatever was there before
        if (tl_lookup_derive(&lookup, &table, TL_TABLE_ANY_AXIS) == TL_TABLE_OK) {
            check_loaded(&lookup);
        }
    }
}

// p_lo and p_hi are a period of Y apart to a sixteenth of it.
static void test_a_warp_is_right_to_a_sixteenth(void) {
    static const double off[] = {0.05, 0.06, 0.065, 0.075};
    for (uint32_t i = 0; i < 8U; i++) {
        table = table_fixture_several(1);
        last = table.nodes - 1;
        const double by = 1.0 + (i % 2U == 0U ? off[i / 2U] : -off[i / 2U]);
        for (int64_t k = 0; k <= last; k++) {
            table.centre[k] = (int32_t)(table.centre[k] * by);
        }
        TEST_ASSERT_EQUAL(off[i / 2U] < 1.0 / 16.0 ? TL_TABLE_OK : TL_TABLE_BAD_WARP,
                          tl_lookup_derive(&lookup, &table, TL_TABLE_ANY_AXIS));
    }
    table = table_fixture_several(1); // at the last of the nodes that have both
    step = 1 << 14;
    table.centre[table.nodes - 1U] += 1 << 18;
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_WARP, tl_lookup_derive(&lookup, &table, TL_TABLE_ANY_AXIS));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_width_and_angle_are_straight_between_nodes_and_held_beyond);
    RUN_TEST(test_inverses_are_where_the_function_is);
    RUN_TEST(test_the_coarse_kinematics_is_a_line);
    RUN_TEST(test_the_warp_goes_on_beyond_the_grid_as_the_width_says);
    RUN_TEST(test_loading_says_all_anew);
    RUN_TEST(test_a_warp_is_right_to_a_sixteenth);
    return UNITY_END();
}
