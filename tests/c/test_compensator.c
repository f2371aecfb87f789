// The inverse with take-up: B = 300 counts, f = 12 deg/mm, 10000 counts/s and 100000 counts/s^2 at 1 kHz.
#include "table_fixture.h"
#include "tautline/tl_compensator.h"
#include "tautline/tl_play.h"

#include <unity.h>

#define COUNTS(x) ((tl_count_q8_t)((x) * TL_COUNT_ONE))
#define RATE      1000U

static tl_lookup_t rising, falling, identity, narrow, other, several, downwards;
static tl_compensator_t k;

static void load(tl_lookup_t *lookup, const tl_table_t *table) {
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_derive(lookup, table, 0));
}

void setUp(void) {
    tl_table_t table = table_fixture(1);
    load(&rising, &table);
    for (unsigned i = 0; i < table.nodes; i++) {
        table.width[i] = COUNTS(100);
    }
    table.q_min = COUNTS(-1000);
    table.q_max = COUNTS(1000);
    table.coarse_c_min = -12 * TL_DEG_ONE;
    table.coarse_c_max = 12 * TL_DEG_ONE;
    load(&narrow, &table);
    table = table_fixture(-1);
    load(&falling, &table);
    table = table_fixture_several(1);
    load(&several, &table);
    table = table_fixture_several(-1);
    load(&downwards, &table);
    table = table_fixture(1);
    table.nodes = 0;
    table.q0 = 0;
    table.step_log2 = 0;
    load(&identity, &table);
}
void tearDown(void) {}

static tl_deg_q16_t angle(const tl_lookup_t *lookup, tl_count_q8_t p) {
    uint32_t flags = 0;
    return tl_lookup_angle(lookup, p, &flags);
}

static tl_count_q8_t hold(tl_deg_q16_t c, int ticks) {
    for (int i = 0; i < ticks; i++) {
        (void)tl_compensator_step(&k, c);
    }
    return k.q;
}

static void start(const tl_lookup_t *lookup, tl_mode_t mode, tl_count_q8_t p) {
    tl_compensator_start(&k, lookup, RATE, mode, p, angle(lookup, p));
}

static void test_each_side_is_half_the_width_away(void) {
    start(&rising, TL_MODE_FULL, 0);
    TEST_ASSERT_INT32_WITHIN(2, 0, hold(angle(&rising, 0), 10));
    TEST_ASSERT_EQUAL_HEX32(TL_COMPENSATOR_NO_SIDE, k.flags);
    TEST_ASSERT_INT32_WITHIN(4, COUNTS(100 + 150), hold(angle(&rising, COUNTS(100)), 400));
    TEST_ASSERT_EQUAL_HEX32(0, k.flags);
    TEST_ASSERT_INT32_WITHIN(4, COUNTS(50 - 150), hold(angle(&rising, COUNTS(50)), 400));
    TEST_ASSERT_INT32_WITHIN(4, COUNTS(50 - 150), hold(angle(&rising, COUNTS(50)), 400)); // at rest: unchanged
}

// Rising and falling are those of p: with a falling f a smaller c is a larger p.
static void test_the_side_follows_p_where_f_falls(void) {
    start(&falling, TL_MODE_FULL, 0);
    TEST_ASSERT_TRUE(angle(&falling, COUNTS(100)) < angle(&falling, 0));
    TEST_ASSERT_INT32_WITHIN(4, COUNTS(100 + 150), hold(angle(&falling, COUNTS(100)), 400));
    TEST_ASSERT_INT32_WITHIN(4, COUNTS(50 - 150), hold(angle(&falling, COUNTS(50)), 400));
}

static void test_the_tip_is_where_it_was_sent_after_every_reversal(void) {
    tl_play_t play;
    start(&rising, TL_MODE_FULL, 0);
    tl_play_start(&play, &rising, 0);
    static const int goals[] = {500, 490, 510, -2000, -1990, 3000, 0, 4000, -4800, 4800};
    for (size_t i = 0; i < sizeof goals / sizeof goals[0]; i++) {
        const tl_deg_q16_t c = angle(&rising, COUNTS(goals[i]));
        for (int tick = 0; tick < 1000; tick++) {
            (void)tl_play_step(&play, tl_compensator_step(&k, c));
        }
        TEST_ASSERT_INT32_WITHIN(COUNTS(2), COUNTS(goals[i]), play.p);
        TEST_ASSERT_INT32_WITHIN(TL_DEG_ONE / 40, c, tl_play_angle(&play));
    }
}

static void test_the_take_up_keeps_its_limits_and_does_not_overshoot(void) {
    const int32_t speed = COUNTS(10), accel = COUNTS(100000) / 1000000; // per tick, per tick^2
    start(&rising, TL_MODE_FULL, 0);
    (void)hold(angle(&rising, COUNTS(1000)), 500);
    const tl_deg_q16_t c = angle(&rising, COUNTS(990));
    int32_t q = k.q, moved = 0, fastest = 0;
    for (int tick = 0; tick < 500; tick++) {
        const int32_t next = tl_compensator_step(&k, c);
        const int32_t now = next - q - (tick == 0 ? k.p - COUNTS(1000) : 0); // the feed of the first tick apart
        TEST_ASSERT_INT32_WITHIN(accel + 2, moved, now);
        TEST_ASSERT_INT32_WITHIN(speed + 1, 0, now);
        TEST_ASSERT_TRUE(now <= 1);
        fastest = now < fastest ? now : fastest;
        moved = now;
        q = next;
    }
    TEST_ASSERT_INT32_WITHIN(4, COUNTS(990 - 150), q);
    TEST_ASSERT_TRUE(fastest < -COUNTS(5)); // 300 counts at 0.1 count/tick^2 reach 5.5 counts/tick
    TEST_ASSERT_EQUAL_INT32(0, tl_compensator_rest(&k));
}

static void test_turning_back_half_way_brakes_first(void) {
    const int32_t accel = COUNTS(100000) / 1000000;
    start(&rising, TL_MODE_FULL, 0);
    (void)hold(angle(&rising, COUNTS(1000)), 500);
    int32_t q = hold(angle(&rising, COUNTS(990)), 40), moved = 0;
    TEST_ASSERT_TRUE(k.flags & TL_COMPENSATOR_TAKE_UP);
    const tl_deg_q16_t c = angle(&rising, COUNTS(1000));
    const int32_t p = k.p;
    for (int tick = 0; tick < 500; tick++) {
        const int32_t next = tl_compensator_step(&k, c);
        const int32_t now = next - q - (tick == 0 ? k.p - p : 0);
        if (tick > 0) {
            TEST_ASSERT_INT32_WITHIN(accel + 2, moved, now);
        }
        moved = now;
        q = next;
    }
    TEST_ASSERT_INT32_WITHIN(4, COUNTS(1000 + 150), q);
}

static void test_jitter_within_the_band_never_crosses(void) {
    start(&rising, TL_MODE_FULL, 0);
    (void)hold(angle(&rising, COUNTS(1000)), 500);
    uint32_t seed = 3;
    for (int tick = 0; tick < 5000; tick++) {
        seed = seed * 1664525U + 1013904223U;
        const int32_t jitter = (int32_t)(seed >> 16) % COUNTS(2); // less than the band of 2 counts
        (void)tl_compensator_step(&k, angle(&rising, COUNTS(998) + 8 + jitter));
        TEST_ASSERT_EQUAL_INT(1, k.side);
        TEST_ASSERT_EQUAL_HEX32(0, k.flags);
    }
    (void)tl_compensator_step(&k, angle(&rising, COUNTS(990)));
    TEST_ASSERT_EQUAL_INT(-1, k.side);
}

// Whatever is switched, the output does not move by it; afterwards it arrives where the new settings say.
static void test_nothing_that_is_switched_makes_the_axis_jump(void) {
    const int32_t most = COUNTS(100000) / 1000000 + 1; // a take-up's first tick
    start(&rising, TL_MODE_FULL, COUNTS(-400));
    const tl_deg_q16_t c = angle(&rising, COUNTS(500));
    int32_t q = hold(c, 600);
#define SWITCH(action, goal)                                                                                           \
    action;                                                                                                            \
    TEST_ASSERT_EQUAL_INT32(q, k.q);                                                                                   \
    TEST_ASSERT_INT32_WITHIN(most, q, tl_compensator_step(&k, c));                                                     \
    q = hold(c, 1000);                                                                                                 \
    TEST_ASSERT_INT32_WITHIN(COUNTS(1), COUNTS(goal), q);                                                              \
    TEST_ASSERT_EQUAL_INT32(0, tl_compensator_rest(&k))

    SWITCH(tl_compensator_set_strength(&k, TL_RATIO_ONE / 2), 500 + 75);
    SWITCH(tl_compensator_set_strength(&k, 0), 500);
    SWITCH(tl_compensator_set_strength(&k, INT32_MAX), 500 + 150);
    SWITCH(tl_compensator_set_strength(&k, INT32_MIN), 500);
    SWITCH(tl_compensator_set_strength(&k, TL_RATIO_ONE), 500 + 150);
    SWITCH(tl_compensator_set_mode(&k, TL_MODE_OFF), 500);
    SWITCH(tl_compensator_set_mode(&k, TL_MODE_BACKLASH), 500 + 150);
    SWITCH(tl_compensator_set_table(&k, &narrow), 500 + 50);
    SWITCH(tl_compensator_set_table(&k, &identity), 500);
    SWITCH(tl_compensator_set_table(&k, &rising), 500 + 150);
    SWITCH(tl_compensator_set_mode(&k, TL_MODE_FULL), 500 + 150);
    // Starting again forgets the side, but where the motor is will do until the first motion.
    SWITCH(tl_compensator_start(&k, &rising, RATE, TL_MODE_FULL, q, c), 500 + 150);
}

// A limited feed is not delayed by a slow take-up, and a table's lower limits count as soon as it has braked.
static void test_a_new_table_s_limits_are_kept_after_braking(void) {
    tl_table_t table = table_fixture(1);
    table.takeup_speed_q8 = COUNTS(500); // 0.5 counts a tick
    load(&other, &table);
    start(&rising, TL_MODE_FULL, 0);
    (void)hold(angle(&rising, COUNTS(1000)), 500);
    (void)hold(angle(&rising, COUNTS(990)), 40); // 4 counts a tick by now
    tl_compensator_set_table(&k, &other);
    int32_t q = hold(angle(&rising, COUNTS(990)), 45);
    for (int tick = 0; tick < 2000; tick++) {
        const int32_t next = tl_compensator_step(&k, angle(&rising, COUNTS(990)));
        TEST_ASSERT_INT32_WITHIN(COUNTS(1) / 2 + 1, q, next);
        q = next;
    }
    TEST_ASSERT_INT32_WITHIN(4, COUNTS(990 - 150), q);
}

// Another law gives another p for the same c. That is no motion: the side stays.
static void test_changing_the_law_is_no_reversal(void) {
    tl_table_t table = table_fixture(1);
    table.coarse_c_min = -50 * TL_DEG_ONE;
    table.coarse_c_max = 50 * TL_DEG_ONE; // the coarse p of a positive c is larger than f's
    load(&other, &table);
    const tl_deg_q16_t c = angle(&other, COUNTS(1000));
    tl_compensator_start(&k, &other, RATE, TL_MODE_FULL, 0, 0);
    (void)hold(c, 500);
    for (int turn = 0; turn < 6; turn++) {
        tl_compensator_set_mode(&k, turn % 2 ? TL_MODE_FULL : TL_MODE_BACKLASH);
        (void)hold(c + 16, 500);
        TEST_ASSERT_EQUAL_INT(1, k.side);
    }
    TEST_ASSERT_INT32_WITHIN(COUNTS(1), COUNTS(1000 + 150), k.q);
    tl_compensator_set_mode(&k, TL_MODE_BACKLASH); // and the furthest point moved along: this is a reversal
    (void)hold(c - 1000 * 12, 500);
    TEST_ASSERT_EQUAL_INT(-1, k.side);
}

// Ten flat spans of 64 counts in the middle, at 640 counts/s: a second. Elsewhere 20 counts a tick.
static void test_flat_spans_are_crossed_at_the_flat_speed_both_ways(void) {
    tl_table_t table = table_fixture(1);
    const unsigned first = 74, count = 10;
    for (unsigned i = 0; i < table.nodes; i++) {
        const unsigned flat = i <= first ? 0 : (i < first + count ? i - first : count);
        table.angle[i] -= (int32_t)flat * (50332 - 40);
    }
    table.slope_min_q28 = 4096; // 64 of the last bit a span
    table.flat_speed_q8 = COUNTS(640);
    load(&other, &table);
    const int32_t low = table.q0 + (int32_t)(first << 14), high = low + (int32_t)(count << 14);
    start(&other, TL_MODE_FULL, low - COUNTS(1000));
    for (int way = 0; way < 2; way++) {
        const int32_t goal = way == 0 ? high + COUNTS(1000) : low - COUNTS(1000);
        int within = 0, outside = 0;
        while (tl_clamp(goal - k.p, -COUNTS(1), COUNTS(1)) != goal - k.p && within + outside < 3000) {
            const int32_t before = k.p;
            (void)tl_compensator_step(&k, angle(&other, goal));
            const bool in_flat = (before > low && before < high) || (k.p > low && k.p < high);
            in_flat ? within++ : outside++;
            TEST_ASSERT_INT32_WITHIN(in_flat ? COUNTS(640) / 1000 + 1 : COUNTS(20), before, k.p);
        }
        TEST_ASSERT_INT_WITHIN(5, 1000, within);
        TEST_ASSERT_INT_WITHIN(5, 100, outside);
    }
}

static void test_switching_on_within_the_backlash_moves_nothing(void) {
    for (int offset = -150; offset <= 150; offset += 50) {
        tl_compensator_start(&k, &rising, RATE, TL_MODE_FULL, COUNTS(1000 + offset), angle(&rising, COUNTS(1000)));
        for (int tick = 0; tick < 100; tick++) {
            TEST_ASSERT_INT32_WITHIN(2, COUNTS(1000 + offset), tl_compensator_step(&k, angle(&rising, COUNTS(1000))));
        }
        TEST_ASSERT_INT32_WITHIN(4, COUNTS(1100 + 150), hold(angle(&rising, COUNTS(1100)), 400));
    }
}

static void test_switching_on_far_from_the_command_travels_within_limits(void) {
    tl_compensator_start(&k, &rising, RATE, TL_MODE_FULL, COUNTS(-3000), angle(&rising, COUNTS(3000)));
    int32_t q = COUNTS(-3000), ticks = 0;
    while (q < COUNTS(2849) && ticks < 2000) { // to the near side of the backlash
        const int32_t next = tl_compensator_step(&k, angle(&rising, COUNTS(3000)));
        TEST_ASSERT_TRUE(next >= q && next - q <= COUNTS(10) + 1);
        q = next;
        ticks++;
    }
    TEST_ASSERT_INT32_WITHIN(5, 5850 / 10 + 100, ticks);
}

static void test_commands_beyond_the_table_saturate_and_say_so(void) {
    start(&rising, TL_MODE_FULL, 0);
    TEST_ASSERT_EQUAL_INT32(COUNTS(5000), hold(INT32_MAX, 2000));
    TEST_ASSERT_TRUE(k.flags & TL_COMPENSATOR_ABOVE);
    TEST_ASSERT_TRUE(k.flags & TL_COMPENSATOR_CLIPPED); // p* + B/2 would be outside
    TEST_ASSERT_EQUAL_INT32(COUNTS(-5000), hold(INT32_MIN, 2000));
    TEST_ASSERT_TRUE(k.flags & TL_COMPENSATOR_BELOW);
    (void)hold(0, 2000);
    TEST_ASSERT_EQUAL_HEX32(0, k.flags);
    start(&falling, TL_MODE_FULL, 0);
    TEST_ASSERT_EQUAL_INT32(COUNTS(-5000), hold(INT32_MAX, 2000));
    TEST_ASSERT_TRUE(k.flags & TL_COMPENSATOR_BELOW);
}

static void test_an_axis_outside_its_range_is_only_led_inwards(void) {
    tl_compensator_start(&k, &narrow, RATE, TL_MODE_FULL, COUNTS(1500), INT32_MAX);
    int32_t q = k.q;
    for (int tick = 0; tick < 500; tick++) {
        const int32_t next = tl_compensator_step(&k, INT32_MAX);
        TEST_ASSERT_TRUE(next <= q && next >= COUNTS(1000));
        q = next;
    }
    TEST_ASSERT_EQUAL_INT32(COUNTS(1000), q);
    tl_compensator_start(&k, &narrow, RATE, TL_MODE_FULL, COUNTS(-1500), INT32_MIN);
    q = k.q;
    for (int tick = 0; tick < 500; tick++) {
        const int32_t next = tl_compensator_step(&k, INT32_MIN);
        TEST_ASSERT_TRUE(next >= q && next <= COUNTS(-1000));
        TEST_ASSERT_TRUE(next - q <= COUNTS(10) + 1);
        q = next;
    }
    TEST_ASSERT_EQUAL_INT32(COUNTS(-1000), q);
}

static void test_the_feed_is_held_back_by_the_speed_limit_alone(void) {
    start(&rising, TL_MODE_FULL, 0);
    (void)hold(angle(&rising, COUNTS(100)), 500);
    int32_t q = k.q;
    for (int tick = 0; tick < 195; tick++) { // 20 counts a tick
        const int32_t next = tl_compensator_step(&k, angle(&rising, COUNTS(4000)));
        TEST_ASSERT_INT32_WITHIN(2, COUNTS(20), next - q);
        q = next;
    }
    TEST_ASSERT_EQUAL_HEX32(0, hold(angle(&rising, COUNTS(4000)), 10) == 0 ? 1 : k.flags);
}

static void test_extreme_settings_are_safe(void) {
    tl_table_t table = table_fixture(1);
    table.takeup_accel = INT32_MAX;
    table.takeup_speed_q8 = table.speed_max_q8 = TL_TABLE_VALUE_MAX;
    static const uint32_t rates[] = {0, 1, 16, 1000, 10000, 100000, UINT32_MAX};
    for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
        for (int slow = 0; slow < 2; slow++) {
            table.takeup_accel = slow ? 1 : INT32_MAX;
            load(&rising, &table);
            tl_compensator_start(&k, &rising, rates[i], TL_MODE_FULL, INT32_MIN, INT32_MAX);
            for (int tick = 0; tick < 2000; tick++) {
                const tl_deg_q16_t c = tick % 3 == 0 ? INT32_MIN : (tick % 3 == 1 ? INT32_MAX : 0);
                (void)tl_compensator_step(&k, c);
                tl_compensator_set_strength(&k, tick * 37);
                tl_compensator_set_mode(&k, (tl_mode_t)(tick % 3));
                tl_compensator_set_table(&k, tick % 5 == 0 ? &falling : (tick % 5 == 2 ? &several : &rising));
            }
        }
    }
}

// Two plays of 150 and 450 counts, which share the motion evenly.
static void test_several_plays_are_undone_one_after_the_other(void) {
    static const struct {
        int32_t p, q;
    } path[] = {{50, 175},  {75, 225},  {100, 250},   {850, 1000},   {800, 750},   {750, 650},
                {600, 450}, {650, 700}, {1000, 1150}, {-850, -1000}, {-750, -650}, {-700, -550}};
    const tl_lookup_t *const loaded[] = {&several, &downwards};
    for (unsigned sign = 0; sign < 2; sign++) {
        start(loaded[sign], TL_MODE_FULL, 0);
        tl_play_t play;
        tl_play_start(&play, loaded[sign], 0);
        for (size_t i = 0; i < sizeof path / sizeof path[0]; i++) {
            const tl_deg_q16_t c = angle(loaded[sign], COUNTS(path[i].p));
            for (int tick = 0; tick < 600; tick++) {
                (void)tl_play_step(&play, tl_compensator_step(&k, c));
            }
            TEST_ASSERT_INT32_WITHIN(16, COUNTS(path[i].q), k.q);
            TEST_ASSERT_INT32_WITHIN(16, COUNTS(path[i].p), play.p);
            TEST_ASSERT_EQUAL_HEX32(0, k.flags);
        }
    }
}

// Within the backlash p and q do not tell where each play is; the forward play does.
static void test_switched_on_in_an_inner_loop_it_knows_each_play(void) {
    tl_play_t play;
    tl_play_start(&play, &several, 0);
    static const int32_t path[] = {1000, 650, 700}; // the plays are at 725 and 775, the tip at 750
    for (size_t i = 0; i < sizeof path / sizeof path[0]; i++) {
        (void)tl_play_step(&play, COUNTS(path[i]));
    }
    for (int knows = 0; knows < 2; knows++) {
        tl_compensator_start(&k, &several, RATE, TL_MODE_FULL, COUNTS(700), tl_play_angle(&play));
        if (knows) {
            tl_compensator_know(&k, &play);
        }
        TEST_ASSERT_INT32_WITHIN(16, COUNTS(700), hold(angle(&several, COUNTS(750)), 10));
        TEST_ASSERT_INT32_WITHIN(16, COUNTS(knows ? 900 : 925), hold(angle(&several, COUNTS(800)), 600));
    }
    tl_compensator_start(&k, &rising, RATE, TL_MODE_FULL, COUNTS(700), tl_play_angle(&play));
    tl_compensator_know(&k, &play); // of another table
    TEST_ASSERT_INT32_WITHIN(16, COUNTS(950), hold(angle(&several, COUNTS(800)), 600));
}

static void test_the_strength_shares_what_several_plays_lose(void) {
    start(&several, TL_MODE_FULL, 0);
    (void)hold(angle(&several, COUNTS(850)), 600);
    tl_compensator_set_strength(&k, TL_RATIO_ONE / 2);
    TEST_ASSERT_INT32_WITHIN(16, COUNTS(925), hold(angle(&several, COUNTS(850)), 600));
    TEST_ASSERT_INT32_WITHIN(16, COUNTS(700), hold(angle(&several, COUNTS(750)), 600)); // 650 in full
    tl_compensator_set_mode(&k, TL_MODE_OFF);
    TEST_ASSERT_INT32_WITHIN(300, COUNTS(750), hold(angle(&several, COUNTS(750)), 600));
    tl_compensator_set_mode(&k, TL_MODE_BACKLASH);
    tl_compensator_set_strength(&k, TL_RATIO_ONE);
    TEST_ASSERT_INT32_WITHIN(300, COUNTS(650), hold(angle(&several, COUNTS(750)), 600));
}

static void test_a_table_of_several_plays_takes_over_and_gives_back(void) {
    start(&rising, TL_MODE_FULL, 0);
    (void)hold(angle(&rising, COUNTS(850)), 600);
    const tl_count_q8_t before = k.q;
    tl_compensator_set_table(&k, &several);
    TEST_ASSERT_EQUAL_INT32(before, k.q);
    TEST_ASSERT_INT32_WITHIN(16, COUNTS(1000), hold(angle(&rising, COUNTS(850)), 600)); // on the same envelope
    TEST_ASSERT_INT32_WITHIN(16, COUNTS(650), hold(angle(&rising, COUNTS(750)), 600));
    tl_compensator_set_table(&k, &rising);
    TEST_ASSERT_INT32_WITHIN(16, COUNTS(600), hold(angle(&rising, COUNTS(750)), 600));
    tl_compensator_set_table(&k, &several);
    TEST_ASSERT_INT32_WITHIN(16, COUNTS(550), hold(angle(&rising, COUNTS(700)), 600));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_each_side_is_half_the_width_away);
    RUN_TEST(test_the_side_follows_p_where_f_falls);
    RUN_TEST(test_the_tip_is_where_it_was_sent_after_every_reversal);
    RUN_TEST(test_the_take_up_keeps_its_limits_and_does_not_overshoot);
    RUN_TEST(test_turning_back_half_way_brakes_first);
    RUN_TEST(test_jitter_within_the_band_never_crosses);
    RUN_TEST(test_nothing_that_is_switched_makes_the_axis_jump);
    RUN_TEST(test_a_new_table_s_limits_are_kept_after_braking);
    RUN_TEST(test_changing_the_law_is_no_reversal);
    RUN_TEST(test_flat_spans_are_crossed_at_the_flat_speed_both_ways);
    RUN_TEST(test_switching_on_within_the_backlash_moves_nothing);
    RUN_TEST(test_switching_on_far_from_the_command_travels_within_limits);
    RUN_TEST(test_commands_beyond_the_table_saturate_and_say_so);
    RUN_TEST(test_an_axis_outside_its_range_is_only_led_inwards);
    RUN_TEST(test_the_feed_is_held_back_by_the_speed_limit_alone);
    RUN_TEST(test_several_plays_are_undone_one_after_the_other);
    RUN_TEST(test_switched_on_in_an_inner_loop_it_knows_each_play);
    RUN_TEST(test_the_strength_shares_what_several_plays_lose);
    RUN_TEST(test_a_table_of_several_plays_takes_over_and_gives_back);
    RUN_TEST(test_extreme_settings_are_safe);
    return UNITY_END();
}
