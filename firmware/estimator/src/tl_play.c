#include "tautline/tl_play.h"

void tl_play_start(tl_play_t *play, const tl_lookup_t *lookup, tl_count_q8_t p) {
    play->lookup = lookup;
    play->p = tl_clamp(p, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    play->flags = 0;
}

tl_count_q8_t tl_play_step(tl_play_t *play, tl_count_q8_t q) {
    uint32_t held = 0;
    play->flags = 0;
    q = tl_clamp(q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    // 2 |q - p| against B(p) says whether the instrument moves at all, without solving for where.
    const uint32_t width = (uint32_t)tl_lookup_width(play->lookup, play->p, &held);
    if (q >= play->p) {
        if (2U * ((uint32_t)q - (uint32_t)play->p) > width) {
            const tl_count_q8_t p = tl_lookup_p_low(play->lookup, q, &play->flags);
            play->p = p > play->p ? p : play->p; // rounding never moves it back
        }
    } else if (2U * ((uint32_t)play->p - (uint32_t)q) > width) {
        const tl_count_q8_t p = tl_lookup_p_high(play->lookup, q, &play->flags);
        play->p = p < play->p ? p : play->p;
    }
    play->p = tl_clamp(play->p, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    play->flags |= held;
    return play->p;
}

tl_deg_q16_t tl_play_angle(const tl_play_t *play) {
    uint32_t flags = 0;
    return tl_lookup_angle(play->lookup, play->p, &flags);
}
