#include "tautline/tl_lookup.h"

#include <string.h>

static tl_count_q8_t node_position(const tl_table_t *table, unsigned node) {
    return table->q0 + (int32_t)((uint32_t)node << table->step_log2);
}

// Largest span whose first node's value is at most x, of a sequence that rises with the node: 8 steps at most.
#define FIND_SPAN(span, nodes, value_at, x)                                                                  \
    do {                                                                                                     \
        (span) = 0;                                                                                          \
        for (unsigned bit = 128; bit != 0; bit >>= 1) {                                                      \
            const unsigned at = (span) + bit;                                                                \
            if (at < (nodes) - 1U && value_at(at) <= (x)) {                                                  \
                (span) = at;                                                                                 \
            }                                                                                                \
        }                                                                                                    \
    } while (0)

static void derive_span(tl_lookup_t *lookup, unsigned i) {
    const tl_table_t *table = &lookup->table;
    const uint32_t step = (uint32_t)1 << table->step_log2;
    const int32_t slope = table->width[i + 1U] - table->width[i];
    const int32_t rise = table->angle[i + 1U] - table->angle[i];
    const tl_scale_t angle = tl_scale_of(step, (uint32_t)tl_abs_sat(rise));
    const tl_scale_t low = tl_scale_of(step, 2U * step + (uint32_t)slope);
    const tl_scale_t high = tl_scale_of(step, 2U * step - (uint32_t)slope);
    lookup->angle_mantissa[i] = angle.mantissa;
    lookup->angle_shift[i] = angle.shift;
    lookup->low_mantissa[i] = low.mantissa;
    lookup->low_shift[i] = low.shift;
    lookup->high_mantissa[i] = high.mantissa;
    lookup->high_shift[i] = high.shift;
    if (tl_table_span_is_flat(table, i)) {
        lookup->has_flat = true;
        lookup->flat[i >> 3] = (uint8_t)(lookup->flat[i >> 3] | 1U << (i & 7U));
    }
}

static tl_table_reason_t derive(tl_lookup_t *lookup) {
    const tl_table_t *table = &lookup->table;
    const uint32_t range = (uint32_t)table->q_max - (uint32_t)table->q_min;
    const uint32_t coarse_rise = (uint32_t)tl_abs_sat(table->coarse_c_max - table->coarse_c_min);
    lookup->falling = table->coarse_c_max < table->coarse_c_min;
    lookup->coarse = tl_scale_of(coarse_rise, range);
    lookup->coarse_inv = tl_scale_of(range, coarse_rise);
    lookup->has_flat = false;
    memset(lookup->flat, 0, sizeof lookup->flat);
    for (unsigned i = 0; i + 1U < table->nodes; i++) {
        derive_span(lookup, i);
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

// Where p lies in the grid: span and rest in it, Q8 counts. False beyond the ends, *span then the nearest node.
static bool locate(const tl_table_t *table, tl_count_q8_t p, unsigned *span, uint32_t *rest, uint32_t *flags) {
    const unsigned last = table->nodes - 1U;
    if (p < table->q0) {
        *flags |= TL_LOOKUP_BELOW;
        *span = 0;
        return false;
    }
    const uint32_t offset = (uint32_t)p - (uint32_t)table->q0;
    const uint32_t index = offset >> table->step_log2;
    if (index >= last) {
        if (offset != last << table->step_log2) {
            *flags |= TL_LOOKUP_ABOVE;
        }
        *span = last;
        return false;
    }
    *span = index;
    *rest = offset - (index << table->step_log2);
    return true;
}

// a + (b - a) rest / 2^log2, rounded to nearest: tl_lerp(), with a third product where a step has more than 16 bits.
static int32_t between(int32_t a, int32_t b, uint32_t rest, unsigned log2) {
    if (log2 <= 16) {
        return tl_lerp(a, b, rest << (16U - log2));
    }
    const unsigned extra = log2 - 16U; // at most 7
    const int32_t difference = b - a;
    const uint32_t t = rest >> extra;
    const int32_t fine = (int32_t)(rest & ((1U << extra) - 1U));
    const uint64_t fine_part = (uint64_t)(int64_t)((difference >> 8) * fine) << (8U - extra);
    const uint64_t low = ((uint32_t)difference & 0xFFFFU) * t + fine_part + 0x8000U;
    return a + (difference >> 16) * (int32_t)t + (int32_t)((int64_t)low >> 16);
}

tl_count_q8_t tl_lookup_width(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    unsigned span;
    uint32_t rest;
    if (table->nodes == 0) {
        return 0;
    }
    if (!locate(table, p, &span, &rest, flags)) {
        return table->width[span];
    }
    return between(table->width[span], table->width[span + 1U], rest, table->step_log2);
}

tl_deg_q16_t tl_lookup_angle(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    unsigned span;
    uint32_t rest;
    if (table->nodes == 0) {
        return tl_lookup_coarse(lookup, p, flags);
    }
    if (!locate(table, p, &span, &rest, flags)) {
        return table->angle[span];
    }
    return between(table->angle[span], table->angle[span + 1U], rest, table->step_log2);
}

// Node `span` plus x times the kept reciprocal, within the span.
static tl_count_q8_t in_span(const tl_table_t *table, unsigned span, uint32_t x, uint32_t mantissa, int8_t shift) {
    const tl_scale_t ratio = {mantissa, shift};
    return node_position(table, span) + (int32_t)tl_scale(x, ratio);
}

tl_count_q8_t tl_lookup_angle_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    if (table->nodes == 0) {
        return tl_lookup_coarse_inverse(lookup, c, flags);
    }
    const unsigned last = table->nodes - 1U;
    const int32_t turn = lookup->falling ? -1 : 0; // x ^ -1 reverses the order without overflow
    const int32_t x = c ^ turn;
    if (x <= (table->angle[0] ^ turn)) {
        *flags |= c == table->angle[0] ? 0 : TL_LOOKUP_BELOW;
        return table->q0;
    }
    if (x >= (table->angle[last] ^ turn)) {
        *flags |= c == table->angle[last] ? 0 : TL_LOOKUP_ABOVE;
        return node_position(table, last);
    }
    unsigned span;
#define ANGLE_AT(i) (table->angle[i] ^ turn)
    FIND_SPAN(span, table->nodes, ANGLE_AT, x);
#undef ANGLE_AT
    return in_span(table, span, (uint32_t)(x - (table->angle[span] ^ turn)), lookup->angle_mantissa[span],
                   lookup->angle_shift[span]);
}

// 2p + B and 2p - B at the nodes are exact in 32 bits: TL_TABLE_VALUE_MAX bounds p -+ B/2.
#define LOW_AT(i)  (2 * node_position(table, i) + table->width[i])
#define HIGH_AT(i) (2 * node_position(table, i) - table->width[i])

static int32_t half(int32_t x) { return x >> 1; }

tl_count_q8_t tl_lookup_p_low(const tl_lookup_t *lookup, tl_count_q8_t q, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    if (table->nodes == 0) {
        return q;
    }
    const unsigned last = table->nodes - 1U;
    const int32_t x = 2 * tl_clamp(q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    if (x <= LOW_AT(0)) {
        *flags |= x == LOW_AT(0) ? 0 : TL_LOOKUP_BELOW;
        return tl_sub_sat(q, half(table->width[0]));
    }
    if (x >= LOW_AT(last)) {
        *flags |= x == LOW_AT(last) ? 0 : TL_LOOKUP_ABOVE;
        return tl_sub_sat(q, half(table->width[last]));
    }
    unsigned span;
    FIND_SPAN(span, table->nodes, LOW_AT, x);
    return in_span(table, span, (uint32_t)x - (uint32_t)LOW_AT(span), lookup->low_mantissa[span],
                   lookup->low_shift[span]);
}

tl_count_q8_t tl_lookup_p_high(const tl_lookup_t *lookup, tl_count_q8_t q, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    if (table->nodes == 0) {
        return q;
    }
    const unsigned last = table->nodes - 1U;
    const int32_t x = 2 * tl_clamp(q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    if (x <= HIGH_AT(0)) {
        *flags |= x == HIGH_AT(0) ? 0 : TL_LOOKUP_BELOW;
        return tl_add_sat(q, half(table->width[0]));
    }
    if (x >= HIGH_AT(last)) {
        *flags |= x == HIGH_AT(last) ? 0 : TL_LOOKUP_ABOVE;
        return tl_add_sat(q, half(table->width[last]));
    }
    unsigned span;
    FIND_SPAN(span, table->nodes, HIGH_AT, x);
    return in_span(table, span, (uint32_t)x - (uint32_t)HIGH_AT(span), lookup->high_mantissa[span],
                   lookup->high_shift[span]);
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
    return lookup->falling ? table->coarse_c_min - change : table->coarse_c_min + change;
}

tl_count_q8_t tl_lookup_coarse_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags) {
    const tl_table_t *table = &lookup->table;
    const int32_t turn = lookup->falling ? -1 : 0;
    const int32_t x = c ^ turn, first = table->coarse_c_min ^ turn, last = table->coarse_c_max ^ turn;
    if (x < first) {
        *flags |= TL_LOOKUP_BELOW;
        return table->q_min;
    }
    if (x > last) {
        *flags |= TL_LOOKUP_ABOVE;
        return table->q_max;
    }
    return table->q_min + (int32_t)tl_scale((uint32_t)x - (uint32_t)first, lookup->coarse_inv);
}

bool tl_lookup_is_flat(const tl_lookup_t *lookup, tl_count_q8_t p) {
    const tl_table_t *table = &lookup->table;
    unsigned span;
    uint32_t rest, flags = 0;
    if (table->nodes == 0 || !locate(table, p, &span, &rest, &flags)) {
        return false;
    }
    return (lookup->flat[span >> 3] >> (span & 7U) & 1U) != 0;
}
