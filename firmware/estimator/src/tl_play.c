#include "tautline/tl_play.h"

void tl_play_start(tl_play_t *play, const tl_lookup_t *lookup, tl_count_q8_t p) {
    play->lookup = lookup;
    play->p = tl_clamp(p, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    play->flags = 0;
    play->width = (uint32_t)tl_lookup_width(lookup, play->p, &play->flags);
}

tl_count_q8_t tl_play_step(tl_play_t *play, tl_count_q8_t q) {
    q = tl_clamp(q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    // 2 |q - p| against B(p) says whether the instrument moves at all. Where it moves, p is on an envelope, and
    // 2 |q - p| is B(p).
    if (q >= play->p) {
        if (2U * ((uint32_t)q - (uint32_t)play->p) > play->width) {
            play->flags = 0;
            const tl_count_q8_t p = tl_lookup_p_low(play->lookup, q, &play->flags);
            if (p > play->p) { // rounding never moves it back
                play->p = p;
                play->width = 2U * ((uint32_t)q - (uint32_t)p);
            }
        }
    } else if (2U * ((uint32_t)play->p - (uint32_t)q) > play->width) {
        play->flags = 0;
        const tl_count_q8_t p = tl_lookup_p_high(play->lookup, q, &play->flags);
        if (p < play->p) {
            play->p = p;
            play->width = 2U * ((uint32_t)p - (uint32_t)q);
        }
    }
    return play->p;
}

tl_deg_q16_t tl_play_angle(const tl_play_t *play) {
    uint32_t flags = 0;
    return tl_lookup_angle(play->lookup, play->p, &flags);
}
