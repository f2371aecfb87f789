/// What a table's sections 2 to 11 undo (tl_table.h) beside the play and the curve, at each place of the inverse
///
///     c* -> joints, load -> f^-1 -> late -> p* -> B(p*) by load, speed, side -> offset, joints, encoder -> q*
///
/// and how the table may be moved while it is in use: an offset and a scale of B go to where they are told along a
/// straight line of time, at most half a count a tick, so that nothing jumps. A load is told and followed in the same
/// way.
///
/// The compensator calls what is below, once a tick each, where its table has any of these sections or was moved.
/// O(1); no division and no 64-bit product but in tl_undo_start(), tl_undo_adapt() and tl_undo_load(), which are the
/// task's. On a Cortex-M0+ at most 165 cycles for the angle and 375 for what is late, before p*; 360 for what is
/// pressed, 175 for what is added to the width and 100 to scale it, 25 for whether a side begins, 200 for what is
/// handed out, 275 for the tick; and 300 once a millisecond for other axes. Memory: 252 bytes.
#ifndef TAUTLINE_TL_UNDO_H
#define TAUTLINE_TL_UNDO_H

#include "tautline/tl_lookup.h"

#ifdef __cplusplus
extern "C" {
#endif

/// A value on its straight way to another.
typedef struct {
    int32_t now, goal, step;
} tl_ramp_t;

/// How a table is moved while it is used, by the host and by the load; all zero: not at all.
typedef struct {
    tl_ramp_t offset;                     ///< counts Q16: the motor pushes as if it were so much further on
    tl_ramp_t scale;                      ///< of B, less 1, Q23
    tl_ramp_t gain;                       ///< of the angle's distance from load.middle, less 1, Q23
    int32_t adapt_offset, adapt_scale;    ///< the host's share of their goals,
    int32_t load_offset, load_scale;      ///< and the load's
    tl_count_q8_t joint[TL_TABLE_JOINTS]; ///< where the other axes of section 7 are
} tl_moved_t;

/// A factor of 11 bits and a sign: value * 2^log2.
typedef struct {
    int16_t value;
    uint8_t log2;
    bool before; ///< of another axis: it moves the motor before the play
} tl_factor_t;

/// What follows p in first order, and leads it: Q8 with 32 bits more. Rests are taken `coarse` bits shorter where the
/// time is long, and no longer than `most`.
typedef struct {
    int32_t at;
    uint32_t more;
    int32_t most;
    int16_t share, gain; ///< of the rest, by 2^-down and 2^-lead_down
    uint8_t coarse, up, down, lead_down;
} tl_follower_t;

typedef struct {
    bool active; ///< there is anything to undo
    tl_moved_t moved;
    tl_follower_t late[TL_TABLE_LATE_MAX];
    int32_t speed_q8; ///< of p, filtered, counts/s
    int32_t extra;    ///< width at that speed,
    int32_t wider;    ///< and what of it there is at this place
    uint32_t speed_share_q16;
    int32_t rate_hz, step_max; ///< Q8 counts a tick that are a speed still
    tl_count_q8_t p;           ///< of the last tick
    tl_count_q8_t by;          ///< and how far it went in that
    int32_t side;              ///< that the motor pushes on since it last turned
    tl_count_q8_t turned_at;   ///< where p turned, or went on after a rest, as far as section 10 has moved that
    int32_t caught;            ///< by so much less is that side late since,
    int32_t followed;          ///< which has moved turned_at as far as to here,
    int32_t follows_rest_q12;  ///< but for this part of a Q8 count
    int32_t half;              ///< B / 2 where that was last,
    int32_t sides_q12;         ///< and the part of what is late that is there at this place
    uint32_t rest_ticks;       ///< that p has to rest for the side to begin anew; 0: it never does
    uint32_t awaits;           ///< of these, how many are still to come
    tl_count_q8_t carried[TL_TABLE_JOINTS]; ///< where other axes have carried the tip,
    tl_factor_t slope[TL_TABLE_JOINTS];     ///< by so much for each count: deg Q28, or counts before the play Q20,
    uint32_t joints;                        ///< and the last that section 7 names
    tl_deg_q16_t joined;                    ///< what all of them come to behind the play,
    tl_count_q8_t before;                   ///< and before it
} tl_undo_t;

/// Begins, with `moved` as it is at the end of its way. tl_undo_rest(): the tip rests at p.
void tl_undo_start(tl_undo_t *undo, const tl_lookup_t *lookup, uint32_t rate_hz);
void tl_undo_rest(tl_undo_t *undo, tl_count_q8_t p);

/// The table is to be moved by `offset` (Q8 counts), and its width scaled, within `ticks`; it takes longer where that
/// were more than half a count a tick. 0: at once, for a compensator that does not run. False: section 8 does not allow
/// that much (without one nothing), and all stays as it was.
bool tl_undo_adapt(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t offset, int32_t scale_q15, uint32_t ticks);

/// Back to the table as it was calibrated, at once: the compensator does not run. The load stays.
void tl_undo_forget(tl_undo_t *undo);

/// The load is `load`, mNm Q8, within `ticks` or longer. Without section 6 nothing happens.
void tl_undo_load(tl_undo_t *undo, const tl_lookup_t *lookup, int32_t load, uint32_t ticks);

/// The tick of the ramps, and of the speed: p has moved to `p` since the last.
void tl_undo_tick(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p);

/// Other axes have moved: `moved.joint` says where they are. Once a millisecond or more often, after the start, whether
/// the compensator undoes or not: what they move before the play the forward play has to know.
void tl_undo_join(tl_undo_t *undo, const tl_lookup_t *lookup);

/// The angle that f has to give for c.
tl_deg_q16_t tl_undo_angle(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_deg_q16_t c);

/// Where p has to be for the tip to be where p would have it, were nothing late.
tl_count_q8_t tl_undo_late(tl_undo_t *undo, tl_count_q8_t p);

/// p has turned at `p` and now goes to `side`.
void tl_undo_turned(tl_undo_t *undo, tl_count_q8_t p, int32_t side);

/// The tick of a side's rest. goes_on: p is further towards its side than it ever was since it turned; still: the motor
/// has nothing to take up, else what is taken up may yet move the tip. True: it goes on after a rest so long that the
/// side begins anew, as tl_undo_turned() then says. Slower than 1/256 count in that time is rest.
bool tl_undo_anew(tl_undo_t *undo, bool goes_on, bool still);

/// Once a tick before tl_undo_wider(): how much of that there is where p will then be.
void tl_undo_weigh(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p);

/// What is to be added to the width at p on the side that pushes.
int32_t tl_undo_wider(tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t p);

/// A width as it now is.
int32_t tl_undo_scaled(const tl_undo_t *undo, int32_t width);

/// What the encoder has to read for the motor to push as from q.
tl_count_q8_t tl_undo_reading(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t q);

/// As from where it pushes: the forward play's q. The error of the encoder's error falls by its slope, 1/2 at most,
/// with each of so many rounds; TL_UNDO_ROUNDS are within 0.1 % of it.
#define TL_UNDO_ROUNDS 10U
tl_count_q8_t tl_undo_pushing(const tl_undo_t *undo, const tl_lookup_t *lookup, tl_count_q8_t reading, uint32_t rounds);

#ifdef __cplusplus
}
#endif

#endif
