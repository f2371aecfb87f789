#include "../lookups.h"

#include "__fc_builtin.h"

/*@ assigns \result \from \nothing; ensures \result == TL_TABLE_OK || \result == TL_TABLE_BAD_RANGE; */
tl_table_reason_t tl_table_check(const tl_table_t *table, uint8_t axis); // proof check

/*@ requires size == 0 || \valid_read(blob + (0 .. size - 1)); requires \valid(table);
    assigns \result \from \nothing; ensures \result == TL_TABLE_OK || \result == TL_TABLE_BAD_RANGE; */
tl_table_reason_t tl_table_decode(const uint8_t *blob, size_t size, uint8_t axis,
                                  tl_table_t *table); // proofs blob, decode, sections; the driver wrote the table

/*@ assigns \result \from *table; */
uint32_t tl_table_flat_below(const tl_table_t *table); // proof check

/*@ requires 0 < numerator < 0x80000000 && 0 < denominator < 0x80000000;
    assigns \result \from numerator, denominator;
    ensures \result.mantissa >= 0x80000000 && -31 <= \result.shift <= 31; */
tl_scale_t tl_scale_of(uint32_t numerator, uint32_t denominator); // proof fixed

#include "tl_ratio.h"

/*@ requires 0 < whole < 0x80000000; assigns \result \from whole; ensures \result <= 0xFFFF; */
static inline uint32_t tl_ratio_of(uint32_t whole); // proof ratio

#include "../../../firmware/estimator/src/tl_lookup_load.c"

#define FROM(x, y)     Frama_C_int_interval(x, y)
#define UP_TO(x)       Frama_C_unsigned_int_interval(0, x)
#define WITHIN(x)      Frama_C_int_interval(-(x), x)
#define ANY_UNSIGNED() Frama_C_unsigned_int_interval(0, UINT32_MAX)

static tl_lookup_t lookup;
static tl_table_t any;
static uint8_t blob[1];

// What a table that passed may have, of any number of nodes.
static void any_table(tl_table_t *t) {
    Frama_C_make_unknown((char *)t, sizeof *t);
    t->q0 = WITHIN(TL_TABLE_POSITION_MAX);
    t->q_min = WITHIN(TL_TABLE_POSITION_MAX);
    t->q_max = WITHIN(TL_TABLE_POSITION_MAX);
    t->coarse_c_min = WITHIN(TL_TABLE_VALUE_MAX);
    t->coarse_c_max = WITHIN(TL_TABLE_VALUE_MAX);
    t->has = ANY_UNSIGNED();
    t->encoder.period_q12 = FROM(1 << 12, INT32_MAX);
    t->narrow = FROM(0, TL_TABLE_WIDTH_MAX);
    t->period_log2 = (uint8_t)FROM(8, 26);
    //@ loop unroll 300;
    for (unsigned i = 0; i < TL_TABLE_NODES_MAX; i++) {
        t->width[i] = FROM(0, TL_TABLE_WIDTH_MAX);
        t->angle[i] = WITHIN(TL_TABLE_VALUE_MAX);
        t->centre[i] = WITHIN(TL_TABLE_CENTRE_MAX);
    }
    //@ loop unroll 8;
    for (unsigned i = 0; i < TL_TABLE_PLAYS_MAX; i++) {
        t->play_width_q28[i] = ANY_UNSIGNED();
        t->play_weight_q16[i] = Frama_C_unsigned_int_interval(i == 0 ? 3277U : 1U, 65535U);
    }
}

static void load(void) {
    Frama_C_make_unknown((char *)&lookup, sizeof lookup);
    lookup.table = any;
    tl_lookup_load(&lookup, blob, sizeof blob, (uint8_t)UP_TO(UINT8_MAX));
}

int main(void) {
    any_table(&any);
    any.nodes = 0;
    any.plays = 0;
    load();
    tl_lookup_derive(&lookup, &any, (uint8_t)UP_TO(UINT8_MAX));
    //@ loop unroll 30;
    for (unsigned log2 = 0; log2 <= TL_TABLE_STEP_LOG2_MAX; log2++) {
        const uint32_t most = (uint32_t)(2ULL * TL_TABLE_POSITION_MAX >> log2), last = TL_TABLE_NODES_MAX - 1U;
        any.step_log2 = (uint8_t)log2;
        any.nodes = (uint16_t)Frama_C_unsigned_int_interval(2U, (most < last ? most : last) + 1U);
        any.plays = (uint8_t)Frama_C_nondet(0, Frama_C_int_interval(2, TL_TABLE_PLAYS_MAX));
        load();
    }
    return 0;
}
