#include "../lookups.h"

#include "__fc_builtin.h"

#include "../../../firmware/estimator/src/tl_elements.c"
#include "../../../firmware/estimator/src/tl_elements.h"
#include "../../../firmware/estimator/src/tl_play.c"

#define ANY()     Frama_C_int_interval(INT32_MIN, INT32_MAX)
#define UP_TO(x)  Frama_C_int_interval(0, x)
#define WITHIN(x) Frama_C_int_interval(-(x), x)
#define HALF_MAX  ((int32_t)1 << 26)

static tl_lookup_t lookup;
static tl_play_t play;
static int32_t lag[TL_TABLE_PLAYS_MAX], undo[TL_TABLE_PLAYS_MAX];

static void elements(void) {
    tl_elements_start(&lookup, ANY(), lag);
    for (unsigned i = 0; i < TL_TABLE_PLAYS_MAX; i++) {
        lag[i] = WITHIN(HALF_MAX);
        undo[i] = WITHIN(4 * HALF_MAX);
    }
    tl_elements_behind(&lookup, ANY(), lag);
    tl_elements_ahead(&lookup, ANY(), undo);
    tl_elements_undo(&lookup, lag, undo);
    tl_elements_undo(&lookup, lag, lag);
    tl_elements_narrow(&lookup, ANY());
}

static void step(void) {
    play.lookup = &lookup;
    play.p = ANY();
    play.width = Frama_C_unsigned_int_interval(0, UINT32_MAX);
    play.q = WITHIN(TL_TABLE_VALUE_MAX);
    play.single = ANY();
    play.motor = ANY();
    for (unsigned i = 0; i < TL_TABLE_PLAYS_MAX; i++) {
        play.lag[i] = WITHIN(HALF_MAX);
    }
    tl_play_step(&play, ANY());
    tl_play_angle(&play);
}

int main(void) {
    for (unsigned i = 0; i < TL_TABLE_PLAYS_MAX; i++) {
        lookup.element[i].half = UP_TO(HALF_MAX);
        lookup.element[i].lag_most = UP_TO(HALF_MAX);
        lookup.element[i].weight_q16 = (uint16_t)UP_TO(UINT16_MAX);
        lookup.element[i].undo = (uint16_t)UP_TO(UINT16_MAX);
        lookup.element[i].undo_log2 = Frama_C_unsigned_int_interval(0, 5);
    }
    for (unsigned i = 0; i < TL_TABLE_NODES_MAX; i++) {
        lookup.table.width[i] = UP_TO(TL_TABLE_WIDTH_MAX);
    }
    lookup.narrow = UP_TO(TL_TABLE_WIDTH_MAX);
    lookup.half = Frama_C_int_interval(1 << 7, 1 << 25);
    lookup.q0 = WITHIN(TL_TABLE_POSITION_MAX);
    //@ loop unroll 30;
    for (unsigned log2 = 0; log2 <= TL_TABLE_STEP_LOG2_MAX; log2++) {
        lookup.step_log2 = log2;
        const uint32_t most = (uint32_t)(2ULL * TL_TABLE_POSITION_MAX >> log2), last = TL_TABLE_NODES_MAX - 1U;
        lookup.extent = Frama_C_unsigned_int_interval(1U << log2, (most < last ? most : last) << log2);
        lookup.plays = Frama_C_unsigned_int_interval(2, TL_TABLE_PLAYS_MAX);
        elements();
        lookup.plays = Frama_C_nondet(0, lookup.plays);
        tl_play_start(&play, &lookup, ANY());
        step();
    }
    return 0;
}
