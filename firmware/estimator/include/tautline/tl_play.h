/// The play operator, forward: where the instrument is, given where the motor is.
///
///     p[k] = min(max(p[k-1], p_lo(q)), p_hi(q)),   c = f(p),   p_lo + B(p_lo)/2 = q,   p_hi - B(p_hi)/2 = q
///
/// p is the play's centre coordinate in motor space (the paper's eq. 3 with its inequalities put right).
/// A table of several plays gives the mean of its elements on the warp Y instead (tl_table.h, section 1); full strokes
/// lie on the same two envelopes.
/// Call tl_play_step() on every encoder sample; samples may be any distance apart as long as the motor did not
/// turn back between them. O(1): two compares inside the backlash, one inverse on an envelope, at most
/// 520 cycles on a Cortex-M0+, 1200 with seven elements; no division. Memory: 64 bytes. Not for use by two threads at
/// once.
#ifndef TAUTLINE_TL_PLAY_H
#define TAUTLINE_TL_PLAY_H

#include "tautline/tl_lookup.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    const tl_lookup_t *lookup; ///< must outlive the play
    tl_count_q8_t p;
    uint32_t width; ///< B(p), a shade less: nearer than half of it the motor moves nothing
    uint32_t flags; ///< TL_LOOKUP_BELOW, TL_LOOKUP_ABOVE: p is beyond the table's grid
    // Of several elements:
    tl_count_q8_t q;                 ///< where the motor was
    tl_count_q8_t single;            ///< p of a single play
    int32_t motor;                   ///< x, the motor in the warp
    int32_t lag[TL_TABLE_PLAYS_MAX]; ///< of each element behind it
} tl_play_t;

/// Starts with the instrument at `p`: the motor's position if nothing better is known. Start again after the table has
/// changed.
void tl_play_start(tl_play_t *play, const tl_lookup_t *lookup, tl_count_q8_t p);

/// The motor is at q: returns p.
tl_count_q8_t tl_play_step(tl_play_t *play, tl_count_q8_t q);

/// f(p) of the last step: the configuration. About 40 cycles.
tl_deg_q16_t tl_play_angle(const tl_play_t *play);

#ifdef __cplusplus
}
#endif

#endif
