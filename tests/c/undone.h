// What sections add to a model of an inverse play, and where. How much it is, is tl_undo.h's own (test_undo_exact.c).
#ifndef UNDONE_H
#define UNDONE_H

#include "draws.h"
#include "tautline/tl_compensator.h"

typedef struct {
    bool on;                // in full mode, while there is anything
    int64_t wider, reading; // counts Q8; strength Q16
    tl_undo_t undo;
    int64_t rested; // ticks in which p went on nowhere, and nothing was taken up
} undone_t;

static inline void undone_widens(undone_t *u, const tl_lookup_t *lookup, int64_t p, int64_t strength) {
    u->wider = u->on ? tl_undo_wider(&u->undo, lookup, (int32_t)p) * strength / 65536 : 0;
}

// Once a tick, before p moves: what there is of it where p will be if it goes on.
static inline void undone_weighs(undone_t *u, const tl_lookup_t *lookup) {
    if (u->on) {
        tl_undo_weigh(&u->undo, lookup, u->undo.p + u->undo.by);
    }
}

// The same where p stands, under settings that have changed.
static inline void undone_widens_anew(undone_t *u, const tl_lookup_t *lookup, int64_t p, int64_t strength) {
    if (u->on) {
        tl_undo_weigh(&u->undo, lookup, (int32_t)p);
    }
    undone_widens(u, lookup, p, strength);
}

// The side begins where p turns, and where it goes on after a rest longer than the table says. True: the latter.
static inline bool undone_begins(undone_t *u, const tl_lookup_t *lookup, int64_t anchor, int64_t now, int64_t side,
                                 bool turns, bool still) {
    const int64_t rest_us = lookup->table.anew.rest_us;
    const bool anew = now != anchor && rest_us != 0 && u->rested * 1000000 > rest_us * u->undo.rate_hz;
    u->rested = now == anchor && still ? u->rested + 1 : 0;
    if (turns || anew) {
        tl_undo_turned(&u->undo, (int32_t)anchor, (int32_t)side);
    }
    return anew;
}

// What the motor pushes from for the encoder to read this.
static inline int64_t undone_pushing(const undone_t *u, const tl_lookup_t *lookup, int64_t reading) {
    return u->on ? tl_undo_pushing(&u->undo, lookup, (int32_t)reading, TL_UNDO_ROUNDS) : reading;
}

// Whether there is anything; when it begins nothing is late, and the motor at q reads what it did.
static inline void undone_sees(undone_t *u, bool full, int64_t q, int64_t goal) {
    const bool on = u->undo.active && full;
    if (on && !u->on) {
        u->reading = q;
        tl_undo_rest(&u->undo, (int32_t)goal);
    }
    u->on = on;
}

// After a tick with p and the motor here: it reads what stays within the range, or is nearer to it than it was.
static inline void undone_ticks(undone_t *u, const tl_lookup_t *lookup, int64_t p, int64_t q) {
    const int64_t low = lookup->table.q_min, high = lookup->table.q_max, was = u->reading;
    tl_undo_tick(&u->undo, lookup, (int32_t)p);
    u->reading = within(tl_undo_reading(&u->undo, lookup, (int32_t)q), was < low ? was : low, was > high ? was : high);
}

// Of what `sides` and `speed` add, where the table has those, some goes with the place; B is up to 8 times this mean.
static inline void undone_pressed(tl_table_t *table, int32_t mean) {
    table->has |= TL_TABLE_HAS_pressed;
    table->pressed.mean = mean;
    table->pressed.sides_q16 = (table->has & TL_TABLE_HAS_sides) != 0 ? between(0, 2 << 16) : 0;
    table->pressed.speed_q16 = (table->has & TL_TABLE_HAS_speed) != 0 ? between(0, 2 << 16) : 0;
}

static inline void undone_curves(tl_table_t *table) { // of sections `sides` and `speed`
    for (int32_t i = 0; i <= (int32_t)TL_TABLE_LAST; i++) {
        table->sides.late[i] = (20 - i) << table->sides.step_log2;
        table->speed.extra[i] = i * i * 100;
    }
}

#endif
