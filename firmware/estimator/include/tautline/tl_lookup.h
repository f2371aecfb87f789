/// A loaded table: B(p), f(p) and their inverses, ready for the control loop.
///
/// Loading checks the blob and derives from it one small reciprocal per span of f, so that a step needs no division and
/// no 64-bit product. An inverse looks for its span among the nodes, takes a first estimate by the reciprocal (11 bits)
/// and mends it by what is then left (20 bits). All functions are pure but tl_lookup_load(); any number of readers may
/// share a loaded table. To change tables, load into another tl_lookup_t and hand the control loop its pointer.
///
/// Memory: 4.8 kB each, owned by the caller, no pointers inside. Cost on a Cortex-M0+ (-O2, no wait states): width and
/// angle 65 to 95 cycles, f's and Y's inverse 150, an envelope's 340, whatever the input. Loading takes 4 ms at most at
/// 125 MHz, 7 ms with several plays.
///
/// Every function takes any int32_t and saturates. `flags` (never NULL) is ORed with TL_LOOKUP_BELOW or
/// TL_LOOKUP_ABOVE where the argument was outside the grid, else left alone.
#ifndef TAUTLINE_TL_LOOKUP_H
#define TAUTLINE_TL_LOOKUP_H

#include "tautline/tl_table.h"

#ifdef __cplusplus
extern "C" {
#endif

#define TL_LOOKUP_BELOW 1U ///< the result belongs to the lower end of the grid (in p)
#define TL_LOOKUP_ABOVE 2U ///< the result belongs to the upper end of the grid (in p)

#define TL_LOOKUP_SPANS 256U

/// One of several plays that share B (tl_elements.h), in Y's unit.
typedef struct {
    int32_t half;        ///< r: half its width
    int32_t lag_most;    ///< rho: half the width of the play on Y that undoes it
    uint16_t weight_q16; ///< w: its share of the motion
    uint16_t undo;       ///< -v: how much of that play's lag the inverse is ahead, as undo * 2^(undo_log2 - 16)
    uint32_t undo_log2;
} tl_element_t;

/// Y goes on beyond the grid as the width there says, for so many Q8 counts and so much of Y.
typedef struct {
    tl_scale_t per_count, per_period;
    uint32_t counts, centre;
} tl_lookup_end_t;

typedef struct {
    // Read in every step: at the front, where one instruction reaches them.
    tl_count_q8_t q0;
    uint32_t step_log2;
    uint32_t extent;     ///< of the grid, Q8 counts; 0 without nodes
    int32_t turn;        ///< -1 where f falls, else 0: x ^ -1 reverses the order without overflow
    int32_t angle_first; ///< f ^ turn at the first and the last node
    int32_t angle_last;
    uint32_t has_flat;                                        ///< some spans are flatter than the stated slope:
    uint32_t flat_below;                                      ///< f changes by less across them
    tl_count_q8_t low_first, low_last, high_first, high_last; ///< where q meets the ends of both envelopes
    tl_deg_q16_t c_low;                                       ///< least and greatest f over [q_min, q_max]
    tl_deg_q16_t c_high;
    uint32_t plays;       ///< elements of the play; 0: one, without a warp
    tl_count_q8_t narrow; ///< where B is less there is one all the same
    int32_t half;         ///< half a period of Y
    tl_scale_t coarse;    ///< |dc/dq| of the coarse kinematics
    tl_scale_t coarse_inverse;
    tl_table_t table;                       ///< `angle` goes on after the last node with what no angle reaches
    uint32_t phase;                         ///< a Q8 count's share of a turn, Q32 (here: `ratio` is 8-byte aligned)
    uint16_t ratio[TL_LOOKUP_SPANS];        ///< 1 / rise of f in each span (tl_lookup.c)
    uint16_t centre_ratio[TL_LOOKUP_SPANS]; ///< the same of Y; `table.centre` goes on as `table.angle` does
    tl_element_t element[TL_TABLE_PLAYS_MAX];
    tl_lookup_end_t end[2]; ///< beyond the first and the last node
    uint32_t phase_rest;    ///< of `phase`, 16 bits more
    // Of section 10:
    tl_scale_t per_mean_q14; ///< of B: what it is of the mean
    uint32_t follows_log2;   ///< a tick goes 2^-follows_log2 of the way that a side's turn is moved (tl_undo.c)
} tl_lookup_t;

/// Decodes, checks and derives. On any reason but TL_TABLE_OK `lookup` must not be used.
tl_table_reason_t tl_lookup_load(tl_lookup_t *lookup, const uint8_t *blob, size_t size, uint8_t axis);

/// The same from a decoded table, which may be lookup->table itself.
tl_table_reason_t tl_lookup_derive(tl_lookup_t *lookup, const tl_table_t *table, uint8_t axis);

/// B(p), held beyond the grid's ends; 0 without nodes.
tl_count_q8_t tl_lookup_width(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags);

/// f(p), held beyond the grid's ends; the coarse kinematics without nodes.
tl_deg_q16_t tl_lookup_angle(const tl_lookup_t *lookup, tl_count_q8_t p, uint32_t *flags);

/// p with f(p) = c, at the grid's end where c is beyond f's range. Within 1/128 count of the exact solution, or 2^-19
/// of a step where that is more.
tl_count_q8_t tl_lookup_angle_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags);

/// p with p + B(p)/2 = q (p_lo), and with p - B(p)/2 = q (p_hi): unique while |B'| < 2. Beyond the grid B is
/// held. As exact. `near` is where p may be, say the last one, and changes nothing but the cost: in its span no other
/// is looked at.
tl_count_q8_t tl_lookup_p_low(const tl_lookup_t *lookup, tl_count_q8_t q, tl_count_q8_t near, uint32_t *flags);
tl_count_q8_t tl_lookup_p_high(const tl_lookup_t *lookup, tl_count_q8_t q, tl_count_q8_t near, uint32_t *flags);

/// Y(p), the middle of the elements' warp, and its inverse; beyond the grid they go on as B held there says. For
/// lookup->plays > 0. As exact.
int32_t tl_lookup_centre(const tl_lookup_t *lookup, tl_count_q8_t p);
tl_count_q8_t tl_lookup_centre_inverse(const tl_lookup_t *lookup, int32_t y);

/// The coarse kinematics and its inverse: a line, held beyond [q_min, q_max].
tl_deg_q16_t tl_lookup_coarse(const tl_lookup_t *lookup, tl_count_q8_t q, uint32_t *flags);
tl_count_q8_t tl_lookup_coarse_inverse(const tl_lookup_t *lookup, tl_deg_q16_t c, uint32_t *flags);

/// Whether p lies in a span that must be crossed at the table's flat speed. O(1).
static inline TL_FAST bool tl_lookup_is_flat(const tl_lookup_t *lookup, tl_count_q8_t p) {
    const uint32_t offset = (uint32_t)p - (uint32_t)lookup->q0;
    if (offset >= lookup->extent) {
        return false;
    }
    const tl_deg_q16_t *node = lookup->table.angle + (offset >> lookup->step_log2);
    const int32_t turn = lookup->turn;
    return (uint32_t)(((node[1] - node[0]) ^ turn) - turn) < lookup->flat_below; // its size: f rises, or falls
}

#ifdef __cplusplus
}
#endif

#endif
