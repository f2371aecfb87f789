#include "tautline/tl_lookup.h"

#include <string.h>

// Loading --------------------------------------------------------------------------------------------

static tl_count_q8_t node_position(const tl_table_t *table, unsigned node) {
    return table->q0 + (int32_t)((uint32_t)node << table->step_log2);
}

// step / rise as one word: mantissa * 2^(shift - 32) with shift + 32 in place of the mantissa's last 6 bits. Those
// stay in as noise when multiplying: 2^-26 of at most 2^23 is below a quarter of the last bit.
static uint32_t packed_ratio(uint32_t step, uint32_t rise) {
    const tl_scale_t scale = tl_scale_of(step, rise);
    return (scale.mantissa & ~63U) | (uint32_t)(scale.shift + 32);
}

static void derive_span(tl_lookup_t *lookup, unsigned i) {
    const tl_table_t *table = &lookup->table;
    const uint32_t step = (uint32_t)1 << table->step_log2;
    const int32_t p = node_position(table, i);
    const int32_t slope = table->width[i + 1U] - table->width[i];
    const int32_t rise = table->angle[i + 1U] - table->angle[i];
    lookup->angle.word[i] = table->angle[i] ^ lookup->turn;
    lookup->angle.word[TL_LOOKUP_SPANS + i] = (int32_t)packed_ratio(step, (uint32_t)tl_abs_sat(rise));
    lookup->low.word[i] = 2 * p + table->width[i]; // exact: TL_TABLE_VALUE_MAX bounds p -+ B/2
    lookup->low.word[TL_LOOKUP_SPANS + i] = (int32_t)packed_ratio(step, 2U * step + (uint32_t)slope);
    lookup->high.word[i] = 2 * p - table->width[i];
    lookup->high.word[TL_LOOKUP_SPANS + i] = (int32_t)packed_ratio(step, 2U * step - (uint32_t)slope);
    lookup->flat[i] = tl_table_span_is_flat(table, i);
    lookup->has_flat |= lookup->flat[i];
}

static int32_t half_down(int32_t x) {
    return x >> 1;
}
static int32_t half_up(int32_t x) {
    return (x >> 1) + (x & 1);
}

static void derive_grid(tl_lookup_t *lookup) {
    const tl_table_t *table = &lookup->table;
    const unsigned last = table->nodes - 1U;
    const int32_t first_p = table->q0, last_p = node_position(table, last);
    for (unsigned i = 0; i < last; i++) {
        derive_span(lookup, i);
    }
    for (unsigned i = last; i < TL_LOOKUP_SPANS; i++) {
        lookup->angle.word[i] = lookup->low.word[i] = lookup->high.word[i] = INT32_MAX;
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

// Functions of p -------------------------------------------------------------------------------------

// values at p in a grid that has nodes, held beyond its ends.
static inline int32_t on_grid(const tl_lookup_t *lookup, const int32_t *values, tl_count_q8_t p, uint32_t *flags) {
    const uint32_t offset = (uint32_t)p - (uint32_t)lookup->q0;
    const uint32_t extent = lookup->extent, log2 = lookup->step_log2;
    if (offset < extent) { // below q0 it wraps: at least 2^31 - 2^30
        const int32_t *node = values + (offset >> log2);
        if (log2 > 16) {
            return tl_lerp_fine(node[0], node[1], offset & ((1U << log2) - 1U), log2);
        }
        return tl_lerp(node[0], node[1], (offset << (16U - log2)) & 0xFFFFU);
    }
    if (p < lookup->q0) {
        *flags |= TL_LOOKUP_BELOW;
        return values[0];
    }
    *flags |= offset > extent ? TL_LOOKUP_ABOVE : 0;
    return values[extent >> log2];
}

tl_count_q8_t tl_lookup_width(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags) {
    return lookup->extent == 0 ? 0 : on_grid(lookup, lookup->table.width, p, flags);
}

tl_deg_q16_t tl_lookup_angle(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags) {
    return lookup->extent == 0 ? tl_lookup_coarse(lookup, p, flags) : on_grid(lookup, lookup->table.angle, p, flags);
}

bool tl_lookup_is_flat(const tl_lookup_t *lookup, tl_count_q8_t p) {
    const uint32_t offset = (uint32_t)p - (uint32_t)lookup->q0;
    return offset < lookup->extent && lookup->flat[offset >> lookup->step_log2] != 0;
}

// Inverses -------------------------------------------------------------------------------------------

// p where the function has the value x, word[0] <= x < the value at the last node. Eight compares, one reciprocal.
static inline tl_count_q8_t solve(const tl_lookup_t *lookup, const tl_inverse_t *inverse, int32_t x) {
    const int32_t *at = inverse->word;
#define HALVE(spans) at = at[spans] <= x ? at + (spans) : at
    HALVE(128);
    HALVE(64);
    HALVE(32);
    HALVE(16);
    HALVE(8);
    HALVE(4);
    HALVE(2);
    HALVE(1);
#undef HALVE
    uint32_t rise = (uint32_t)x - (uint32_t)*at;
    const uint32_t ratio = (uint32_t)at[TL_LOOKUP_SPANS];
    const uint32_t span = (uint32_t)(at - inverse->word);
    int down = 32 - (int)(ratio & 63U);
    if (down < 0) {
        rise <<= -down;
        down = 0;
    }
    return lookup->q0 + (int32_t)((span << lookup->step_log2) + (tl_mul_high(rise, ratio) >> down));
}

tl_count_q8_t tl_lookup_angle_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags) {
    if (lookup->extent == 0) {
        return tl_lookup_coarse_inverse(lookup, c, flags);
    }
    const int32_t x = c ^ lookup->turn;
    if (x < lookup->angle_first) {
        *flags |= TL_LOOKUP_BELOW;
        return lookup->q0;
    }
    if (x >= lookup->angle_last) {
        *flags |= x == lookup->angle_last ? 0 : TL_LOOKUP_ABOVE;
        return lookup->q0 + (int32_t)lookup->extent;
    }
    return solve(lookup, &lookup->angle, x);
}

tl_count_q8_t tl_lookup_p_low(const tl_lookup_t *lookup, tl_count_q8_t q, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    if (lookup->extent == 0) {
        return q;
    }
    if (q <= lookup->low_first) {
        *flags |= 2 * (int64_t)q < lookup->low.word[0] ? TL_LOOKUP_BELOW : 0;
        return tl_sub_sat(q, half_down(table->width[0]));
    }
    if (q >= lookup->low_last) {
        const unsigned last = table->nodes - 1U;
        *flags |= 2 * (int64_t)q > 2 * node_position(table, last) + table->width[last] ? TL_LOOKUP_ABOVE : 0;
        return tl_sub_sat(q, half_down(table->width[last]));
    }
    return solve(lookup, &lookup->low, 2 * q);
}

tl_count_q8_t tl_lookup_p_high(const tl_lookup_t *lookup, tl_count_q8_t q, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    if (lookup->extent == 0) {
        return q;
    }
    if (q <= lookup->high_first) {
        *flags |= 2 * (int64_t)q < lookup->high.word[0] ? TL_LOOKUP_BELOW : 0;
        return tl_add_sat(q, half_down(table->width[0]));
    }
    if (q >= lookup->high_last) {
        const unsigned last = table->nodes - 1U;
        *flags |= 2 * (int64_t)q > 2 * node_position(table, last) - table->width[last] ? TL_LOOKUP_ABOVE : 0;
        return tl_add_sat(q, half_down(table->width[last]));
    }
    return solve(lookup, &lookup->high, 2 * q);
}

tl_deg_q16_t tl_lookup_coarse(const tl_lookup_t *lookup, tl_count_q8_t q, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    if (q < table->q_min) {
        *flags |= TL_LOOKUP_BELOW;
        return table->coarse_c_min;
    }
    if (q > table->q_max) {
        *flags |= TL_LOOKUP_ABOVE;
        return table->coarse_c_max;
    }
    const int32_t change = (int32_t)tl_scale((uint32_t)q - (uint32_t)table->q_min, lookup->coarse);
    return lookup->turn != 0 ? table->coarse_c_min - change : table->coarse_c_min + change;
}

tl_count_q8_t tl_lookup_coarse_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    const int32_t x = c ^ lookup->turn;
    const int32_t first = table->coarse_c_min ^ lookup->turn, last = table->coarse_c_max ^ lookup->turn;
    if (x < first) {
        *flags |= TL_LOOKUP_BELOW;
        return table->q_min;
    }
    if (x > last) {
        *flags |= TL_LOOKUP_ABOVE;
        return table->q_max;
    }
    return table->q_min + (int32_t)tl_scale((uint32_t)x - (uint32_t)first, lookup->coarse_inverse);
}
