// Tables of the largest numbers that are taken, and beyond: whatever loads can be lived through. That nothing leaves
// 32 bits there the sanitizers say.
#include "table_fixture.h"
#include "tautline/tl_compensator.h"

#include <unity.h>

#define RATE 16U // the largest steps

static tl_lookup_t lookup, identity;
static tl_compensator_t k;
static tl_table_t table;

void setUp(void) {
    table = table_fixture(1);
}
void tearDown(void) {}

// As many spans of 2^23 Q8 counts to both sides of 0, B the same everywhere, and every section at its most.
static void make(int32_t spans, int32_t width) {
    table.step_log2 = 23;
    table.nodes = (uint16_t)(2 * spans + 1);
    table.q0 = table.q_min = -spans * (1 << 23);
    table.q_max = -table.q0;
    table.speed_max_q8 = table.takeup_speed_q8 = TL_TABLE_VALUE_MAX;
    table.band = 0;
    table.takeup_accel = INT32_MAX;
    for (int32_t i = 0; i < table.nodes; i++) {
        table.width[i] = width;
        table.angle[i] = (i - spans) * TL_DEG_ONE;
    }
    table.has = TL_TABLE_HAS_sides | TL_TABLE_HAS_speed | TL_TABLE_HAS_load | TL_TABLE_HAS_adapt | TL_TABLE_HAS_anew |
                TL_TABLE_HAS_pressed;
    table.pressed = (tl_table_pressed_t){width, 2 << 16, 2 << 16}; // B is the mean: as much as without
    table.anew.rest_us = 1;
    table.sides.side = 1;
    table.sides.step_log2 = 22;
    for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
        table.sides.late[i] = table.speed.extra[i] = 1 << 24;
    }
    table.load = (tl_table_load_t){.width = 1 << 24, .offset = 1 << 24};
    table.adapt = (tl_table_adapt_t){TL_TABLE_ADAPT_OFFSET_MAX, 0, 2 * TL_RATIO_ONE};
}

// Two plays. B is as narrow as may be, so that nobody asks whether Y fits it.
static void share_by(uint32_t period_log2, int32_t rise) {
    table.plays = 2;
    table.period_log2 = (uint8_t)period_log2;
    table.narrow = table.width[0];
    table.play_width_q28[0] = 0;
    table.play_width_q28[1] = 1U << 29;
    table.play_weight_q16[0] = table.play_weight_q16[1] = 32768;
    for (int32_t i = 0; i < table.nodes; i++) {
        table.centre[i] = (i - table.nodes / 2) * rise;
    }
}

static void live(tl_count_q8_t q) {
    static const int32_t commands[] = {INT32_MAX, INT32_MIN, 0, INT32_MAX, 65536, INT32_MIN};
    tl_compensator_start(&k, &lookup, RATE, TL_MODE_FULL, q, commands[q > 0]);
    for (uint32_t tick = 0; tick < 1200U; tick++) {
        (void)tl_compensator_step(&k, commands[tick / 40U % 6U]);
        if (tick % 97U == 3U) {
            const tl_count_q8_t offset = tick % 2U == 0 ? TL_TABLE_ADAPT_OFFSET_MAX : -TL_TABLE_ADAPT_OFFSET_MAX;
            (void)tl_compensator_adapt(&k, offset, 2 * TL_RATIO_ONE, 0);
            tl_compensator_load(&k, tick % 3U == 0 ? INT32_MAX : INT32_MIN, 0);
        }
        if (tick % 211U == 5U) {
            tl_compensator_set_table(&k, tick % 2U == 0 ? &identity : &lookup);
            tl_compensator_set_mode(&k, (tl_mode_t)(tick % 3U));
            tl_compensator_set_strength(&k, TL_RATIO_ONE);
        }
        if (tick % 211U == 70U) {
            tl_compensator_set_mode(&k, TL_MODE_FULL);
        }
    }
}

// Whether it loads; it is lived through from both ends of all numbers where it does.
static bool lives(void) {
    if (tl_lookup_derive(&lookup, &table, 0) != TL_TABLE_OK) {
        return false;
    }
    tl_table_t bare = table;
    bare.nodes = 0;
    bare.q0 = bare.step_log2 = bare.plays = 0;
    bare.has = 0;
    TEST_ASSERT_EQUAL_INT(TL_TABLE_OK, tl_lookup_derive(&identity, &bare, 0));
    live(INT32_MAX);
    live(INT32_MIN);
    return true;
}

static void test_one_play_of_any_size_can_be_lived_through(void) {
    unsigned taken = 0;
    for (int32_t spans = 1; spans <= 127; spans += 31) {
        for (uint64_t width = 1U << 20; width <= 1U << 31; width *= 2U) {
            make(spans, (int32_t)(width - 1U));
            taken += lives();
        }
    }
    TEST_ASSERT_GREATER_THAN(4, taken);
}

static void test_several_plays_of_any_size_can_be_lived_through(void) {
    unsigned taken = 0;
    for (int32_t spans = 1; spans <= 127; spans += 31) {
        for (uint64_t width = 1U << 20; width <= 1U << 31; width *= 2U) {
            for (uint32_t period_log2 = 8; period_log2 <= 25; period_log2++) {
                for (int32_t rise = 1; rise <= 1 << 20; rise *= 32) {
                    make(spans, (int32_t)(width - 1U));
                    share_by(period_log2, rise);
                    taken += lives();
                }
            }
        }
    }
    TEST_ASSERT_GREATER_THAN(4, taken);
}

// Without nodes; the motor stands far beyond one end, by an offset of the table before it, and is sent to the other.
static void test_any_range_without_nodes_can_be_lived_through(void) {
    unsigned taken = 0;
    for (int32_t most = TL_TABLE_VALUE_MAX; most > 1; most /= 2) {
        make(1, 0);
        table.nodes = 0;
        table.q0 = table.step_log2 = 0;
        table.has = 0;
        table.q_min = -most;
        table.q_max = most;
        if (tl_lookup_derive(&lookup, &table, 0) != TL_TABLE_OK) {
            continue;
        }
        taken++;
        for (int side = -1; side <= 1; side += 2) {
            const tl_moved_t moved = {.offset = {.now = side * TL_TABLE_VALUE_MAX, .goal = side * TL_TABLE_VALUE_MAX}};
            tl_compensator_start_moved(&k, &lookup, RATE, TL_MODE_FULL, side > 0 ? INT32_MAX : INT32_MIN,
                                       side > 0 ? INT32_MIN : INT32_MAX, &moved);
            for (int tick = 0; tick < 200; tick++) {
                (void)tl_compensator_step(&k, side > 0 ? INT32_MIN : INT32_MAX);
            }
            TEST_ASSERT_EQUAL_INT32(side > 0 ? -most : most, k.q);
        }
    }
    TEST_ASSERT_GREATER_THAN(4, taken);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_any_range_without_nodes_can_be_lived_through);
    RUN_TEST(test_one_play_of_any_size_can_be_lived_through);
    RUN_TEST(test_several_plays_of_any_size_can_be_lived_through);
    return UNITY_END();
}
