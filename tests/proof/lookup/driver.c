#include "__fc_builtin.h"

#include "../contracts.h"

#include "tl_ratio.h"

/*@ requires 0 < whole < 0x80000000; assigns \result \from whole; ensures \result <= 0xFFFF; */
static inline uint32_t tl_ratio_of(uint32_t whole); // proof ratio

#include "../../../firmware/estimator/src/tl_lookup.c"

#define ANY() Frama_C_int_interval(INT32_MIN, INT32_MAX)
#define NODE() Frama_C_int_interval(-TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX)

static tl_lookup_t lookup;
static uint32_t flags;

static void ask(void) {
    tl_lookup_width(&lookup, ANY(), &flags);
    tl_lookup_angle(&lookup, ANY(), &flags);
    tl_lookup_is_flat(&lookup, ANY());
}

static void ask_back(void) {
    tl_lookup_angle_inverse(&lookup, ANY(), &flags);
    tl_lookup_p_low(&lookup, ANY(), ANY(), &flags);
    tl_lookup_p_high(&lookup, ANY(), ANY(), &flags);
}

// As derive() leaves it: every grid that tl_table_check lets through, what its nodes hold, and behind them what no angle reaches.
static void of(unsigned nodes, unsigned log2, int32_t turn) {
    const uint32_t last = nodes - 1U;
    if (((uint64_t)last << log2) > 2ULL * (uint64_t)TL_TABLE_VALUE_MAX) {
        return;
    }
    const int32_t extent = (int32_t)(last << log2);
    lookup.table.nodes = (uint16_t)nodes;
    lookup.turn = turn;
    lookup.step_log2 = log2;
    lookup.extent = (uint32_t)extent;
    lookup.q0 = Frama_C_int_interval(-TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX - extent);
    lookup.angle_first = NODE();
    lookup.angle_last = NODE();
    lookup.low_first = NODE();
    lookup.low_last = NODE();
    lookup.high_first = NODE();
    lookup.high_last = NODE();
    ask();
    ask_back();
}

static void grids(int32_t turn) {
    //@ loop unroll 300;
    for (unsigned i = 0; i < TL_TABLE_NODES_MAX; i++) {
        lookup.table.angle[i] = INT32_MAX ^ turn;
        lookup.table.width[i] = 0;
    }
    lookup.table.angle[0] = NODE();
    lookup.table.width[0] = Frama_C_int_interval(0, TL_TABLE_VALUE_MAX);
    //@ loop unroll 300;
    for (unsigned nodes = 2; nodes <= TL_TABLE_NODES_MAX; nodes++) {
        lookup.table.angle[nodes - 1U] = NODE();
        lookup.table.width[nodes - 1U] = Frama_C_int_interval(0, TL_TABLE_VALUE_MAX);
        //@ loop unroll 30;
        for (unsigned log2 = 0; log2 <= TL_TABLE_STEP_LOG2_MAX; log2++) {
            of(nodes, log2, turn);
        }
    }
}

int main(void) {
    Frama_C_make_unknown((char *)lookup.ratio, sizeof lookup.ratio);
    lookup.flat_below = Frama_C_unsigned_int_interval(0, UINT32_MAX);
    grids(0);
    grids(-1);
    return 0;
}
