#include "tautline/tl_lookup.h"

#include "tautline/tl_fast.h"

#include "tl_ratio.h"

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

TL_FAST tl_count_q8_t tl_lookup_width(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags) {
    return lookup->extent == 0 ? 0 : on_grid(lookup, lookup->table.width, p, flags);
}

TL_FAST tl_deg_q16_t tl_lookup_angle(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags) {
    return lookup->extent == 0 ? tl_lookup_coarse(lookup, p, flags) : on_grid(lookup, lookup->table.angle, p, flags);
}

// Inverses -------------------------------------------------------------------------------------------

static inline tl_count_q8_t within_span(const tl_lookup_t *lookup, uint32_t span, uint32_t fraction_q31) {
    const uint32_t log2 = lookup->step_log2;
    return lookup->q0 + (int32_t)((span << log2) + ((fraction_q31 + (1U << (30U - log2))) >> (31U - log2)));
}

TL_FAST tl_count_q8_t tl_lookup_angle_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags) {
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
    const int32_t turn = lookup->turn;
    const tl_deg_q16_t *node = lookup->table.angle;
#define HALVE(spans) node = (node[spans] ^ turn) <= x ? node + (spans) : node
    HALVE(128);
    HALVE(64);
    HALVE(32);
    HALVE(16);
    HALVE(8);
    HALVE(4);
    HALVE(2);
    HALVE(1);
#undef HALVE
    const uint32_t span = (uint32_t)(node - lookup->table.angle);
    const uint32_t start = (uint32_t)(node[0] ^ turn), rise = (uint32_t)(node[1] ^ turn) - start;
    return within_span(lookup, span, tl_fraction((uint32_t)x - start, rise, lookup->ratio[span]));
}

// p with 2p + B(p) = 2q, or 2p - B(p) = 2q where `sign` is -1 instead of 0; `first` and `last`: where q meets the ends
// of that envelope. One piece of code for both: 0.7 kB less of a controller's memory for 50 cycles.
static TL_FAST tl_count_q8_t on_envelope(const tl_lookup_t *lookup, tl_count_q8_t q, tl_count_q8_t near, int32_t sign,
                                         uint32_t *flags) {
    const tl_count_q8_t *width = lookup->table.width;
    if (lookup->extent == 0) {
        return q;
    }
    const bool below = q <= (sign == 0 ? lookup->low_first : lookup->high_first);
    const uint32_t last = lookup->table.nodes - 1U;
    if (below || q >= (sign == 0 ? lookup->low_last : lookup->high_last)) {
        const tl_count_q8_t end = below ? lookup->q0 : lookup->q0 + (int32_t)lookup->extent;
        const int32_t held = width[below ? 0U : last] ^ sign; // one less than -B for p_hi
        const int64_t beyond = 2 * ((int64_t)q - end) - held + sign;
        *flags |= beyond < 0 && below ? TL_LOOKUP_BELOW : (beyond > 0 && !below ? TL_LOOKUP_ABOVE : 0U);
        return sign == 0 ? tl_sub_sat(q, held >> 1) : tl_add_sat(q, ~held >> 1);
    }
    const uint32_t log2 = lookup->step_log2 + 1U;
    // The envelope from its first node on: 32 bits without a sign.
#define RISE(node) (((node) << log2) + (uint32_t)(width[node] ^ sign) - first)
    const uint32_t first = (uint32_t)(width[0] ^ sign);
    const uint32_t x = 2U * ((uint32_t)q - (uint32_t)lookup->q0) - first + (uint32_t)sign;
    uint32_t span = ((uint32_t)near - (uint32_t)lookup->q0) >> lookup->step_log2;
    if (span >= last || x < RISE(span) || x >= RISE(span + 1U)) { // not there: among all
        span = 0;
        // No branches, which a desktop core would guess wrong; the last node is above x.
        uint32_t next;
#define HALVE(spans)                                                                                                   \
    next = span + (spans) < last ? span + (spans) : last;                                                              \
    span = RISE(next) <= x ? next : span;
        HALVE(128U)
        HALVE(64U)
        HALVE(32U)
        HALVE(16U)
        HALVE(8U)
        HALVE(4U)
        HALVE(2U)
        HALVE(1U)
#undef HALVE
    }
    const uint32_t start = RISE(span), rise = RISE(span + 1U) - start;
#undef RISE
    return within_span(lookup, span, tl_fraction(x - start, rise, tl_ratio_of(rise)));
}

TL_FAST tl_count_q8_t tl_lookup_p_low(const tl_lookup_t *lookup, tl_count_q8_t q, tl_count_q8_t near, uint32_t *flags) {
    return on_envelope(lookup, q, near, 0, flags);
}

TL_FAST tl_count_q8_t tl_lookup_p_high(const tl_lookup_t *lookup, tl_count_q8_t q, tl_count_q8_t near,
                                       uint32_t *flags) {
    return on_envelope(lookup, q, near, -1, flags);
}

// The warp of several plays -----------------------------------------------------------------------------

TL_FAST int32_t tl_lookup_centre(const tl_lookup_t *lookup, tl_count_q8_t p) {
    uint32_t beyond = 0;
    const int32_t y = on_grid(lookup, lookup->table.centre, p, &beyond);
    if (beyond == 0) {
        return y;
    }
    const bool below = beyond == TL_LOOKUP_BELOW;
    const tl_lookup_end_t *end = &lookup->end[below ? 0 : 1];
    const uint32_t offset = (uint32_t)p - (uint32_t)lookup->q0, away = below ? 0U - offset : offset - lookup->extent;
    const int32_t change = (int32_t)tl_scale(away < end->counts ? away : end->counts, end->per_count);
    return below ? y - change : y + change;
}

TL_FAST tl_count_q8_t tl_lookup_centre_inverse(const tl_lookup_t *lookup, int32_t y) {
    const int32_t *node = lookup->table.centre;
    const int32_t first = node[0], last = node[lookup->extent >> lookup->step_log2];
    if (y < first || y >= last) {
        const bool below = y < first;
        const tl_lookup_end_t *end = &lookup->end[below ? 0 : 1];
        const uint32_t away = below ? (uint32_t)first - (uint32_t)y : (uint32_t)y - (uint32_t)last;
        const int32_t change = (int32_t)tl_scale(away < end->centre ? away : end->centre, end->per_period);
        return below ? lookup->q0 - change : lookup->q0 + (int32_t)lookup->extent + change;
    }
#define HALVE(spans) node = node[spans] <= y ? node + (spans) : node
    HALVE(128);
    HALVE(64);
    HALVE(32);
    HALVE(16);
    HALVE(8);
    HALVE(4);
    HALVE(2);
    HALVE(1);
#undef HALVE
    const uint32_t span = (uint32_t)(node - lookup->table.centre);
    const uint32_t start = (uint32_t)node[0], rise = (uint32_t)node[1] - start;
    return within_span(lookup, span, tl_fraction((uint32_t)y - start, rise, lookup->centre_ratio[span]));
}

TL_FAST tl_deg_q16_t tl_lookup_coarse(const tl_lookup_t *lookup, tl_count_q8_t q, uint32_t *flags) {
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

TL_FAST tl_count_q8_t tl_lookup_coarse_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags) {
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
