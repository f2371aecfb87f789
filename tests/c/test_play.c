// The play operator: B = 300 counts around p, f = 12 deg/mm.
#include "table_fixture.h"
#include "tautline/tl_play.h"

#include <unity.h>

static tl_lookup_t lookup;
static tl_play_t play;

void setUp(void) {
    const tl_table_t table = table_fixture(1);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_derive(&lookup, &table, 0));
    tl_play_start(&play, &lookup, 0);
}
void tearDown(void) {}

#define COUNTS(x) ((x) * TL_COUNT_ONE)

static void test_inside_the_backlash_nothing_moves(void) {
    for (int32_t q = COUNTS(-150); q <= COUNTS(150); q += 100) {
        TEST_ASSERT_EQUAL_INT32(0, tl_play_step(&play, q));
    }
    TEST_ASSERT_INT32_WITHIN(2, -TL_DEG_ONE * 60 + 5000 * 50332 / 64, tl_play_angle(&play));
}

static void test_a_loop_shows_the_whole_width(void) {
    TEST_ASSERT_INT32_WITHIN(1, COUNTS(850), tl_play_step(&play, COUNTS(1000)));
    TEST_ASSERT_INT32_WITHIN(1, COUNTS(850), tl_play_step(&play, COUNTS(701)));
    TEST_ASSERT_INT32_WITHIN(1, COUNTS(849), tl_play_step(&play, COUNTS(699)));
    TEST_ASSERT_INT32_WITHIN(1, COUNTS(-850), tl_play_step(&play, COUNTS(-1000)));
    TEST_ASSERT_INT32_WITHIN(1, COUNTS(-850), tl_play_step(&play, COUNTS(-701)));
    TEST_ASSERT_INT32_WITHIN(1, COUNTS(-849), tl_play_step(&play, COUNTS(-699)));
}

static void test_rest_is_rest(void) {
    const int32_t p = tl_play_step(&play, COUNTS(1234) + 17);
    for (int i = 0; i < 1000; i++) {
        TEST_ASSERT_EQUAL_INT32(p, tl_play_step(&play, COUNTS(1234) + 17));
    }
}

// One step or many along a stroke: the same place.
static void test_only_the_turning_points_matter(void) {
    tl_play_t fine = play;
    static const int32_t turns[] = {0, 1000, -800, 790, -1, 4000, -4000, 3333};
    for (size_t i = 1; i < sizeof turns / sizeof turns[0]; i++) {
        const int32_t from = COUNTS(turns[i - 1]), to = COUNTS(turns[i]);
        for (int k = 1; k <= 100; k++) {
            (void)tl_play_step(&fine, from + (to - from) / 100 * k + (k == 100 ? (to - from) % 100 : 0));
        }
        TEST_ASSERT_INT32_WITHIN(1, tl_play_step(&play, to), fine.p);
    }
}

// Where |B'| is 1.99 an envelope hardly moves with p: the last bit of q decides over hundreds of those of p.
static void test_the_shortest_reversals_are_seen_where_the_width_is_steep(void) {
    tl_table_t table = table_fixture(1);
    const int32_t rise = (199 << 14) / 100;
    for (unsigned i = 0; i < table.nodes; i++) {
        table.width[i] = COUNTS(200) + (i % 2 == 0 ? 0 : rise);
    }
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_derive(&lookup, &table, 0));
    uint32_t flags = 0;
    for (int32_t p = COUNTS(-3000); p < COUNTS(3000); p += 1237) {
        const int32_t back = p - 3 * TL_COUNT_ONE / 2;
        tl_play_start(&play, &lookup, p - COUNTS(100));
        (void)tl_play_step(&play, p + tl_lookup_width(&lookup, p, &flags) / 2);
        TEST_ASSERT_INT32_WITHIN(TL_COUNT_ONE, p, play.p);
        (void)tl_play_step(&play, back - tl_lookup_width(&lookup, back, &flags) / 2);
        TEST_ASSERT_INT32_WITHIN(TL_COUNT_ONE, back, play.p);
    }
}

static void test_beyond_the_grid_it_is_flagged_and_saturates(void) {
    (void)tl_play_step(&play, INT32_MAX);
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_ABOVE, play.flags);
    TEST_ASSERT_EQUAL_INT32(TL_TABLE_VALUE_MAX - COUNTS(150), play.p);
    (void)tl_play_step(&play, INT32_MIN);
    TEST_ASSERT_TRUE(play.flags & TL_LOOKUP_BELOW);
    TEST_ASSERT_EQUAL_INT32(-TL_TABLE_VALUE_MAX + COUNTS(150), play.p);
    TEST_ASSERT_EQUAL_INT32(lookup.table.angle[0], tl_play_angle(&play));
    (void)tl_play_step(&play, -TL_TABLE_VALUE_MAX + COUNTS(200)); // within the backlash: still there
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_BELOW, play.flags);
    (void)tl_play_step(&play, 0);
    TEST_ASSERT_EQUAL_HEX32(0, play.flags);
    tl_play_start(&play, &lookup, INT32_MIN);
    (void)tl_play_step(&play, INT32_MAX);
    TEST_ASSERT_EQUAL_INT32(TL_TABLE_VALUE_MAX - COUNTS(150), play.p);
}

static void test_without_nodes_the_instrument_follows_the_motor(void) {
    tl_table_t table = table_fixture(1);
    table.nodes = 0;
    table.q0 = 0;
    table.step_log2 = 0;
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_derive(&lookup, &table, 0));
    tl_play_start(&play, &lookup, 0);
    TEST_ASSERT_EQUAL_INT32(77, tl_play_step(&play, 77));
    TEST_ASSERT_EQUAL_INT32(-5, tl_play_step(&play, -5));
}

// Two plays of 150 and 450 counts: the tip follows the first at half speed, then both.
static void test_several_plays_begin_one_after_the_other(void) {
    const tl_table_t table = table_fixture_several(1);
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_derive(&lookup, &table, 0));
    tl_play_start(&play, &lookup, 0);
    static const struct {
        int32_t q, p;
    } path[] = {{0, 0},      {75, 0},       {225, 75},    {425, 275},   {1000, 850}, {850, 850},
                {650, 750},  {550, 700},    {450, 600},   {600, 600},   {700, 650},  {1000, 850},
                {1100, 950}, {-1000, -850}, {-850, -850}, {-650, -750}, {-550, -700}};
    for (size_t i = 0; i < sizeof path / sizeof path[0]; i++) {
        TEST_ASSERT_INT32_WITHIN(8, COUNTS(path[i].p), tl_play_step(&play, COUNTS(path[i].q)));
        TEST_ASSERT_INT32_WITHIN(8, COUNTS(path[i].p), tl_play_step(&play, COUNTS(path[i].q))); // at rest
        TEST_ASSERT_EQUAL_HEX32(0, play.flags);
    }
    (void)tl_play_step(&play, COUNTS(9000));
    TEST_ASSERT_INT32_WITHIN(64, COUNTS(8850), play.p);
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_ABOVE, play.flags);
    (void)tl_play_step(&play, INT32_MIN); // however far beyond
    TEST_ASSERT_EQUAL_HEX32(TL_LOOKUP_BELOW, play.flags);
    (void)tl_play_step(&play, INT32_MAX);
    (void)tl_play_step(&play, COUNTS(1000));
    (void)tl_play_step(&play, COUNTS(0));
    TEST_ASSERT_INT32_WITHIN(8, COUNTS(150), play.p);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_inside_the_backlash_nothing_moves);
    RUN_TEST(test_a_loop_shows_the_whole_width);
    RUN_TEST(test_rest_is_rest);
    RUN_TEST(test_only_the_turning_points_matter);
    RUN_TEST(test_the_shortest_reversals_are_seen_where_the_width_is_steep);
    RUN_TEST(test_beyond_the_grid_it_is_flagged_and_saturates);
    RUN_TEST(test_several_plays_begin_one_after_the_other);
    RUN_TEST(test_without_nodes_the_instrument_follows_the_motor);
    return UNITY_END();
}
