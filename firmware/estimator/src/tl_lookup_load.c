#include "tl_ratio.h"

#include "tautline/tl_lookup.h"

#define END_CENTRE    ((uint64_t)1 << 29) // how far Y goes on beyond the grid, and p
#define END_COUNTS    ((uint64_t)1 << 29)
#define WARP_OFF_LOG2 4 // of a period: by so much the warp of a table may be wrong
// Q8 counts: twice the widest B. So far from p its elements may meet an envelope, wherever they are within a period
// to either side of it (they are within half of one, but for what is rounded).
#define REACH_MAX (2 * (TL_TABLE_WIDTH_MAX + 1))

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

static uint64_t smaller(uint64_t a, uint64_t b) {
    return a < b ? a : b;
}

static int32_t width_at_least(const tl_table_t *table, unsigned node) {
    const int32_t width = table->width[node] > table->narrow ? table->width[node] : table->narrow;
    return width > 0 ? width : 1;
}

static void derive_end(tl_lookup_end_t *end, uint32_t width, unsigned period_log2) {
    const uint32_t period = 1U << period_log2;
    end->per_count = tl_scale_of(period, width);
    end->per_period = tl_scale_of(width, period);
    end->counts = (uint32_t)smaller(END_COUNTS, END_CENTRE * width >> period_log2);
    end->centre = (uint32_t)smaller(END_CENTRE, (END_COUNTS << period_log2) / width);
}

// What the elements' shares come to in Y's unit, and the plays on Y that undo them.
static void derive_elements(tl_lookup_t *lookup) {
    const tl_table_t *table = &lookup->table;
    const unsigned to_unit = 29U - table->period_log2; // from half a share of the width, Q28
    uint32_t weight = 0, inverse_q27 = 0;
    int64_t moment_q16 = 0;
    for (unsigned i = 0; i < table->plays; i++) {
        tl_element_t *element = &lookup->element[i];
        element->half = (int32_t)((table->play_width_q28[i] + (1ULL << (to_unit - 1U))) >> to_unit);
        element->weight_q16 = (uint16_t)table->play_weight_q16[i]; // two or more sum up to 1
        weight += element->weight_q16;
        moment_q16 += (int64_t)element->weight_q16 * element->half;
        element->lag_most = (int32_t)(((int64_t)weight * element->half - moment_q16) >> 16);
        const uint32_t before_q27 = inverse_q27;
        inverse_q27 = (uint32_t)(((uint64_t)1 << 43) / weight);
        // v, below 20, with 16 bits from its highest on
        const uint32_t undo = i == 0 ? 0 : before_q27 - inverse_q27;
        const uint32_t bits = tl_bits(undo);
        element->undo_log2 = bits > 27U ? bits - 27U : 0;
        const unsigned drop = 11U + element->undo_log2;
        const uint32_t rounded = (uint32_t)(((uint64_t)undo + (1ULL << (drop - 1U))) >> drop);
        element->undo = (uint16_t)(rounded > 0xFFFFU ? 0xFFFFU : rounded);
    }
}

// Whether p_lo and p_hi are a period apart, for the motor at each node where both are on the grid.
static bool warps(const tl_lookup_t *lookup) {
    const tl_table_t *table = &lookup->table;
    for (unsigned i = 0; i < table->nodes; i++) {
        uint32_t flags = 0;
        const tl_count_q8_t q = node_position(table, i);
        const tl_count_q8_t low = tl_lookup_p_low(lookup, q, q, &flags), high = tl_lookup_p_high(lookup, q, q, &flags);
        const bool narrow = tl_lookup_width(lookup, low, &flags) <= table->narrow ||
                            tl_lookup_width(lookup, high, &flags) <= table->narrow;
        if (narrow || flags != 0) {
            continue;
        }
        const int32_t apart = tl_lookup_centre(lookup, high) - tl_lookup_centre(lookup, low);
        const int32_t off = tl_abs_sat(apart - 2 * lookup->half);
        if (off > 2 * lookup->half >> WARP_OFF_LOG2) {
            return false;
        }
    }
    return true;
}

// Whether the elements reach no further than REACH_MAX from any node, and so from no place by more than a step.
static bool reaches(const tl_lookup_t *lookup) {
    for (unsigned i = 0; i < lookup->table.nodes; i++) {
        const int32_t y = lookup->table.centre[i], away = 3 * lookup->half;
        const tl_count_q8_t p = node_position(&lookup->table, i);
        if (p - tl_lookup_centre_inverse(lookup, y - away) > REACH_MAX ||
            tl_lookup_centre_inverse(lookup, y + away) - p > REACH_MAX) {
            return false;
        }
    }
    return true;
}

static bool derive_plays(tl_lookup_t *lookup) {
    tl_table_t *table = &lookup->table;
    const unsigned last = table->nodes - 1U;
    lookup->plays = table->plays;
    lookup->narrow = table->narrow;
    lookup->half = (int32_t)1 << (table->period_log2 - 1U);
    derive_elements(lookup);
    for (unsigned i = 0; i < last; i++) {
        lookup->centre_ratio[i] = (uint16_t)tl_ratio_of((uint32_t)(table->centre[i + 1U] - table->centre[i]));
    }
    for (unsigned i = table->nodes; i < TL_TABLE_NODES_MAX; i++) {
        table->centre[i] = INT32_MAX;
    }
    derive_end(&lookup->end[0], (uint32_t)width_at_least(table, 0), table->period_log2);
    derive_end(&lookup->end[1], (uint32_t)width_at_least(table, last), table->period_log2);
    return reaches(lookup) && warps(lookup);
}

// w of section 10 is 1.5 * 2^follows_log2 at most. As late(d) falls by d at most, what tl_undo.c iterates comes to
// rest.
static void derive_pressed(tl_lookup_t *lookup) {
    const tl_table_pressed_t *pressed = &lookup->table.pressed;
    lookup->per_mean_q14 = tl_scale_of(1U << 14, (uint32_t)pressed->mean);
    int64_t most = 0;
    for (unsigned i = 0; i < lookup->table.nodes; i++) {
        const int64_t beyond = lookup->table.width[i] - pressed->mean; // w - 1 is share * beyond / mean
        most = beyond > most ? beyond : most;
    }
    const int64_t w_q17 = ((int64_t)2 << 16) * pressed->mean + 2 * pressed->sides_q16 * most;
    lookup->follows_log2 = 0;
    while (w_q17 > ((int64_t)3 << 16 << lookup->follows_log2) * pressed->mean) {
        lookup->follows_log2++;
    }
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
    lookup->plays = 0;
    lookup->narrow = 0;
    lookup->half = 0;
    if ((table->has & (uint32_t)TL_TABLE_HAS_encoder) != 0) {
        const uint64_t phase_q48 = ((uint64_t)1 << 52) / (uint32_t)table->encoder.period_q12;
        lookup->phase = (uint32_t)(phase_q48 >> 16);
        lookup->phase_rest = (uint32_t)phase_q48 & 0xFFFFU;
    }
    if ((table->has & (uint32_t)TL_TABLE_HAS_pressed) != 0) {
        derive_pressed(lookup);
    }
    if (table->nodes != 0) {
        derive_grid(lookup);
    }
    if (table->plays != 0 && !derive_plays(lookup)) {
        return TL_TABLE_BAD_WARP;
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
