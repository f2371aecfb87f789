/// Reference of one axis: follows a target within limits on speed and acceleration, and without lag where they allow
/// it.
///
/// Position and speed have 24 fractional bits (60 nano-counts), so that slow motion is smooth. Approaching a target it
/// brakes by the speed relative to the target's own, so that a moving target is caught up with, not trailed. A step has
/// no division and 32-bit products only; about 250 cycles on a Cortex-M0+ (-O2) at most. Control step only, but for
/// tl_reference_limits().
#ifndef TAUTLINE_TL_REFERENCE_H
#define TAUTLINE_TL_REFERENCE_H

#include "tautline/tl_fixed.h"

#define TL_REFERENCE_SPEED_MAX        (30000 * 256)   ///< Q8 counts/s
#define TL_REFERENCE_ACCELERATION_MIN (1000 * 256)    ///< Q8 counts/s2
#define TL_REFERENCE_ACCELERATION_MAX (4000000 * 256) ///< Q8 counts/s2; at 1 kHz four counts/tick2

typedef struct {
    int32_t speed;        ///< counts/tick Q24
    int32_t acceleration; ///< counts/tick2 Q24
    tl_count_q8_t stop;   ///< within which it stops from its greatest speed
    // For the distance that stopping takes: speeds in 15 bits, the distance in as many of Q16 as leave it below 2^31.
    uint32_t speed_down;         ///< bits that a speed loses
    int32_t acceleration_scaled; ///< without them
    uint32_t ratio, ratio_down;  ///< 1 / (2 acceleration) in such units: ratio / 2^(16 + ratio_down)
    uint32_t way_down;           ///< bits that a distance in Q16 loses
    int32_t whole_ticks;         ///< such a distance: what it takes more as a speed changes in ticks
} tl_reference_limits_t;

typedef struct {
    tl_count_q8_t q;
    uint32_t fraction;       ///< of q: 16 more bits
    int32_t velocity;        ///< counts/tick Q24
    tl_count_q8_t target;    ///< of the last step, within the range
    tl_count_q8_t low, high; ///< the range; wider than the limits in force only where it began outside
    bool clamped;            ///< the target was out of the range
    bool behind;             ///< more than one count from the target: the limits hold it back
} tl_reference_t;

/// Limits in ticks, from Q8 counts/s and counts/s2 (clamped to the ranges above). Task; 64-bit divisions.
tl_reference_limits_t tl_reference_limits(int32_t speed_q8_s, int32_t acceleration_q8_s2, uint32_t rate_hz);

/// Its `speed` alone, for a rate of up to 65535 Hz.
int32_t tl_reference_speed(int32_t speed_q8_s, uint32_t rate_hz);

/// At rest at `q`; the range stays.
void tl_reference_set(tl_reference_t *reference, tl_count_q8_t q);

/// One tick towards `target`, within the range: also a target that runs into an end at speed is left in time to stop
/// there. Where the limits have just been lowered, or the range, it brakes as fast as they allow. All positions within
/// +-4 M counts.
void tl_reference_step(tl_reference_t *reference, tl_count_q8_t target, const tl_reference_limits_t *limits);

/// One tick of coming to rest; true once it rests.
bool tl_reference_brake(tl_reference_t *reference, const tl_reference_limits_t *limits);

static inline tl_count_q8_t tl_reference_q(const tl_reference_t *reference) {
    return reference->q + (int32_t)(reference->fraction >> 15);
}

static inline bool tl_reference_rests_at(const tl_reference_t *reference, tl_count_q8_t q) {
    return reference->q == q && reference->fraction == 0U && reference->velocity == 0;
}

#endif
