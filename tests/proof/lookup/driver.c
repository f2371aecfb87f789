#include "__fc_builtin.h"

#include "../../../firmware/estimator/include/tautline/tl_lookup.h"

#include "tl_ratio.h"

/*@ requires 0 < whole < 0x80000000; assigns \result \from whole; ensures \result <= 0xFFFF; */
static inline uint32_t tl_ratio_of(uint32_t whole); // proof ratio

/*@ requires x < 0x80000000; requires -32 < ratio.shift < 32;
    assigns \result \from x, ratio; ensures \result < 0x80000000; */
static inline uint32_t tl_scale(uint32_t x, tl_scale_t ratio); // proof fixed; that the result fits is its caller's

#include "../../../common/src/tl_fixed.c"
#include "../../../firmware/estimator/src/tl_lookup.c"

#define ANY()   Frama_C_int_interval(INT32_MIN, INT32_MAX)
#define NODE()  Frama_C_int_interval(-TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX)
#define PLACE() Frama_C_int_interval(-TL_TABLE_POSITION_MAX, TL_TABLE_POSITION_MAX)

static tl_lookup_t lookup;
static uint32_t flags;

static tl_scale_t any_scale(void) {
    return (tl_scale_t){.mantissa = Frama_C_unsigned_int_interval(0x80000000U, UINT32_MAX),
                        .shift = (int8_t)Frama_C_int_interval(-31, 31)};
}

static void ask(void) {
    tl_lookup_width(&lookup, ANY(), &flags);
    tl_lookup_angle(&lookup, ANY(), &flags);
    tl_lookup_is_flat(&lookup, ANY());
    tl_lookup_angle_inverse(&lookup, ANY(), &flags);
    tl_lookup_p_low(&lookup, ANY(), ANY(), &flags);
    tl_lookup_p_high(&lookup, ANY(), ANY(), &flags);
    tl_lookup_centre(&lookup, ANY());
    tl_lookup_centre_inverse(&lookup, ANY());
    tl_lookup_coarse(&lookup, ANY(), &flags);
    tl_lookup_coarse_inverse(&lookup, ANY(), &flags);
}

// A grid with this step, of each number of nodes that fits, as derive() leaves it.
static void of(unsigned log2, int32_t turn) {
    const uint32_t most = (uint32_t)(2ULL * TL_TABLE_POSITION_MAX >> log2), last = TL_TABLE_NODES_MAX - 1U;
    lookup.table.nodes = (uint16_t)Frama_C_unsigned_int_interval(2U, (most < last ? most : last) + 1U);
    lookup.extent = (lookup.table.nodes - 1U) << log2;
    lookup.step_log2 = log2;
    lookup.turn = turn;
    lookup.q0 = PLACE();
    ask();
}

int main(void) {
    //@ loop unroll 300;
    for (unsigned i = 0; i < TL_TABLE_NODES_MAX; i++) {
        lookup.table.angle[i] = NODE();
        lookup.table.centre[i] = Frama_C_int_interval(-TL_TABLE_CENTRE_MAX, TL_TABLE_CENTRE_MAX);
        lookup.table.width[i] = Frama_C_int_interval(0, TL_TABLE_WIDTH_MAX);
    }
    Frama_C_make_unknown((char *)lookup.ratio, sizeof lookup.ratio);
    Frama_C_make_unknown((char *)lookup.centre_ratio, sizeof lookup.centre_ratio);
    lookup.flat_below = Frama_C_unsigned_int_interval(0, UINT32_MAX);
    lookup.angle_first = NODE();
    lookup.angle_last = NODE();
    lookup.low_first = NODE();
    lookup.low_last = NODE();
    lookup.high_first = NODE();
    lookup.high_last = NODE();
    lookup.table.q_min = PLACE();
    lookup.table.q_max = PLACE();
    lookup.table.coarse_c_min = NODE();
    lookup.table.coarse_c_max = NODE();
    lookup.coarse = lookup.coarse_inverse = any_scale();
    for (unsigned i = 0; i < 2U; i++) {
        lookup.end[i] = (tl_lookup_end_t){.per_count = any_scale(),
                                          .per_period = any_scale(),
                                          .counts = Frama_C_unsigned_int_interval(0, 1U << 29),
                                          .centre = Frama_C_unsigned_int_interval(0, 1U << 29)};
    }
    //@ loop unroll 30;
    for (unsigned log2 = 0; log2 <= TL_TABLE_STEP_LOG2_MAX; log2++) {
        of(log2, 0);
        of(log2, -1);
    }
    return 0;
}
