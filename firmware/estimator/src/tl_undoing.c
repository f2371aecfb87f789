#include "tl_undoing.h"

#include "tl_feed.h"
#include "tl_several.h"

#include "tautline/tl_fast.h"

TL_FAST void tl_compensator_hear(tl_compensator_t *k, tl_deg_q16_t c) {
    k->angle = tl_undo_angle(&k->undo, k->lookup, c);
    // Where p will be, if it goes on.
    tl_undo_weigh(&k->undo, k->lookup, (int32_t)((uint32_t)k->undo.p + (uint32_t)k->undo.by));
}

TL_FAST void tl_undoing_feed(tl_compensator_t *k) {
    const tl_count_q8_t goal = on_curve(k, k->angle, &k->feed_flags);
    seek(k, tl_clamp(tl_undo_late(&k->undo, goal), k->low, k->high));
}

// The side of p, which was at `anchor` before this tick, begins where it turns, or goes on after a rest. True: the
// latter.
static TL_FAST inline bool begins(tl_compensator_t *k, tl_count_q8_t anchor, bool turns) {
    const bool anew = tl_undo_anew(&k->undo, k->anchor != anchor, tl_takeup_done(&k->takeup));
    if (turns || anew) {
        tl_undo_turned(&k->undo, anchor, k->side);
    }
    return anew;
}

// What the sections add to half the width now, on this side.
static TL_FAST inline void widen(tl_compensator_t *k) {
    k->wider = half_of(k, (uint32_t)tl_undo_wider(&k->undo, k->lookup, k->p));
}

static TL_FAST void turn_one(tl_compensator_t *k) {
    uint32_t ends = 0;
    const int32_t half = tl_undo_scaled(&k->undo, half_of(k, (uint32_t)tl_lookup_width(k->lookup, k->p, &ends)));
    const tl_count_q8_t before = fed(k, half + k->wider);
    const tl_count_q8_t anchor = k->anchor;
    const bool turns = turned(k);
    if (turns) {
        k->side = k->p > anchor ? 1 : -1;
        k->anchor = k->p;
    }
    const bool anew = begins(k, anchor, turns);
    widen(k);
    k->half = half + k->wider;
    if (turns || anew) {
        absorb(k, fed(k, k->half), before);
    }
}

TL_FAST void tl_undoing_turn(tl_compensator_t *k) {
    if (!k->several) {
        turn_one(k);
        return;
    }
    const int32_t side = k->side;
    const tl_count_q8_t anchor = k->anchor;
    tl_several_turn(k);
    if (begins(k, anchor, k->side != side)) {
        k->turns = true; // it is taken up as after a turn
    }
    widen(k);
    k->moved = k->side != 0; // the width alone may have changed
}

TL_FAST tl_count_q8_t tl_compensator_reach(tl_compensator_t *k) {
    tl_undo_tick(&k->undo, k->lookup, k->p);
    const tl_count_q8_t reading = tl_undo_reading(&k->undo, k->lookup, k->q), last = k->reading;
    const tl_count_q8_t low = last < k->low ? last : k->low, high = last > k->high ? last : k->high;
    return k->reading = tl_clamp(reading, low, high);
}
