/// What an axis must notice by itself, once a millisecond; each is a fault unless said otherwise.
///
/// - current: its mean over 20 ms above the limit; the driver's fault line low, or the supply below its limit, for some
///   milliseconds of driving;
/// - following: reference and position too far apart;
/// - stall: drive or current at its limit for stall_ms and hardly a motion;
/// - oscillation: the drive goes from one limit to the other, again and again;
/// - the sender, or the host, silent: comes to rest (tl_axis_silence());
/// - a move has arrived where the motor is at its target and rests, whatever the reference says: no fault.
///
/// Check and homing are moved on here, too. A check pushes the motor either way at low drive, open loop: it turns
/// against the encoder, not at all, or at another speed than the feed-forward gain says. Homing leads the reference a
/// little ahead of the motor until it stalls at low drive: there is the end.
#ifndef TAUTLINE_TL_AXIS_GUARD_H
#define TAUTLINE_TL_AXIS_GUARD_H

#include "tautline/tl_axis.h"

/// Control step, at another tick than tl_axis_watch().
void tl_axis_guard(tl_axis_t *axis, tl_us_t now_us);

/// A check of an axis that is off begins. Task; a division.
void tl_axis_start_check(tl_axis_t *axis);

#endif
