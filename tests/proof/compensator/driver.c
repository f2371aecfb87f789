#ifndef SEVERAL // proof several
#define SEVERAL 0
#endif
#include "../lookups.h"
#include "../takeups.h"
#include "tautline/tl_undo.h"

#include "__fc_builtin.h"

/*@ requires \valid_read(lookup) && \valid(lag + (0 .. TL_TABLE_PLAYS_MAX - 1));
    assigns lag[0 .. TL_TABLE_PLAYS_MAX - 1] \from apart, *lookup; */
void tl_elements_start(const tl_lookup_t *lookup, int32_t apart, int32_t lag[]); // proof elements

/*@ requires \valid_read(lookup) && \valid_read(lag + (0 .. TL_TABLE_PLAYS_MAX - 1));
    requires \valid(undo + (0 .. TL_TABLE_PLAYS_MAX - 1));
    assigns undo[0 .. TL_TABLE_PLAYS_MAX - 1] \from lag[0 .. TL_TABLE_PLAYS_MAX - 1], *lookup; */
void tl_elements_undo(const tl_lookup_t *lookup, const int32_t lag[], int32_t undo[]); // proof elements

/*@ requires \valid_read(lookup) && \valid(undo + (0 .. TL_TABLE_PLAYS_MAX - 1));
    assigns undo[0 .. TL_TABLE_PLAYS_MAX - 1], \result \from moved, undo[0 .. TL_TABLE_PLAYS_MAX - 1], *lookup;
    ensures -0x8000000 <= \result <= 0x8000000; */
int32_t tl_elements_ahead(const tl_lookup_t *lookup, int32_t moved, int32_t undo[]); // proof elements: below 2^26

/*@ requires \valid(undo) && \valid_read(lookup); assigns *undo \from *undo, *lookup, rate_hz;
    ensures undo->active == 0 || undo->active == 1; */
void tl_undo_start(tl_undo_t *undo, const tl_lookup_t *lookup, uint32_t rate_hz); // this and what follows: proof undo

/*@ requires \valid(undo); requires -TL_TABLE_VALUE_MAX <= p <= TL_TABLE_VALUE_MAX; assigns *undo \from *undo, p;
    ensures undo->active == 0 || undo->active == 1; */
void tl_undo_rest(tl_undo_t *undo, tl_count_q8_t p);

/*@ requires \valid(undo) && \valid_read(lookup);
    assigns *undo, \result \from *undo, *lookup, offset, scale_q15, ticks;
    ensures \result == 0 || \result == 1; ensures undo->active == 0 || undo->active == 1; */
bool tl_undo_adapt(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t offset, int32_t scale_q15, uint32_t ticks);

/*@ requires \valid(undo) && \valid_read(lookup); assigns *undo \from *undo, *lookup, load, ticks;
    ensures undo->active == 0 || undo->active == 1; */
void tl_undo_load(tl_undo_t *undo, const tl_lookup_t *lookup, int32_t load, uint32_t ticks);

/*@ requires \valid(undo) && \valid_read(lookup); requires -TL_TABLE_VALUE_MAX <= p <= TL_TABLE_VALUE_MAX;
    assigns *undo \from *undo, *lookup, p; */
void tl_undo_tick(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p);

/*@ requires \valid_read(undo) && \valid_read(lookup); assigns \result \from *undo, *lookup, c; */
tl_deg_q16_t tl_undo_angle(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_deg_q16_t c);

/*@ requires \valid(undo); requires -TL_TABLE_VALUE_MAX <= p <= TL_TABLE_VALUE_MAX; assigns *undo, \result \from *undo,
   p; ensures -TL_TABLE_VALUE_MAX <= \result <= TL_TABLE_VALUE_MAX; */
tl_count_q8_t tl_undo_late(tl_undo_t *undo, tl_count_q8_t p);

/*@ requires \valid(undo); requires -0x5FFFFFFE <= p <= 0x5FFFFFFE; requires -1 <= side <= 1;
    assigns *undo \from *undo, p, side; */
void tl_undo_turned(tl_undo_t *undo, tl_count_q8_t p, int32_t side);

/*@ requires \valid(undo); assigns *undo, \result \from *undo, goes_on, still;
    ensures \result == 0 || \result == 1; ensures undo->active == 0 || undo->active == 1; */
bool tl_undo_anew(tl_undo_t *undo, bool goes_on, bool still);

/*@ requires \valid(undo) && \valid_read(lookup); assigns *undo \from *undo, *lookup, p;
    ensures undo->active == 0 || undo->active == 1; */
void tl_undo_weigh(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p);

/*@ requires \valid(undo) && \valid_read(lookup); requires -TL_TABLE_VALUE_MAX <= p <= TL_TABLE_VALUE_MAX;
    assigns *undo, \result \from *undo, *lookup, p; ensures 0 <= \result <= 3 * 0x1000000;
    ensures undo->active == 0 || undo->active == 1; */
int32_t tl_undo_wider(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p);

/*@ requires \valid_read(undo); requires -0x3FFFFFFF <= width <= 0x3FFFFFFF; assigns \result \from *undo, width;
    ensures 0 <= width ==> 0 <= \result <= 2 * width; ensures width <= 0 ==> 2 * width <= \result <= 0; */
int32_t tl_undo_scaled(const tl_undo_t *undo, int32_t width);

/*@ requires \valid_read(undo) && \valid_read(lookup); requires -0x50000000 <= q <= 0x50000000;
    assigns \result \from *undo, *lookup, q; */
tl_count_q8_t tl_undo_reading(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t q);

/*@ requires \valid_read(undo) && \valid_read(lookup); requires -0x50000000 <= reading <= 0x50000000;
    assigns \result \from *undo, *lookup, reading, rounds;
    ensures reading - 0x1480000 <= \result <= reading + 0x1480000; */
tl_count_q8_t tl_undo_pushing(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t reading, uint32_t rounds);

#if SEVERAL
#include "tl_elements.h"

/*@ requires \valid_read(lookup); assigns \result \from p, *lookup; ensures \result == 0 || \result == 1; */
static inline bool tl_elements_narrow(const tl_lookup_t *lookup, tl_count_q8_t p); // proof elements

#define REACH_MAX  (2 * (TL_TABLE_WIDTH_MAX + 1) + (1 << TL_TABLE_STEP_LOG2_MAX)) // reaches() in tl_lookup_load.c
#define OFFSET_MAX (REACH_MAX + TL_TABLE_WIDTH_MAX / 2)
#define APART_MAX  (3 << 26)

/*@ ensures -OFFSET_MAX <= \result <= OFFSET_MAX; */
static int32_t offset_on(const tl_compensator_t *k, bool up);
#else
#define OFFSET_MAX (TL_TABLE_WIDTH_MAX / 2)
#endif
#define WIDER_MAX (3 << 23)
#define HALF_MAX  (2 * OFFSET_MAX + WIDER_MAX)

#include "../../../firmware/estimator/src/tl_compensator.c"
#include "../../../firmware/estimator/src/tl_feed.h"
#include "../../../firmware/estimator/src/tl_several.c"
#include "../../../firmware/estimator/src/tl_takeup.c"
#include "../../../firmware/estimator/src/tl_undoing.c"

#define ANY()          Frama_C_int_interval(INT32_MIN, INT32_MAX)
#define ANY_UNSIGNED() Frama_C_unsigned_int_interval(0, UINT32_MAX)
#define FROM(x, y)     Frama_C_int_interval(x, y)
#define WITHIN(x)      Frama_C_int_interval(-(x), x)
#define LONG(x, y)     Frama_C_long_long_interval(x, y)
#define PLACE()        WITHIN(TL_TABLE_POSITION_MAX)
#define AWAY_MAX       0x40800000 // where a motor may be that is not in its range
// An anchor is as far behind p as the range and a band allow, also where p has jumped since.
#define ANCHOR_MAX (TL_TABLE_POSITION_MAX + TL_TABLE_VALUE_MAX)
static tl_lookup_t lookup;
static tl_compensator_t k;

static tl_per_tick_t any_per_tick(void) {
    return (tl_per_tick_t){.whole = FROM(0, TL_TABLE_VALUE_MAX / 16), .fraction = ANY_UNSIGNED()};
}

static void any(void) {
    Frama_C_make_unknown((char *)&k.undo, sizeof k.undo);
    k.undo.active = Frama_C_nondet(0, 1);
    k.lookup = &lookup;
    k.low = lookup.table.q_min;
    k.high = lookup.table.q_max;
    k.band = lookup.table.band;
    k.several = SEVERAL;
    k.by_curve = Frama_C_nondet(0, 1);
    k.undoes = Frama_C_nondet(0, 1);
    k.moved = k.several && Frama_C_nondet(0, 1);
    k.feed_flags = ANY_UNSIGNED();
    k.mode = Frama_C_unsigned_int_interval(TL_MODE_OFF, TL_MODE_FULL);
    k.strength_q15 = Frama_C_unsigned_int_interval(0, TL_RATIO_ONE);
    k.side = FROM(-1, 1);
    k.half = FROM(SEVERAL ? -HALF_MAX : 0, HALF_MAX);
    k.start_offset = SEVERAL ? WITHIN(2 * OFFSET_MAX) : ANY();
    k.c = ANY();
    k.p = PLACE();
    k.goal = PLACE();
    k.aim = PLACE();
    k.slow = Frama_C_nondet(0, 1);
    k.anchor = WITHIN(ANCHOR_MAX);
    k.q = WITHIN(AWAY_MAX);
    k.feed_fraction = ANY_UNSIGNED();
    k.feed_max = any_per_tick();
    k.feed_flat = any_per_tick();
    k.takeup = any_takeup();
    k.rate_hz = Frama_C_unsigned_int_interval(16, 100000);
    k.angle = ANY();
    k.wider = FROM(0, WIDER_MAX);
    k.reading = WITHIN(AWAY_MAX);
#if SEVERAL
    k.turns = Frama_C_nondet(0, 1);
    k.offset = WITHIN(OFFSET_MAX);
    k.centre = WITHIN(TL_TABLE_CENTRE_MAX);
    k.apart = WITHIN(APART_MAX);
    for (unsigned i = 0; i < TL_TABLE_PLAYS_MAX; i++) {
        k.lags[i] = WITHIN(1 << 28);
    }
    k.step_max = FROM(0, TL_TABLE_VALUE_MAX / 16);
#endif
}

static void start(void) {
    tl_moved_t moved;
    Frama_C_make_unknown((char *)&moved, sizeof moved);
    const tl_mode_t mode = (tl_mode_t)Frama_C_unsigned_int_interval(TL_MODE_OFF, TL_MODE_FULL);
    tl_compensator_start(&k, &lookup, ANY_UNSIGNED(), mode, ANY(), ANY());
    tl_compensator_start_moved(&k, &lookup, ANY_UNSIGNED(), mode, ANY(), ANY(), &moved);
}

static void step(void) {
    any();
    tl_compensator_hear(&k, ANY());
    any();
    tl_compensator_turn(&k);
    any();
    tl_compensator_take_up(&k);
    any();
    tl_compensator_reach(&k);
    any();
    tl_compensator_rest(&k);
}

static void know(void) {
    tl_play_t play;
    play.lookup = Frama_C_nondet_ptr(&lookup, 0);
    for (unsigned i = 0; i < TL_TABLE_PLAYS_MAX; i++) {
        play.lag[i] = WITHIN(1 << 26);
    }
    any();
    tl_compensator_know(&k, &play);
}

static void set(void) {
    any();
    tl_compensator_set_mode(&k, (tl_mode_t)Frama_C_unsigned_int_interval(TL_MODE_OFF, TL_MODE_FULL));
    any();
    tl_compensator_set_strength(&k, ANY());
    any();
    k.several = SEVERAL && Frama_C_nondet(0, 1); // before it
    tl_compensator_set_table(&k, &lookup);
    any();
    tl_compensator_adapt(&k, ANY(), ANY(), ANY_UNSIGNED());
    any();
    tl_compensator_load(&k, ANY(), ANY_UNSIGNED());
}

int main(void) {
    for (unsigned i = 0; i < TL_TABLE_NODES_MAX; i++) {
        lookup.table.angle[i] = WITHIN(TL_TABLE_VALUE_MAX);
    }
    lookup.flat_below = ANY_UNSIGNED();
    lookup.has_flat = Frama_C_nondet(0, 1);
    lookup.turn = Frama_C_nondet(0, -1);
#if SEVERAL
    lookup.plays = Frama_C_nondet(0, Frama_C_int_interval(2, TL_TABLE_PLAYS_MAX));
    lookup.narrow = FROM(0, TL_TABLE_WIDTH_MAX);
    lookup.half = FROM(1 << 7, 1 << 25);
    lookup.element[0].half = FROM(0, 1 << 26);
#endif
    lookup.q0 = WITHIN(TL_TABLE_VALUE_MAX);
    lookup.table.q_min = PLACE();
    lookup.table.q_max = PLACE();
    lookup.table.band = FROM(0, TL_TABLE_VALUE_MAX);
    lookup.table.strength_q15 = (uint16_t)FROM(0, TL_RATIO_ONE);
    lookup.table.speed_max_q8 = FROM(1, TL_TABLE_VALUE_MAX);
    lookup.table.flat_speed_q8 = FROM(0, TL_TABLE_VALUE_MAX);
    lookup.table.takeup_speed_q8 = FROM(1, TL_TABLE_VALUE_MAX);
    lookup.table.takeup_accel = FROM(1, INT32_MAX);
    //@ loop unroll 30;
    for (unsigned log2 = 0; log2 <= TL_TABLE_STEP_LOG2_MAX; log2++) {
        lookup.step_log2 = log2;
        lookup.extent = Frama_C_unsigned_int_interval(0, (TL_TABLE_NODES_MAX - 1U) << log2);
        any();
        tl_compensator_feed(&k, ANY());
        any();
        tl_compensator_step(&k, ANY());
    }
    lookup.step_log2 = Frama_C_unsigned_int_interval(0, TL_TABLE_STEP_LOG2_MAX);
    start();
    step();
    set();
    know();
    return 0;
}
