// The README's example of the estimator, compiled as C and as C++: a table that is refused leaves the one in use.
#ifndef DRIVE_TEST_H
#define DRIVE_TEST_H

#include <string.h>
#include <unity.h>

#include "tautline/tl_crc.h"
#include "tautline/tl_drive.h"
#include "tautline/tl_history.h"
#include "tautline/tl_motion.h"
#include "tautline/tl_onset.h"
#include "tautline/tl_play.h"
#include "tautline/tl_wire.h"

static size_t drive_table(uint8_t *blob, int32_t width_counts) {
    static tl_table_t table;
    memset(&table, 0, sizeof(table));
    table.step_log2 = 14;
    table.nodes = 161;
    table.strength_q15 = 32768;
    table.nano_units_per_count = 1000000;
    table.q0 = -80 * 16384;
    table.q_min = -5000 * TL_COUNT_ONE;
    table.q_max = 5000 * TL_COUNT_ONE;
    table.coarse_c_min = -60 * TL_DEG_ONE;
    table.coarse_c_max = 60 * TL_DEG_ONE;
    table.speed_max_q8 = 10000 * TL_COUNT_ONE;
    table.takeup_speed_q8 = 5000 * TL_COUNT_ONE;
    table.takeup_accel = 100000;
    table.flat_speed_q8 = 5000 * TL_COUNT_ONE;
    for (int i = 0; i < 161; i++) {
        table.width[i] = width_counts * TL_COUNT_ONE;
        table.angle[i] = (i - 80) * (TL_DEG_ONE * 3 / 4);
    }
    return tl_table_encode(&table, blob, TL_TABLE_SIZE_MAX);
}

// Rises to 10 deg and settles: where the motor then is.
static tl_count_q8_t drive_to_10_deg(tl_drive_t *drive) {
    tl_count_q8_t goal = 0;
    for (int32_t i = 1; i <= 20000; i++) {
        goal = tl_drive_step(drive, i < 10000 ? i * (TL_DEG_ONE / 1000) : 10 * TL_DEG_ONE);
    }
    return goal;
}

static void test_the_readme_s_example(void) {
    static uint8_t blob[TL_TABLE_SIZE_MAX];
    static tl_drive_t drive;
    memset(&drive, 0, sizeof(drive));
    TEST_ASSERT_FALSE(tl_drive_start(&drive, 5000, TL_MODE_FULL, 0, 0));
    const size_t size = drive_table(blob, 400);
    blob[300] ^= 1U;
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_CRC, tl_drive_load(&drive, blob, size, 0));
    TEST_ASSERT_TRUE(strlen(tl_table_reason_text(TL_TABLE_BAD_CRC)) > 10U);
    TEST_ASSERT_FALSE(tl_drive_start(&drive, 5000, TL_MODE_FULL, 0, 0));
    blob[300] ^= 1U;
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_drive_load(&drive, blob, size, 0));
    TEST_ASSERT_TRUE(tl_drive_start(&drive, 5000, TL_MODE_FULL, 0, 0));
    // f is 3/4 deg in 64 counts: 10 deg are 853.3 counts, and half of the width is taken up on the way.
    const tl_count_q8_t expected = (10 * 64 * 4 * TL_COUNT_ONE) / 3 + 200 * TL_COUNT_ONE;
    TEST_ASSERT_INT_WITHIN(TL_COUNT_ONE, expected, drive_to_10_deg(&drive));
    const size_t other = drive_table(blob, 800);
    blob[500] ^= 1U;
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_CRC, tl_drive_load(&drive, blob, other, 0));
    TEST_ASSERT_INT_WITHIN(TL_COUNT_ONE, expected, drive_to_10_deg(&drive)); // stays with what it had
    blob[500] ^= 1U;
    static uint8_t steep[TL_TABLE_SIZE_MAX];
    static tl_table_t table;
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_table_decode(blob, other, 0, &table));
    table.width[5] = table.width[4] + 4 * 16384;
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_WIDTH_STEEP,
                      tl_drive_load(&drive, steep, tl_table_encode(&table, steep, sizeof(steep)), 0));
    TEST_ASSERT_INT_WITHIN(TL_COUNT_ONE, expected, drive_to_10_deg(&drive)); // whatever is wrong with another
    const tl_count_q8_t before = tl_drive_step(&drive, 10 * TL_DEG_ONE);
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_drive_load(&drive, blob, other, 0));
    TEST_ASSERT_INT_WITHIN(2 * TL_COUNT_ONE, before, tl_drive_step(&drive, 10 * TL_DEG_ONE)); // no jump
    TEST_ASSERT_INT_WITHIN(TL_COUNT_ONE, expected + 200 * TL_COUNT_ONE, drive_to_10_deg(&drive));
    tl_drive_step(&drive, 90 * TL_DEG_ONE);
    TEST_ASSERT_TRUE((drive.compensator.flags & TL_COMPENSATOR_ABOVE) != 0U);
}

#endif
