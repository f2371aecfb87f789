/// Whether an encoder still shows what its motor must be doing: a dropout at speed is told by the motor's momentum.
///
///     dv/dt = (duty - load - feed_forward v) / inertia
///
/// A motor of the gains' feed-forward and inertia is carried along and held to the encoder, which gives speed and load
/// (friction in it). From the last two counts on that went one way `least` goes alone, with less drive than there is:
/// by what a load may grow at once, and by as much as has lately sped the motor up or down, as the gains may be wrong.
/// Where it goes TL_SIGHT_MOST counts before it comes to rest, and the encoder has not shown two, the motor has met
/// something hard, or the encoder is lost. Of a motor that had come to rest it says nothing, nor where the gains have
/// no feed-forward or no inertia.
///
/// Once a millisecond; four 32-bit products. Control step only, but for tl_sight_configure().
#ifndef TAUTLINE_TL_SIGHT_H
#define TAUTLINE_TL_SIGHT_H

#include "tautline/tl_servo.h"

#define TL_SIGHT_MOST 6 ///< counts

/// Fields are the module's own.
typedef struct {
    int32_t gain;         ///< change of speed, counts/ms2 Q24, for a unit of duty
    int32_t feed;         ///< duty for a count/ms
    tl_duty_q15_t duty;   ///< since the last step
    tl_count_q8_t q;      ///< at the last step
    int32_t ahead;        ///< of the encoder, counts Q16
    int32_t speed;        ///< counts/ms Q16
    int32_t load;         ///< duty, with friction
    tl_count_q8_t seen_q; ///< where it has last gone two counts
    int32_t least;        ///< speed since then, at least,
    int32_t least_load;   ///< against this load,
    int32_t must;         ///< and the way that is, counts Q8
    int32_t doubt;        ///< duty
    int32_t unseen_ms;    ///< since the encoder has gone two counts, one way
} tl_sight_t;

/// Of a motor with these gains. Task; a division.
void tl_sight_configure(tl_sight_t *sight, const tl_servo_gains_t *gains);

/// It rests at `q`, at an unknown load.
void tl_sight_reset(tl_sight_t *sight, tl_count_q8_t q);

/// The motor is at `q`, and has `duty` from now on. False, once: it is lost.
bool tl_sight_step(tl_sight_t *sight, tl_count_q8_t q, tl_duty_q15_t duty);

#endif
