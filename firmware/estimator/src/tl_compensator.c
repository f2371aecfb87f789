#include "tl_elements.h"
#include "tl_feed.h"
#include "tl_several.h"
#include "tl_undoing.h"

#include "tautline/tl_fast.h"

_Static_assert(TL_COMPENSATOR_BELOW == TL_LOOKUP_BELOW && TL_COMPENSATOR_ABOVE == TL_LOOKUP_ABOVE, "shared flags");

#define RATE_MIN_HZ 16U
#define RATE_MAX_HZ 100000U

static tl_per_tick_t per_tick(int32_t per_second_q8, uint32_t rate_hz) {
    const uint64_t scaled = ((uint64_t)(uint32_t)per_second_q8 << 32) / rate_hz;
    return (tl_per_tick_t){(int32_t)(scaled >> 32), (uint32_t)scaled};
}

static void set_limits(tl_compensator_t *k, const tl_table_t *table) {
    tl_takeup_set_limits(&k->takeup, table, k->rate_hz);
    k->feed_max = per_tick(table->speed_max_q8, k->rate_hz);
    k->feed_flat = per_tick(table->flat_speed_q8, k->rate_hz);
    k->step_max = per_tick(table->takeup_speed_q8, k->rate_hz).whole;
}

// Where c wants p, and where p wants q ---------------------------------------------------------------

// k B(p) / 2
static TL_FAST int32_t half_width(const tl_compensator_t *k) {
    uint32_t ends = 0;
    if (k->mode == TL_MODE_OFF) {
        return 0;
    }
    return half_of(k, (uint32_t)tl_lookup_width(k->lookup, k->p, &ends));
}

static TL_FAST int32_t wider_by(tl_compensator_t *k) {
    tl_undo_weigh(&k->undo, k->lookup, k->p);
    return half_of(k, (uint32_t)tl_undo_wider(&k->undo, k->lookup, k->p));
}

static TL_FAST tl_count_q8_t fed_anew(tl_compensator_t *k) {
    k->wider = k->undoes ? wider_by(k) : 0;
    if (k->several) {
        tl_several_hold(k);
    } else {
        k->half = half_width(k);
        k->half = k->undoes ? tl_undo_scaled(&k->undo, k->half) + k->wider : k->half;
    }
    return fed(k, k->half);
}

// One tick -------------------------------------------------------------------------------------------

// Moves p towards its goal, no faster than speed_max, nor than the flat speed within flat spans.
static TL_FAST void advance(tl_compensator_t *k) {
    const tl_per_tick_t *limit = &k->feed_max;
    if (k->slow) {
        limit = &k->feed_flat;
        k->feed_flags |= TL_COMPENSATOR_FLAT;
    }
    int32_t way = k->aim - k->p;
    const bool up = way >= 0;
    if ((up ? way : -way) > limit->whole) {
        const uint32_t fraction = k->feed_fraction + limit->fraction;
        k->feed_fraction = fraction;
        const int32_t allowed = limit->whole + (fraction < limit->fraction ? 1 : 0);
        way = up ? allowed : -allowed; // no more than was wanted: a whole count more at most
    }
    k->p += way;
}

TL_FAST void tl_compensator_feed(tl_compensator_t *k, tl_deg_q16_t c) {
    k->c = c;
    k->feed_flags = 0;
    if (k->by_curve) {
        seek(k, on_curve(k, c, &k->feed_flags));
    } else if (k->undoes) {
        tl_undoing_feed(k);
    } else {
        k->goal = k->aim = tl_lookup_coarse_inverse(k->lookup, c, &k->feed_flags);
        k->slow = false;
    }
}

TL_FAST void tl_compensator_turn(tl_compensator_t *k) {
    if (k->goal != k->p) {
        advance(k);
    }
    k->feed_flags |= k->p != k->goal ? TL_COMPENSATOR_LIMITED : 0;
    if (k->undoes) {
        tl_undoing_turn(k);
        return;
    }
    if (k->several) {
        tl_several_turn(k);
        return;
    }
    const int32_t half = k->half = half_width(k);
    if (turned(k)) {
        const tl_count_q8_t low = k->low, high = k->high, p = k->p;
        const tl_count_q8_t before = tl_clamp(pushed(k, half), low, high);
        const bool up = p > k->anchor;
        k->side = up ? 1 : -1;
        k->anchor = p;
        absorb(k, tl_clamp(up ? p + half : p - half, low, high), before);
    }
}

TL_FAST tl_count_q8_t tl_compensator_take_up(tl_compensator_t *k) {
    if (k->moved) {
        tl_several_lead(k);
    }
    tl_takeup_step(&k->takeup);
    const tl_count_q8_t q_min = k->low, q_max = k->high, last = k->q;
    const tl_count_q8_t push = pushed(k, k->half), feed = tl_clamp(push, q_min, q_max);
    uint32_t flags = k->feed_flags | (push != feed ? TL_COMPENSATOR_CLIPPED : 0U);
    // Modulo 2^32: e alone may need one bit more, but q* is never far from where it was.
    const tl_count_q8_t wanted = (int32_t)((uint32_t)feed - tl_takeup_rest(&k->takeup));
    // The motor stays within its range; from outside of it only the way inwards is open.
    tl_count_q8_t q = wanted;
    if (wanted < q_min) {
        const tl_count_q8_t low = last < q_min ? last : q_min;
        q = wanted < low ? low : wanted;
    } else if (wanted > q_max) {
        const tl_count_q8_t high = last > q_max ? last : q_max;
        q = wanted > high ? high : wanted;
    }
    if (q != wanted) { // the take-up begins again from here
        tl_takeup_set(&k->takeup, feed - q);
        flags |= TL_COMPENSATOR_CLIPPED;
    }
    k->q = q;
    flags |= k->side == 0 ? TL_COMPENSATOR_NO_SIDE : 0;
    k->flags = flags | (tl_takeup_done(&k->takeup) ? 0 : TL_COMPENSATOR_TAKE_UP);
    return q;
}

tl_count_q8_t tl_compensator_step(tl_compensator_t *k, tl_deg_q16_t c) {
    if (k->undoes) {
        tl_compensator_hear(k, c);
    }
    tl_compensator_feed(k, c);
    tl_compensator_turn(k);
    const tl_count_q8_t q = tl_compensator_take_up(k);
    return k->undoes ? tl_compensator_reach(k) : q;
}

// Settings -------------------------------------------------------------------------------------------

static void use(tl_compensator_t *k, const tl_lookup_t *lookup) {
    k->lookup = lookup;
    k->low = lookup->table.q_min;
    k->high = lookup->table.q_max;
    k->band = lookup->table.band;
    k->several = lookup->plays != 0;
    k->moved = false;
}

static void stand(tl_compensator_t *k, tl_count_q8_t p) {
    k->p = k->aim = k->goal = p;
    k->slow = false;
    tl_undo_rest(&k->undo, p);
    if (k->several) {
        tl_several_stand(k);
    }
}

// Where the motor was sent last, as its encoder reads it; and what it pushes from where it reads that.
static tl_count_q8_t sent(const tl_compensator_t *k) {
    return k->undoes ? k->reading : k->q;
}

static tl_count_q8_t pushing_of(const tl_compensator_t *k, tl_count_q8_t reading) {
    return k->undoes ? tl_undo_pushing(&k->undo, k->lookup, reading, TL_UNDO_ROUNDS) : reading;
}

static TL_FAST void set_undoes(tl_compensator_t *k) {
    const bool undoes = k->undo.active && k->mode == TL_MODE_FULL;
    if (undoes && !k->undoes) { // nothing is late, and the motor reads what it did
        k->reading = k->q;
        k->angle = k->c;
        tl_undo_rest(&k->undo, k->goal);
    }
    k->undoes = undoes;
    k->by_curve = k->mode == TL_MODE_FULL && !undoes;
}

// p* for c, all that is undone before it included.
static tl_count_q8_t wanted(tl_compensator_t *k, tl_deg_q16_t c) {
    uint32_t flags = 0;
    if (k->undoes) {
        c = tl_undo_angle(&k->undo, k->lookup, c);
    }
    return k->mode == TL_MODE_FULL ? on_curve(k, c, &flags) : tl_lookup_coarse_inverse(k->lookup, c, &flags);
}

void tl_compensator_start_moved(tl_compensator_t *k, const tl_lookup_t *lookup, uint32_t rate_hz, tl_mode_t mode,
                                tl_count_q8_t q, tl_deg_q16_t c, const tl_moved_t *moved) {
    *k = (tl_compensator_t){.mode = mode, .strength_q15 = lookup->table.strength_q15, .undo = {.moved = *moved}};
    use(k, lookup);
    tl_takeup_start(&k->takeup);
    k->rate_hz = rate_hz < RATE_MIN_HZ ? RATE_MIN_HZ : (rate_hz > RATE_MAX_HZ ? RATE_MAX_HZ : rate_hz);
    tl_undo_start(&k->undo, lookup, k->rate_hz);
    set_undoes(k);
    k->c = c;
    k->reading = tl_clamp(q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX);
    k->q = pushing_of(k, k->reading);
    const tl_count_q8_t p = wanted(k, c);
    k->start_offset = k->offset = tl_sub_sat(k->q, p);
    if (k->several) {
        tl_several_begin(k, p, k->q);
    }
    stand(k, p);
    k->anchor = p;
    set_limits(k, &lookup->table);
    absorb(k, fed_anew(k), k->q);
}

void tl_compensator_start(tl_compensator_t *k, const tl_lookup_t *lookup, uint32_t rate_hz, tl_mode_t mode,
                          tl_count_q8_t q, tl_deg_q16_t c) {
    const tl_moved_t unmoved = {.joint = {0}};
    tl_compensator_start_moved(k, lookup, rate_hz, mode, q, c, &unmoved);
}

void tl_compensator_know(tl_compensator_t *k, const tl_play_t *play) {
    if (k->several && play->lookup == k->lookup) {
        tl_elements_undo(k->lookup, play->lag, k->lags);
    }
}

// p* again for the last command under new settings, with the direction's memory moved along. `reading`: where the motor
// was sent last, and stays: whatever it now lacks, or has too much, is still to be taken up.
static void settle(tl_compensator_t *k, tl_count_q8_t reading) {
    const tl_count_q8_t p = wanted(k, k->c);
    k->anchor = tl_add_sat(k->anchor, p - k->p);
    stand(k, p);
    k->reading = reading;
    k->q = pushing_of(k, reading);
    absorb(k, fed_anew(k), tl_add_sat(k->q, tl_compensator_rest(k)));
}

void tl_compensator_set_mode(tl_compensator_t *k, tl_mode_t mode) {
    const tl_count_q8_t before = sent(k);
    k->mode = mode;
    set_undoes(k);
    settle(k, before);
}

TL_FAST void tl_compensator_set_strength(tl_compensator_t *k, int32_t strength_q15) {
    const tl_count_q8_t before = fed_anew(k);
    k->strength_q15 = (uint32_t)tl_clamp(strength_q15, 0, TL_RATIO_ONE);
    absorb(k, fed_anew(k), before);
}

void tl_compensator_set_table(tl_compensator_t *k, const tl_lookup_t *lookup) {
    const tl_count_q8_t before = sent(k);
    const int32_t place = tl_several_place(k);
    use(k, lookup);
    tl_undo_start(&k->undo, lookup, k->rate_hz);
    set_undoes(k);
    set_limits(k, &lookup->table);
    if (k->several) {
        tl_several_begin_at(k, place);
    }
    settle(k, before);
}

TL_FAST bool tl_compensator_adapt(tl_compensator_t *k, tl_count_q8_t offset, int32_t scale_q15, uint32_t ticks) {
    const bool allowed = tl_undo_adapt(&k->undo, k->lookup, offset, scale_q15, ticks);
    set_undoes(k);
    return allowed;
}

TL_FAST void tl_compensator_load(tl_compensator_t *k, int32_t load, uint32_t ticks) {
    tl_undo_load(&k->undo, k->lookup, load, ticks);
    set_undoes(k);
}

tl_count_q8_t tl_compensator_rest(const tl_compensator_t *k) {
    return (tl_count_q8_t)tl_takeup_rest(&k->takeup);
}
