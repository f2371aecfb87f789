/// The take-up of the compensator: a distance in q that shrinks to zero along a trapezoid of limited speed and
/// acceleration, changes of its goal at any moment included. Sums and compares only.
#ifndef TAUTLINE_TL_TAKEUP_H
#define TAUTLINE_TL_TAKEUP_H

#include "tautline/tl_compensator.h"

#define TL_TAKEUP_FRACTION_BITS 28 ///< of Q36 below a Q8 count

void tl_takeup_start(tl_takeup_t *takeup);

/// The limits of `table` at `rate_hz` ticks a second, from the next rest on.
void tl_takeup_set_limits(tl_takeup_t *takeup, const tl_table_t *table, uint32_t rate_hz);

/// `jump` Q8 counts more are to be taken up.
static inline void tl_takeup_add(tl_takeup_t *takeup, int32_t jump_q8) {
    const int64_t jump = (int64_t)(takeup->heading > 0 ? jump_q8 : -jump_q8) * ((int64_t)1 << TL_TAKEUP_FRACTION_BITS);
    takeup->ahead_q36 += jump;
    takeup->spare_q36 += jump;
}

/// One tick.
void tl_takeup_step(tl_takeup_t *takeup);

/// Stops dead, with `rest` Q8 counts to take up.
void tl_takeup_set(tl_takeup_t *takeup, int32_t rest_q8);

/// What is left, rounded to a Q8 count, modulo 2^32. Positive: q has yet to rise.
static inline uint32_t tl_takeup_rest(const tl_takeup_t *takeup) {
    const uint64_t rounded = (uint64_t)takeup->ahead_q36 + ((uint64_t)1 << (TL_TAKEUP_FRACTION_BITS - 1));
    const uint32_t rest = (uint32_t)(rounded >> TL_TAKEUP_FRACTION_BITS);
    return takeup->heading > 0 ? rest : 0U - rest;
}

static inline bool tl_takeup_done(const tl_takeup_t *takeup) {
    return (takeup->ahead_q36 | takeup->speed_q36) == 0;
}

#endif
