#include "__fc_builtin.h"

#include <stdint.h>

/*@ assigns \result \from turn; ensures -40000 <= \result <= 40000; */
static int32_t sine(uint32_t turn); // proof sine

#include "../lookups.h"

/*@ assigns \result \from x, ratio.mantissa, ratio.shift; ensures \result <= 8 << 14; */
static uint32_t tl_scale(uint32_t x, tl_scale_t ratio); // of B: proof fixed, and B is at most eight means (is_pressed)

#include "../../../firmware/estimator/src/tl_undo.c"

#define ANY()          Frama_C_int_interval(INT32_MIN, INT32_MAX)
#define ANY_UNSIGNED() Frama_C_unsigned_int_interval(0, UINT32_MAX)
#define FROM(x, y)     Frama_C_int_interval(x, y)
#define WITHIN(x)      Frama_C_int_interval(-(x), x)
#define PLACE()        WITHIN(TL_TABLE_POSITION_MAX)
#define ANCHOR()       WITHIN(TL_TABLE_POSITION_MAX + TL_TABLE_VALUE_MAX)

static tl_lookup_t lookup;
static tl_undo_t undo;

static tl_ramp_t any_ramp(int32_t least, int32_t most) {
    return (tl_ramp_t){.now = FROM(least, most), .goal = FROM(least, most), .step = FROM(0, COUNT_Q16 / 2)};
}

static void any_moved(void) {
    undo.moved.offset = any_ramp(-MOST, MOST);
    undo.moved.scale = any_ramp(SCALE_LEAST, SCALE_MOST);
    undo.moved.gain = any_ramp(-(1 << 23), 1 << 23);
    undo.moved.adapt_offset = WITHIN(256 * TL_TABLE_ADAPT_OFFSET_MAX);
    undo.moved.adapt_scale = WITHIN(256 * TL_RATIO_ONE);
    undo.moved.load_offset = WITHIN(MOST);
    undo.moved.load_scale = FROM(SCALE_LEAST, SCALE_MOST);
    //@ loop unroll 3;
    for (unsigned i = 0; i < TL_TABLE_JOINTS; i++) {
        undo.moved.joint[i] = WITHIN(TL_TABLE_VALUE_MAX);
    }
}

static void any_table(void) {
    tl_table_t *t = &lookup.table;
    t->has = ANY_UNSIGNED();
    t->encoder.sine = WITHIN(TL_TABLE_ENCODER_MAX);
    t->encoder.cosine = WITHIN(TL_TABLE_ENCODER_MAX);
    t->encoder.sine2 = WITHIN(TL_TABLE_ENCODER_MAX / 2);
    t->encoder.cosine2 = WITHIN(TL_TABLE_ENCODER_MAX / 2);
    lookup.phase = Frama_C_unsigned_int_interval(0, 1U << 24);
    lookup.phase_rest = Frama_C_unsigned_int_interval(0, UINT16_MAX);
    t->sides.side = FROM(-1, 1);
    t->speed.time_us = FROM(0, 10000000);
    t->speed.held = FROM(0, 1);
    //@ loop unroll 17;
    for (unsigned i = 0; i <= TL_TABLE_LAST; i++) {
        t->sides.late[i] = FROM(0, 1 << 24);
        t->speed.extra[i] = FROM(0, 1 << 24);
    }
    //@ loop unroll 4;
    for (unsigned i = 0; i < TL_TABLE_LATE_MAX; i++) {
        t->late.time_us[i] = Frama_C_nondet(0, FROM(1000, 1000000000));
        t->late.gain_q16[i] = WITHIN((1 << 26) - 1);
    }
    t->load.reference = WITHIN(1 << 24);
    t->load.width = WITHIN(1 << 24);
    t->load.gain = WITHIN(1 << 24);
    t->load.offset = WITHIN(1 << 24);
    t->load.middle = WITHIN(TL_TABLE_VALUE_MAX);
    //@ loop unroll 3;
    for (unsigned i = 0; i < TL_TABLE_JOINTS; i++) {
        t->joints.axis[i] = FROM(0, (int32_t)TL_TABLE_AXES);
        t->joints.play[i] = FROM(0, 1 << 24);
        t->joints.slope[i] = WITHIN((1 << 26) - 1);
        t->before.slope_q20[i] = WITHIN((1 << 26) - 1);
    }
    t->adapt.offset = FROM(0, TL_TABLE_ADAPT_OFFSET_MAX);
    t->adapt.width_least_q15 = FROM(0, TL_RATIO_ONE);
    t->adapt.width_most_q15 = FROM(TL_RATIO_ONE, 2 * TL_RATIO_ONE);
    t->anew.rest_us = FROM(0, 10000000);
    t->pressed.sides_q16 = FROM(0, 2 << 16);
    t->pressed.speed_q16 = FROM(0, 2 << 16);
    lookup.follows_log2 = Frama_C_unsigned_int_interval(0, 4);
}

static void any_followers(void) {
    //@ loop unroll 4;
    for (unsigned i = 0; i < TL_TABLE_LATE_MAX; i++) {
        tl_follower_t *f = &undo.late[i];
        f->at = WITHIN(1 << 30);
        f->more = ANY_UNSIGNED();
        f->most = FROM(0, SHORT_MOST);
        f->share = (int16_t)WITHIN(2047);
        f->gain = (int16_t)WITHIN(2047);
        f->coarse = (uint8_t)Frama_C_nondet(0, 4);
        f->up = (uint8_t)FROM(1, 24);
        f->down = (uint8_t)FROM(12, 31);
        f->lead_down = (uint8_t)FROM(1, 16);
    }
}

static void any_undo(void) {
    any_moved();
    any_followers();
    undo.speed_q8 = WITHIN(MOST);
    undo.extra = FROM(0, 1 << 24);
    undo.speed_share_q16 = Frama_C_unsigned_int_interval(0, 65536);
    undo.rate_hz = FROM(16, 100000);
    undo.step_max = FROM(0, MOST / 16);
    undo.p = PLACE();
    undo.side = FROM(-1, 1);
    undo.turned_at = ANCHOR();
    undo.rest_ticks = ANY_UNSIGNED();
    undo.awaits = ANY_UNSIGNED();
    //@ loop unroll 3;
    for (unsigned i = 0; i < TL_TABLE_JOINTS; i++) {
        undo.carried[i] = ANY();
        undo.slope[i] = (tl_factor_t){(int16_t)WITHIN(2047), (uint8_t)FROM(0, 15), (bool)Frama_C_nondet(0, 1)};
    }
    undo.joined = ANY();
    undo.before = WITHIN(1 << 24);
    undo.wider = FROM(0, 1 << 24);
    undo.by = WITHIN(2 * TL_TABLE_POSITION_MAX);
    undo.caught = FROM(0, 1 << 24);
    undo.followed = FROM(0, 1 << 24);
    undo.follows_rest_q12 = FROM(0, 4095);
    undo.half = FROM(0, TL_TABLE_WIDTH_MAX / 2);
    undo.sides_q12 = FROM(0, 15 << 12);
    undo.joints = Frama_C_unsigned_int_interval(0, TL_TABLE_JOINTS);
}

static void shaft(void) {
    tl_undo_reading(&undo, &lookup, WITHIN(5 << 28));
    tl_undo_pushing(&undo, &lookup, WITHIN(5 << 28), TL_UNDO_ROUNDS);
}

int main(void) {
    any_table();
    any_moved();
    tl_undo_start(&undo, &lookup, Frama_C_unsigned_int_interval(16, 100000));
    any_undo();
    tl_undo_adapt(&undo, &lookup, ANY(), ANY(), ANY_UNSIGNED());
    any_undo();
    tl_undo_load(&undo, &lookup, ANY(), ANY_UNSIGNED());
    tl_undo_forget(&undo);
    //@ loop unroll 30;
    for (int32_t log2 = 0; log2 <= 22; log2++) {
        lookup.table.sides.step_log2 = lookup.table.speed.step_log2 = log2;
        any_undo();
        tl_undo_weigh(&undo, &lookup, ANY());
        any_undo();
        tl_undo_wider(&undo, &lookup, PLACE());
        tl_undo_tick(&undo, &lookup, PLACE());
    }
    any_undo();
    tl_undo_join(&undo, &lookup);
    tl_undo_angle(&undo, &lookup, ANY());
    tl_undo_late(&undo, PLACE());
    any_undo();
    tl_undo_turned(&undo, ANCHOR(), FROM(-1, 1));
    tl_undo_anew(&undo, Frama_C_nondet(0, 1), Frama_C_nondet(0, 1));
    tl_undo_scaled(&undo, WITHIN(MOST));
    tl_undo_rest(&undo, PLACE());
    shaft();
    return 0;
}
