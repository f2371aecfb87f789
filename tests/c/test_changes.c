// Whatever is changed while a compensator leads, with all that tables undo: the motor's goal never jumps, nor leaves
// the range.
#include "table_fixture.h"
#include "tautline/tl_drive.h"

#include <stdio.h>
#include <unity.h>

#define COUNTS(x) ((tl_count_q8_t)((x) * TL_COUNT_ONE))
#define RATE      1000U
#define SPEED     5 // counts a tick, of the feed and of the take-up each
#define TABLES    12
#define RIDES     300
#define TICKS     4000
// Both at once, what several plays lead by as fast as a take-up, the encoder's slope of a half at most on top, and half
// a count a tick that a table is moved by.
#define STEP_MOST (COUNTS(3 * SPEED) * 3 / 2 + COUNTS(1))

void setUp(void) {}
void tearDown(void) {}

static uint32_t seed;

static int32_t between(int32_t low, int32_t high) {
    seed = seed * 1664525U + 1013904223U;
    return low + (int32_t)((seed >> 8) % (uint32_t)(high - low + 1));
}

static void falling(int32_t values[TL_TABLE_LAST + 1U], int32_t first) {
    for (uint32_t i = 0; i <= TL_TABLE_LAST; i++) {
        values[i] = first * (int32_t)(TL_TABLE_LAST - i) / (int32_t)TL_TABLE_LAST;
    }
}

static tl_table_t any_table(void) {
    tl_table_t table;
    do {
        const int sign = between(0, 1) == 0 ? 1 : -1;
        table = between(0, 1) == 0 ? table_fixture(sign) : table_fixture_several(sign);
        table.speed_max_q8 = COUNTS(SPEED * (int32_t)RATE);
        table.takeup_speed_q8 = COUNTS(SPEED * (int32_t)RATE);
        table.takeup_accel = between(20000, 200000);
        table.band = between(0, 1) == 0 ? 0 : COUNTS(between(0, 20));
        if (between(0, 3) == 0) {
            table.q_min = COUNTS(between(-4900, 0));
            table.q_max = table.q_min + (between(0, 2) == 0 ? between(1, 1000) : COUNTS(between(1, 4900)));
        }
        table.has = (uint32_t)between(0, 255) & 0x1FCU; // sections 2 to 8
        if ((table.has & TL_TABLE_HAS_encoder) != 0) {  // 2 pi (a + 2 a2) / period is 1/2 at most
            const int32_t period = between(100, 2000), most = COUNTS(period) / 14;
            table.encoder = (tl_table_encoder_t){.period_q12 = period * 4096,
                                                 .sine = between(-most / 2, most / 2),
                                                 .cosine2 = between(-most / 6, most / 6)};
        }
        if ((table.has & TL_TABLE_HAS_sides) != 0) {
            table.sides = (tl_table_sides_t){.side = between(0, 1) == 0 ? 1 : -1, .step_log2 = 10};
            falling(table.sides.late, COUNTS(between(1, 40)));
        }
        if ((table.has & TL_TABLE_HAS_speed) != 0) {
            table.speed = (tl_table_speed_t){.step_log2 = 14, .time_us = between(20000, 80000), .held = between(0, 1)};
            for (uint32_t i = 0; i <= TL_TABLE_LAST; i++) {
                table.speed.extra[i] = COUNTS((int32_t)i);
            }
        }
        if ((table.has & TL_TABLE_HAS_late) != 0) {
            table.late = (tl_table_late_t){.gain_q16 = {between(0, 65536)}, .time_us = {between(20000, 400000)}};
        }
        if ((table.has & TL_TABLE_HAS_load) != 0) {
            table.load = (tl_table_load_t){.width = between(0, 1 << 16), .offset = between(0, 1 << 16)};
        }
        table.has &= ~(uint32_t)TL_TABLE_HAS_joints;
        if ((table.has & TL_TABLE_HAS_adapt) != 0) {
            table.adapt = (tl_table_adapt_t){
                .offset = COUNTS(200), .width_least_q15 = TL_RATIO_ONE / 2, .width_most_q15 = TL_RATIO_ONE * 3 / 2};
        }
    } while (tl_table_check(&table, 0) != TL_TABLE_OK);
    return table;
}

static tl_drive_t drive;

// How far beyond the range of the table in use, which the motor may be where that table is new.
static int32_t outside(tl_count_q8_t q) {
    const tl_table_t *table = &drive.tables[drive.used].table;
    return q < table->q_min ? table->q_min - q : (q > table->q_max ? q - table->q_max : 0);
}

static uint8_t blobs[TABLES][TL_TABLE_SIZE_MAX];
static size_t sizes[TABLES];

static void change(void) {
    tl_compensator_t *k = &drive.compensator;
    const int which = between(0, TABLES - 1);
    switch (between(0, 4)) {
    case 0:
        tl_compensator_set_mode(k, (tl_mode_t)between(0, 2));
        break;
    case 1:
        tl_compensator_set_strength(k, between(0, TL_RATIO_ONE));
        break;
    case 2:
        tl_compensator_adapt(k, COUNTS(between(-200, 200)), between(TL_RATIO_ONE / 2, TL_RATIO_ONE),
                             (uint32_t)between(1, 500));
        break;
    case 3:
        tl_compensator_load(k, between(-2000, 2000), (uint32_t)between(1, 500));
        break;
    default:
        TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_drive_load(&drive, blobs[which], sizes[which], 0));
        break;
    }
}

static void test_nothing_that_is_changed_makes_the_goal_jump_or_leave_the_range(void) {
    for (uint32_t ride = 1; ride <= RIDES; ride++) {
        seed = ride;
        for (int i = 0; i < TABLES; i++) {
            const tl_table_t table = any_table();
            sizes[i] = tl_table_encode(&table, blobs[i], sizeof(blobs[i]));
        }
        drive = (tl_drive_t){.loaded = false};
        TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_drive_load(&drive, blobs[0], sizes[0], 0));
        tl_count_q8_t q = 0;
        tl_deg_q16_t c = 0;
        int32_t way = 0;
        TEST_ASSERT_TRUE(tl_drive_start(&drive, RATE, TL_MODE_FULL, q, c));
        for (int tick = 0; tick < TICKS; tick++) {
            if (between(0, 150) == 0) {
                change();
            }
            if (between(0, 200) == 0) {
                way = between(-3000, 3000); // 0.05 deg a tick: four counts
            }
            c += c > 40 * TL_DEG_ONE ? -TL_DEG_ONE / 50 : (c < -40 * TL_DEG_ONE ? TL_DEG_ONE / 50 : way);
            const tl_count_q8_t next = tl_drive_step(&drive, c);
            const int32_t step = next > q ? next - q : q - next;
            char text[80];
            (void)snprintf(text, sizeof(text), "%d/256 counts in ride %u, tick %d", (int)step, (unsigned)ride, tick);
            TEST_ASSERT_TRUE_MESSAGE(step <= STEP_MOST, text);
            TEST_ASSERT_TRUE_MESSAGE(outside(next) <= outside(q), text);
            q = next;
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_nothing_that_is_changed_makes_the_goal_jump_or_leave_the_range);
    return UNITY_END();
}
