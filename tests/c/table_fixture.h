// A valid table that tests start from: 1 um per count, +-5 mm, B = 300 counts, f = 12 deg/mm.
#ifndef TABLE_FIXTURE_H
#define TABLE_FIXTURE_H

#include "tautline/tl_lookup.h"

#include <string.h>

static inline tl_table_t table_fixture(int sign) {
    tl_table_t table;
    memset(&table, 0, sizeof table);
    table.step_log2 = 14;
    table.nodes = 158;
    table.strength_q15 = TL_RATIO_ONE;
    table.nano_units_per_count = 1000000;
    table.q0 = -5000 * TL_COUNT_ONE;
    table.q_min = -5000 * TL_COUNT_ONE;
    table.q_max = 5000 * TL_COUNT_ONE;
    table.coarse_c_min = -60 * TL_DEG_ONE * sign;
    table.coarse_c_max = 60 * TL_DEG_ONE * sign;
    table.speed_max_q8 = 20000 * TL_COUNT_ONE;
    table.takeup_speed_q8 = 10000 * TL_COUNT_ONE;
    table.takeup_accel = 100000;
    table.band = 2 * TL_COUNT_ONE;
    table.slope_min_q28 = 0;
    table.flat_speed_q8 = 0;
    table.delay_us = 80000;
    for (unsigned i = 0; i < table.nodes; i++) {
        table.width[i] = 300 * TL_COUNT_ONE;
        // 64 counts a span at 0.012 deg a count are 50331.6 of the last bit of c
        table.angle[i] = sign * (-60 * TL_DEG_ONE + (int32_t)i * 50332);
    }
    return table;
}

// The same with two plays, of half and of one and a half of B, which share the motion evenly.
static inline tl_table_t table_fixture_several(int sign) {
    tl_table_t table = table_fixture(sign);
    table.plays = 2;
    table.period_log2 = 20;
    table.play_width_q28[0] = 1U << 27;
    table.play_width_q28[1] = 3U << 27;
    table.play_weight_q16[0] = table.play_weight_q16[1] = 32768;
    for (unsigned i = 0; i < table.nodes; i++) { // 64 of 300 counts a span
        table.centre[i] = (int32_t)((int64_t)((int32_t)i - 78) * 64 * (1 << 20) / 300);
    }
    return table;
}

#endif
