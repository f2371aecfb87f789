/// Several plays that share B, in the coordinate that makes every width a period (tl_table.h, section 1). Everything
/// here is in Y's unit, and relative: to where the motor is, x, or the tip, y. Sums, compares and two products each.
///
/// Forward: the i-th play lags behind x by at most its half width r_i, and y = x - sum w_i lag_i. Inverse: with the
/// first play split off, s, plays on y that lag by at most rho_j give s = y + sum (-v_j) lag_j, and x = s +- r_1. Kept
/// as lags both are sums of small numbers, and nothing drifts.
#ifndef TAUTLINE_TL_ELEMENTS_H
#define TAUTLINE_TL_ELEMENTS_H

#include "tautline/tl_fast.h"
#include "tautline/tl_lookup.h"

/// The lags behind x of plays that are as near to one place as they can be, y being `apart` below x. One division.
void tl_elements_start(const tl_lookup_t *lookup, int32_t apart, int32_t lag[]);

/// x has moved by `moved`: how far y is behind it then. At most 260 cycles on a Cortex-M0+.
int32_t tl_elements_behind(const tl_lookup_t *lookup, int32_t moved, int32_t lag[]);

/// The lags behind y of the plays that undo those of the given lags behind x. `undo` may be `lag`.
void tl_elements_undo(const tl_lookup_t *lookup, const int32_t lag[], int32_t undo[]);

/// y has moved by `moved`: how far s is ahead of it then. At most 250 cycles.
int32_t tl_elements_ahead(const tl_lookup_t *lookup, int32_t moved, int32_t undo[]);

/// Whether p lies in a place that is narrow: a span with both ends narrow, where one play stands for all.
static TL_FAST inline bool tl_elements_narrow(const tl_lookup_t *lookup, tl_count_q8_t p) {
    const uint32_t last = (lookup->extent >> lookup->step_log2) - 1U, offset = (uint32_t)p - (uint32_t)lookup->q0;
    const uint32_t at = offset >> lookup->step_log2, span = p < lookup->q0 ? 0U : (at < last ? at : last);
    const tl_count_q8_t *width = lookup->table.width + span;
    return width[0] < lookup->narrow && width[1] < lookup->narrow;
}

/// x for the motor at q, from the envelope on `side` (+1: p_lo) whose p is `p`.
static TL_FAST inline int32_t tl_elements_motor(const tl_lookup_t *lookup, int32_t side, tl_count_q8_t p) {
    return tl_lookup_centre(lookup, p) + (side > 0 ? lookup->half : -lookup->half);
}

#endif
