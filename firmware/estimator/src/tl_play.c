#include "tautline/tl_play.h"

#include "tautline/tl_fast.h"
#include "tl_elements.h"

// Where p has just been solved for, 2 |q - p| is B(p) but for p's error times (2 + |B'|) < 4: 1.5 of the last bit and
// 2^-19 of a span (tl_fraction()). It is kept smaller than B(p) by that, so that comparing with it may ask for a
// solution in vain but never misses one.
static TL_FAST uint32_t width_at(const tl_lookup_t *lookup, uint32_t twice_apart) {
    const uint32_t error = 6U + ((4U << lookup->step_log2) >> 19);
    return twice_apart > error ? twice_apart - error : 0;
}

void tl_play_start(tl_play_t *play, const tl_lookup_t *lookup, tl_count_q8_t p) {
    play->lookup = lookup;
    play->p = tl_clamp(p, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    play->flags = 0;
    play->width = width_at(lookup, (uint32_t)tl_lookup_width(lookup, play->p, &play->flags));
    if (lookup->plays != 0) { // the motor at the middle of its backlash
        play->q = play->single = play->p;
        const int32_t y = tl_lookup_centre(lookup, play->p);
        play->motor = tl_elements_motor(lookup, 1, tl_lookup_p_low(lookup, play->q, play->p, &play->flags));
        tl_elements_start(lookup, tl_sub_sat(play->motor, y), play->lag);
    }
}

// The elements that the motor drags follow the envelope towards which it moves; the others stay.
TL_FAST static tl_count_q8_t step_of_several(tl_play_t *play, tl_count_q8_t q) {
    const tl_lookup_t *lookup = play->lookup;
    if (q == play->q) {
        return play->p;
    }
    const bool up = q > play->q;
    uint32_t flags = 0;
    const tl_count_q8_t edge =
        up ? tl_lookup_p_low(lookup, q, play->single, &flags) : tl_lookup_p_high(lookup, q, play->single, &flags);
    const int32_t motor = tl_elements_motor(lookup, up ? 1 : -1, edge);
    const int32_t behind = tl_elements_behind(lookup, tl_sub_sat(motor, play->motor), play->lag);
    play->q = q;
    play->motor = motor;
    if (up ? edge > play->single : edge < play->single) {
        play->single = edge;
    }
    tl_count_q8_t p = tl_lookup_centre_inverse(lookup, motor - behind);
    if (tl_elements_narrow(lookup, p)) {
        p = play->single;
    }
    const bool above = p > lookup->q0 + (int32_t)lookup->extent;
    play->flags = p < lookup->q0 ? TL_LOOKUP_BELOW : (above ? TL_LOOKUP_ABOVE : 0U);
    play->p = p;
    return p;
}

TL_FAST tl_count_q8_t tl_play_step(tl_play_t *play, tl_count_q8_t q) {
    q = tl_clamp(q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    if (play->lookup->plays != 0) {
        return step_of_several(play, q);
    }
    if (q >= play->p) {
        if (2U * ((uint32_t)q - (uint32_t)play->p) > play->width) {
            uint32_t flags = 0;
            const tl_count_q8_t p = tl_lookup_p_low(play->lookup, q, play->p, &flags);
            if (p > play->p) {
                play->p = p;
                play->width = width_at(play->lookup, 2U * ((uint32_t)q - (uint32_t)p));
                play->flags = flags;
            }
        }
    } else if (2U * ((uint32_t)play->p - (uint32_t)q) > play->width) {
        uint32_t flags = 0;
        const tl_count_q8_t p = tl_lookup_p_high(play->lookup, q, play->p, &flags);
        if (p < play->p) {
            play->p = p;
            play->width = width_at(play->lookup, 2U * ((uint32_t)p - (uint32_t)q));
            play->flags = flags;
        }
    }
    return play->p;
}

TL_FAST tl_deg_q16_t tl_play_angle(const tl_play_t *play) {
    uint32_t flags = 0;
    return tl_lookup_angle(play->lookup, play->p, &flags);
}
