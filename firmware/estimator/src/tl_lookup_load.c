#include "tl_ratio.h"

#include "tautline/tl_lookup.h"

static tl_count_q8_t node_position(const tl_table_t *table, unsigned node) {
    return table->q0 + (int32_t)((uint32_t)node << table->step_log2);
}

static int32_t half_down(int32_t x) {
    return x >> 1;
}
static int32_t half_up(int32_t x) {
    return (x >> 1) + (x & 1);
}

static void derive_grid(tl_lookup_t *lookup) {
    tl_table_t *table = &lookup->table;
    const unsigned last = table->nodes - 1U;
    const int32_t first_p = table->q0, last_p = node_position(table, last);
    for (unsigned i = 0; i < last; i++) {
        const uint32_t rise = (uint32_t)tl_abs_sat(table->angle[i + 1U] - table->angle[i]);
        lookup->ratio[i] = (uint16_t)tl_ratio_of(rise);
        lookup->has_flat |= rise < lookup->flat_below;
    }
    for (unsigned i = table->nodes; i < TL_TABLE_NODES_MAX; i++) {
        table->angle[i] = INT32_MAX ^ lookup->turn;
    }
    lookup->extent = last << table->step_log2;
    lookup->angle_first = table->angle[0] ^ lookup->turn;
    lookup->angle_last = table->angle[last] ^ lookup->turn;
    lookup->low_first = half_down(2 * first_p + table->width[0]);
    lookup->low_last = half_up(2 * last_p + table->width[last]);
    lookup->high_first = half_down(2 * first_p - table->width[0]);
    lookup->high_last = half_up(2 * last_p - table->width[last]);
}

static tl_table_reason_t derive(tl_lookup_t *lookup) {
    const tl_table_t *table = &lookup->table;
    const uint32_t range = (uint32_t)table->q_max - (uint32_t)table->q_min;
    const uint32_t rise = (uint32_t)tl_abs_sat(table->coarse_c_max - table->coarse_c_min);
    lookup->coarse = tl_scale_of(rise, range);
    lookup->coarse_inverse = tl_scale_of(range, rise);
    lookup->turn = table->coarse_c_max < table->coarse_c_min ? -1 : 0;
    lookup->q0 = table->q0;
    lookup->step_log2 = table->step_log2;
    lookup->extent = 0;
    lookup->has_flat = 0;
    lookup->flat_below = tl_table_flat_below(table);
    if (table->nodes != 0) {
        derive_grid(lookup);
    }
    uint32_t flags = 0;
    const tl_deg_q16_t first = tl_lookup_angle(lookup, table->q_min, &flags);
    const tl_deg_q16_t last = tl_lookup_angle(lookup, table->q_max, &flags);
    lookup->c_low = first < last ? first : last;
    lookup->c_high = first < last ? last : first;
    return TL_TABLE_OK;
}

tl_table_reason_t tl_lookup_load(tl_lookup_t *lookup, const uint8_t *blob, size_t size, uint8_t axis) {
    const tl_table_reason_t reason = tl_table_decode(blob, size, axis, &lookup->table);
    return reason == TL_TABLE_OK ? derive(lookup) : reason;
}

tl_table_reason_t tl_lookup_derive(tl_lookup_t *lookup, const tl_table_t *table, uint8_t axis) {
    const tl_table_reason_t reason = tl_table_check(table, axis);
    if (reason != TL_TABLE_OK) {
        return reason;
    }
    if (&lookup->table != table) {
        lookup->table = *table;
    }
    return derive(lookup);
}
