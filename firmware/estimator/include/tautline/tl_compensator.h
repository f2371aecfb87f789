/// The inverse with take-up: where the motor must be for the instrument to be at c*.
///
///     p* = f^-1(c*),   q* = p* + s k B(p*) / 2 - e      (eqs. 4 and 5 with p as the state)
///
/// s is the side of the backlash the motor pushes from: +1 once p* rises, -1 once it falls, unchanged at rest. Until
/// the first motion it is 0, and the motor stays where in the backlash it was. k is the strength, 0..1. e is what is
/// still to be taken up: whatever would make q* jump (a reversal, a change of strength, mode or table, starting away
/// from the command) goes into e, and e returns to zero along a trapezoid within the table's take-up speed and
/// acceleration. So q* never jumps, and the feed itself is never delayed: while e is not zero the motor moves by the
/// feed plus the take-up.
///
/// Rising and falling are those of p*, whatever the sign of f'. s changes only after p* has turned back by more
/// than the table's band, so a command that jitters by less never crosses the backlash.
///
/// A table of several plays (tl_table.h, section 1) gives the inverse of their mean instead of s k B / 2: what p* is to
/// be, undone play by play. There the feed is steeper than p* after a reversal, up to 1 / w_1 times; what of that is
/// faster than the take-up, and the jump of the first element, is taken up. Within the band all elements stay.
///
/// What the table's further sections name (tl_undo.h) is undone in TL_MODE_FULL: before f^-1 and behind it, in the
/// width, which the strength then scales with what is added to it, and in what is handed out: the inside of the
/// compensator knows where the motor pushes from, its callers what the encoder reads.
///
/// Use: load a table, tl_compensator_start() with the motor's position when the axis is switched on, then
/// tl_compensator_step() once a control tick, 1 to 10 kHz. All other functions are called between steps from
/// the same context. To stop, hold c*; to follow the motor while the axis is free, start again.
/// Faults: none is fatal. Every input is valid; what could not be done is in `flags`.
///
/// A step: at most about 930 cycles on a Cortex-M0+ (-O2, no wait states), in three parts of 320, 290 and 320; with
/// seven plays the second is 560 and the third 800; all sections add up to 1200, 560 of them before and 320 behind. No
/// division, no 64-bit product, 64-bit sums only. Memory: 488 bytes, plus the table that it points to.
#ifndef TAUTLINE_TL_COMPENSATOR_H
#define TAUTLINE_TL_COMPENSATOR_H

#include "tautline/tl_play.h"
#include "tautline/tl_undo.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    TL_MODE_OFF = 0,      ///< uncompensated: p* from the coarse kinematics, no width
    TL_MODE_BACKLASH = 1, ///< p* from the coarse kinematics, width from the table
    TL_MODE_FULL = 2,     ///< p* from f, width from the table
} tl_mode_t;

/// State of the last step.
#define TL_COMPENSATOR_BELOW   1U  ///< c* is beyond the table's range, at its lower end in p: saturated
#define TL_COMPENSATOR_ABOVE   2U  ///< ... at its upper end in p
#define TL_COMPENSATOR_CLIPPED 4U  ///< the motor would have had to leave [q_min, q_max]: saturated
#define TL_COMPENSATOR_TAKE_UP 8U  ///< e is not zero: the take-up is under way
#define TL_COMPENSATOR_LIMITED 16U ///< the feed is held back by speed_max: p lags behind c*
#define TL_COMPENSATOR_FLAT    32U ///< the feed crosses a flat span at the flat speed
#define TL_COMPENSATOR_NO_SIDE 64U ///< no motion yet: the side of the backlash is not known

/// A motor speed per tick: whole Q8 counts, and a fraction in 2^-32 of one. 0.1 count/s at 10 kHz is 0.0026 a tick.
typedef struct {
    int32_t whole;
    uint32_t fraction;
} tl_per_tick_t;

/// A distance in q on its way to zero along a trapezoid. "Q36": Q8 counts with 28 more bits, for what is added up tick
/// by tick.
typedef struct {
    int32_t heading;   ///< +1 or -1: the direction of the motion, in q
    int64_t ahead_q36; ///< what is left in that direction; below 0 once a moved goal has been passed
    int64_t spare_q36; ///< what of it is not needed for stopping
    int64_t speed_q36; ///< per tick, a whole number of times accel
    int64_t accel_q36; ///< per tick^2
    int64_t speed_max_q36;
    int64_t next_accel_q36; ///< limits that are adopted at the next rest
    int64_t next_speed_max_q36;
    uint32_t limits_pending;
} tl_takeup_t;

typedef struct {
    const tl_lookup_t *lookup;     ///< must outlive the compensator or the next set_table
    tl_count_q8_t low, high, band; ///< the table's q_min, q_max and band
    bool several;                  ///< the table has several plays
    bool by_curve;                 ///< in TL_MODE_FULL, with nothing but the play and the curve to undo
    bool undoes;                   ///< it has further sections or was moved, and the mode is for them
    bool moved;                    ///< and p has moved them in this tick
    uint32_t flags;                ///< of the last whole tick
    uint32_t feed_flags;           ///< of its first part
    uint32_t mode;                 ///< tl_mode_t
    uint32_t strength_q15;         ///< k
    int32_t side;                  ///< s
    int32_t half;                  ///< k B(p*) / 2; of several plays s times their offset, below 0 after a reversal
    int32_t start_offset; ///< q - p* at the start: where the motor stays while s is 0, as far as it is within the width
    tl_deg_q16_t c;       ///< the last command
    tl_count_q8_t p;      ///< p*, after limits
    tl_count_q8_t goal;   ///< p* without limits on the feed
    tl_count_q8_t aim;    ///< how far of the way there this tick may go, if the speed allows
    bool slow;            ///< this tick goes at the flat speed
    tl_count_q8_t anchor; ///< furthest p in the direction of `side`
    tl_count_q8_t q;      ///< q*, the last output
    uint32_t feed_fraction; ///< part of a Q8 count that a limited feed has saved up
    tl_per_tick_t feed_max;
    tl_per_tick_t feed_flat;
    tl_takeup_t takeup; ///< e
    uint32_t rate_hz;
    // Of several plays:
    bool turns;                       ///< p has turned in this tick
    int32_t offset;                   ///< q* - p* - e, before the strength
    int32_t centre;                   ///< Y(p*)
    int32_t apart;                    ///< x - y
    int32_t lags[TL_TABLE_PLAYS_MAX]; ///< lags behind y of the plays that undo them
    int32_t step_max;                 ///< Q8 counts a tick at the take-up's speed
    // Of further sections:
    tl_deg_q16_t angle;    ///< that f has to give for the last command
    int32_t wider;         ///< what they add to half the width on this side
    tl_count_q8_t reading; ///< q* as the encoder is to read it, where there is anything to undo
    tl_undo_t undo;
} tl_compensator_t;

/// Switches on: the motor is at `q` and stays there in this tick; what is missing to the backlash around the command
/// `c` is taken up within limits. Strength comes from the table. rate_hz: control ticks per second, 16 to 100000. Five
/// divisions.
void tl_compensator_start(tl_compensator_t *compensator, const tl_lookup_t *lookup, uint32_t rate_hz, tl_mode_t mode,
                          tl_count_q8_t q, tl_deg_q16_t c);

/// The same where the table was moved before, and is so still.
void tl_compensator_start_moved(tl_compensator_t *compensator, const tl_lookup_t *lookup, uint32_t rate_hz,
                                tl_mode_t mode, tl_count_q8_t q, tl_deg_q16_t c, const tl_moved_t *moved);

/// After tl_compensator_start(): where the forward play knows the elements of several plays to be, which p and q alone
/// do not tell after a turn within the backlash. Nothing for another table, or for one play.
void tl_compensator_know(tl_compensator_t *compensator, const tl_play_t *play);

/// One tick: the motor position to go to for the command c*. O(1), bounded, no division.
tl_count_q8_t tl_compensator_step(tl_compensator_t *compensator, tl_deg_q16_t c);

/// Its parts, for a controller that spreads them over time: in this order, the other functions anywhere between.
void tl_compensator_feed(tl_compensator_t *compensator, tl_deg_q16_t c); ///< p*
void tl_compensator_turn(tl_compensator_t *compensator);                 ///< B(p*) and the side
tl_count_q8_t tl_compensator_take_up(tl_compensator_t *compensator);     ///< e and q*

/// Where compensator->undoes two more, before the first and after the last: what f has to give for the command, and q*
/// as the encoder is to read it.
void tl_compensator_hear(tl_compensator_t *compensator, tl_deg_q16_t c);
tl_count_q8_t tl_compensator_reach(tl_compensator_t *compensator);

/// Changes that never move the output by themselves; what they change is taken up from the next step on.
void tl_compensator_set_mode(tl_compensator_t *compensator, tl_mode_t mode);
void tl_compensator_set_strength(tl_compensator_t *compensator, int32_t strength_q15); ///< clamped to 0..1
/// Another table for the same axis; the strength stays. Five divisions. The limits of its take-up hold once the take-up
/// that is under way has come to rest (it brakes at once).
void tl_compensator_set_table(tl_compensator_t *compensator, const tl_lookup_t *lookup);

/// tl_undo_adapt() and tl_undo_load(), of a compensator that has been started.
bool tl_compensator_adapt(tl_compensator_t *compensator, tl_count_q8_t offset, int32_t scale_q15, uint32_t ticks);
void tl_compensator_load(tl_compensator_t *compensator, int32_t load, uint32_t ticks);

/// What is still to be taken up, Q8 counts, signed as in q* = ... - e.
tl_count_q8_t tl_compensator_rest(const tl_compensator_t *compensator);

#ifdef __cplusplus
}
#endif

#endif
