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

// q* without what is still to be taken up, before the range is minded. Within 32 bits (TL_TABLE_POSITION_MAX).
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

// p* for c by f, within [q_min, q_max]. The end's flags have the look-up's values: what it said is said again.
static TL_FAST inline tl_count_q8_t on_curve(const tl_compensator_t *k, tl_deg_q16_t c, uint32_t *flags) {
    const tl_count_q8_t p = tl_lookup_angle_inverse(k->lookup, c, flags);
    if (p < k->low) {
        *flags = TL_COMPENSATOR_BELOW;
        return k->low;
    }
    if (p > k->high) {
        *flags = TL_COMPENSATOR_ABOVE;
        return k->high;
    }
    return p;
}

// On the way to the goal, where spans may be flat: never further than one span in a tick, so that none is jumped over,
// and to the edge of a flat one first.
static TL_FAST inline tl_count_q8_t approach(const tl_compensator_t *k, tl_count_q8_t goal, bool *slow) {
    const tl_lookup_t *lookup = k->lookup;
    const int32_t step = (int32_t)1 << lookup->step_log2;
    const tl_count_q8_t p = k->p, next = p + tl_clamp(goal - p, -step, step);
    if (tl_lookup_is_flat(lookup, p)) {
        *slow = true;
    } else if (tl_lookup_is_flat(lookup, next)) {
        const uint32_t into = ((uint32_t)next - (uint32_t)lookup->q0) & ((uint32_t)step - 1U);
        const tl_count_q8_t edge = next - (int32_t)into + (next > p ? 0 : step);
        if (edge != p) {
            return edge;
        }
        *slow = true;
    }
    return next;
}

// In TL_MODE_FULL.
static TL_FAST inline void seek(tl_compensator_t *k, tl_count_q8_t goal) {
    bool slow = false;
    k->goal = goal;
    k->aim = k->lookup->has_flat && goal != k->p ? approach(k, goal, &slow) : goal;
    k->slow = slow;
}

#endif
