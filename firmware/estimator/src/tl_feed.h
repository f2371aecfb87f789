/// What the compensator's feed is made of, for one play and for several.
#ifndef TAUTLINE_TL_FEED_H
#define TAUTLINE_TL_FEED_H

#include "tl_takeup.h"

#include "tautline/tl_fast.h"

// k width / 2
static TL_FAST inline int32_t half_of(const tl_compensator_t *k, uint32_t width) {
    const uint32_t strength = k->strength_q15;
    return (int32_t)((width >> 16) * strength + ((width & 0xFFFFU) * strength >> 16));
}

// q* without what is still to be taken up, before the range is minded. p -+ B/2 cannot overflow (TL_TABLE_VALUE_MAX).
static TL_FAST inline tl_count_q8_t pushed(const tl_compensator_t *k, int32_t half) {
    return k->p + (k->side > 0 ? half : (k->side < 0 ? -half : tl_clamp(k->start_offset, -half, half)));
}

static TL_FAST inline tl_count_q8_t fed(const tl_compensator_t *k, int32_t half) {
    return tl_clamp(pushed(k, half), k->low, k->high);
}

// The feed goes from `before` to `after` at once; the motor takes the difference up.
static TL_FAST inline void absorb(tl_compensator_t *k, tl_count_q8_t after, tl_count_q8_t before) {
    tl_takeup_add(&k->takeup, after - before);
}

// The direction of p, with its memory of the furthest point; 1 if the side changes.
static TL_FAST inline bool turned(tl_compensator_t *k) {
    const int32_t ahead = k->p - k->anchor; // both within the range: no overflow
    if (k->side > 0 ? ahead >= 0 : (k->side < 0 && ahead <= 0)) {
        k->anchor = k->p;
        return false;
    }
    return ahead > k->band || ahead < -k->band;
}

#endif
