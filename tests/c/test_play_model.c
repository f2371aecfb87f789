// The forward play of one element and of several, to the last bit: what tl_play.h and tl_elements.h say, in 64-bit
// numbers on the look-ups that test_lookup_model.c holds against theirs.
#include "draws.h"
#include "table_fixture.h"
#include "tautline/tl_play.h"
#include "tl_elements.h"

#include <math.h>
#include <stdlib.h>
#include <unity.h>

#define LIVES 300
#define TICKS 300

static tl_lookup_t lookup;

void setUp(void) {
    seed = 224466U;
}
void tearDown(void) {}

static int32_t moved_by(void) { // creeps, goes, jumps
    return any(between(0, 9) == 0 ? 22 : (between(0, 1) == 0 ? 3 : 13));
}

static void any_lookup(void) {
    tl_table_t table = table_fixture(1);
    int32_t width = between(0, 400 * TL_COUNT_ONE);
    for (uint32_t i = 0; i < table.nodes; i++) {
        table.width[i] = width;
        width = (int32_t)within(width + between(-16000, 16000), 0, 600 * TL_COUNT_ONE);
    }
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_lookup_derive(&lookup, &table, TL_TABLE_ANY_AXIS));
}

// The motor drags p along with whichever of its edges p meets.
static void test_one_play(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        any_lookup();
        tl_play_t play;
        const int32_t begun = between(0, 9) == 0 ? any(31) : between(-6000, 6000) * TL_COUNT_ONE;
        tl_play_start(&play, &lookup, begun);
        int64_t p = within(begun, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX), q = p;
        TEST_ASSERT_EQUAL_INT64(p, play.p);
        TEST_ASSERT_EQUAL_PTR(&lookup, play.lookup);
        uint32_t flags = 0, ignored = 0;
        (void)tl_lookup_width(&lookup, (int32_t)p, &flags);
        TEST_ASSERT_EQUAL_UINT32(flags, play.flags);
        for (uint32_t tick = 0; tick < TICKS; tick++) {
            q = within(q + moved_by(), INT32_MIN, INT32_MAX);
            const int32_t held = (int32_t)within(q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
            const int64_t low = tl_lookup_p_low(&lookup, held, held, &ignored);
            const int64_t high = tl_lookup_p_high(&lookup, held, held, &ignored);
            if (held >= p ? low > p : high < p) {
                p = held >= p ? low : high;
                flags = 0;
                (void)(held >= p ? tl_lookup_p_low(&lookup, held, held, &flags)
                                 : tl_lookup_p_high(&lookup, held, held, &flags));
            }
            TEST_ASSERT_EQUAL_INT64(p, tl_play_step(&play, (int32_t)q));
            TEST_ASSERT_EQUAL_UINT32(flags, play.flags);
            TEST_ASSERT_EQUAL_INT32(tl_lookup_angle(&lookup, (int32_t)p, &ignored), tl_play_angle(&play));
        }
    }
}

// -- elements ---------------------------------------------------------------------------------------------------------

// Widths rise from one to the next; shares sum up to 1; the mean of width by share is B.
static void any_elements(void) {
    tl_table_reason_t reason;
    do {
        tl_table_t table = table_fixture_several(1);
        static const uint32_t rounds_up[] = {3283, 13257, 48996}; // the second's v is 16 but for less than a last bit
        const bool chosen = once_in(20);
        table.plays = (uint8_t)(chosen ? 3 : between(2, (int32_t)TL_TABLE_PLAYS_MAX));
        uint32_t left = 65536U;
        double mean = 0.0, widths[TL_TABLE_PLAYS_MAX];
        for (uint32_t i = 0; i < table.plays; i++) {
            const uint32_t drawn = i + 1U == table.plays ? left : left / (uint32_t)between(2, 4);
            const uint32_t share = chosen ? rounds_up[i] : drawn;
            table.play_weight_q16[i] = share;
            left -= share;
            widths[i] = (i == 0U ? 0.0 : widths[i - 1U]) + between(1, 100);
            mean += widths[i] * share / 65536.0;
        }
        for (uint32_t i = 0; i < table.plays; i++) {
            table.play_width_q28[i] = (uint32_t)(widths[i] / mean * (1 << 28));
        }
        reason = tl_lookup_derive(&lookup, &table, TL_TABLE_ANY_AXIS);
    } while (reason != TL_TABLE_OK);
}

// What loading makes of shares and widths, from tl_elements.h.
static void test_elements_are_what_the_table_says(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        any_elements();
        const tl_table_t *table = &lookup.table;
        TEST_ASSERT_EQUAL_UINT32(table->plays, lookup.plays);
        TEST_ASSERT_EQUAL_INT32((int32_t)1 << (table->period_log2 - 1U), lookup.half);
        double weight = 0.0, lag = 0.0, before = 0.0;
        for (uint32_t i = 0; i < table->plays; i++) {
            const tl_element_t *e = &lookup.element[i];
            const double half = ldexp(table->play_width_q28[i], (int)table->period_log2 - 29);
            TEST_ASSERT_DOUBLE_WITHIN(0.5, half, e->half);
            TEST_ASSERT_EQUAL_UINT32(table->play_weight_q16[i], e->weight_q16);
            weight += e->weight_q16 / 65536.0;
            lag += e->weight_q16 / 65536.0 * e->half;
            TEST_ASSERT_EQUAL_INT32((int32_t)floor(weight * e->half - lag + 1e-6), e->lag_most);
            const double undo = i == 0U ? 0.0 : before - 1.0 / weight; // v
            TEST_ASSERT_DOUBLE_WITHIN(undo * ldexp(1.0, -16) + ldexp(1.0, -16), undo,
                                      ldexp(e->undo, (int)e->undo_log2 - 16));
            TEST_ASSERT_TRUE(e->undo_log2 == 0U || e->undo >= 32768U); // 16 bits of it
            before = 1.0 / weight;
        }
    }
}

static int64_t share(int64_t lag, int64_t factor_q16) {
    return (lag * factor_q16) >> 16;
}

static void test_elements_lag_by_no_more_than_their_halves(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        any_elements();
        int32_t behind[TL_TABLE_PLAYS_MAX] = {0}, ahead[TL_TABLE_PLAYS_MAX] = {0};
        int64_t x[TL_TABLE_PLAYS_MAX] = {0}, y[TL_TABLE_PLAYS_MAX] = {0};
        for (uint32_t tick = 0; tick < 60U; tick++) {
            const int32_t moved = between(0, 9) == 0 ? any(31) : any(19);
            const int64_t by = within(moved, -(1 << 28), 1 << 28);
            int64_t lags = 0, leads = 0;
            for (uint32_t i = 0; i < lookup.plays; i++) {
                const tl_element_t *e = &lookup.element[i];
                x[i] = within(x[i] + by, -e->half, e->half);
                lags += share(x[i], e->weight_q16);
                y[i] = i == 0U ? 0 : within(y[i] + by, -e->lag_most, e->lag_most);
                leads += share(y[i], e->undo) * ((int64_t)1 << e->undo_log2);
            }
            TEST_ASSERT_EQUAL_INT64(lags, tl_elements_behind(&lookup, moved, behind));
            TEST_ASSERT_EQUAL_INT64(leads, tl_elements_ahead(&lookup, moved, ahead));
            int32_t undo[TL_TABLE_PLAYS_MAX];
            tl_elements_undo(&lookup, behind, undo);
            for (uint32_t j = 0; j < lookup.plays; j++) {
                int64_t expected = 0;
                TEST_ASSERT_EQUAL_INT64(x[j], behind[j]);
                TEST_ASSERT_EQUAL_INT64(y[j], ahead[j]);
                for (uint32_t i = 0; i < j; i++) {
                    expected += share(x[j] - x[i], lookup.element[i].weight_q16);
                }
                TEST_ASSERT_EQUAL_INT64(expected, undo[j]);
            }
        }
    }
}

// All that can lag as far as the first does so; how far is what their shares then come to.
static void test_elements_begin_as_near_to_one_place_as_they_can(void) {
    for (uint32_t life = 0; life < LIVES; life++) {
        any_elements();
        for (uint32_t k = 0; k < 60U; k++) {
            const int32_t apart = between(0, 5) == 0 ? any(31) : between(-lookup.half, lookup.half);
            int32_t lag[TL_TABLE_PLAYS_MAX];
            tl_elements_start(&lookup, apart, lag);
            const double most = lookup.half, wanted = fmin(fabs((double)apart), most);
            double sum = 0.0;
            int64_t common = 0;
            for (uint32_t i = 0; i < lookup.plays; i++) {
                TEST_ASSERT_TRUE(apart < 0 ? lag[i] <= 0 : lag[i] >= 0);
                TEST_ASSERT_TRUE(abs(lag[i]) <= lookup.element[i].half);
                common = abs(lag[i]) > common ? abs(lag[i]) : common;
                sum += fabs((double)lag[i]) * lookup.element[i].weight_q16 / 65536.0;
            }
            for (uint32_t i = 0; i < lookup.plays; i++) {
                TEST_ASSERT_EQUAL_INT64(within(common, 0, lookup.element[i].half), abs(lag[i]));
            }
            // cut off; the last element may reach no further, where halves were rounded
            TEST_ASSERT_TRUE(sum <= wanted + 1e-6 && sum >= fmin(wanted, most - 2.0) - 1.0);
        }
    }
}

static void test_narrow_places_and_the_motor_s_edges(void) {
    for (uint32_t life = 0; life < 100U; life++) {
        any_elements();
        lookup.narrow = between(1, 400 * TL_COUNT_ONE);
        for (uint32_t i = 0; i < lookup.table.nodes; i++) {
            lookup.table.width[i] = between(0, 2) == 0 ? lookup.narrow : lookup.narrow + between(-1, 1);
        }
        for (uint32_t k = 0; k < 200U; k++) {
            const int32_t p = between(0, 9) == 0 ? any(30) : between(-5100, 5200) * TL_COUNT_ONE;
            const int64_t span = within((p - (int64_t)lookup.q0) >> 14, 0, lookup.table.nodes - 2);
            const int32_t *width = lookup.table.width + (p < lookup.q0 ? 0 : span);
            TEST_ASSERT_EQUAL(width[0] < lookup.narrow && width[1] < lookup.narrow, tl_elements_narrow(&lookup, p));
            const int64_t y = tl_lookup_centre(&lookup, p);
            TEST_ASSERT_EQUAL_INT64(y + lookup.half, tl_elements_motor(&lookup, 1, p));
            TEST_ASSERT_EQUAL_INT64(y - lookup.half, tl_elements_motor(&lookup, -1, p));
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_one_play);
    RUN_TEST(test_elements_are_what_the_table_says);
    RUN_TEST(test_elements_lag_by_no_more_than_their_halves);
    RUN_TEST(test_elements_begin_as_near_to_one_place_as_they_can);
    RUN_TEST(test_narrow_places_and_the_motor_s_edges);
    return UNITY_END();
}
