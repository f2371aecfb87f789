/// Reference of one axis: follows a target within limits on speed and acceleration, and without lag where they allow it.
///
/// Position and speed keep 32 fractional bits, so that slow motion is smooth. Approaching a target it brakes by the speed
/// relative to the target's own, so that a moving target is caught up with, not trailed. No division in a step; at
/// most nine 32 x 32 -> 64 products, none while the target is followed exactly. Control step only, but for tl_reference_limits().
#ifndef TAUTLINE_TL_REFERENCE_H
#define TAUTLINE_TL_REFERENCE_H

#include "tautline/tl_fixed.h"

#define TL_REFERENCE_SPEED_MAX        (30000 * 256)    ///< Q8 counts/s
#define TL_REFERENCE_ACCELERATION_MIN (100 * 256)      ///< Q8 counts/s2
#define TL_REFERENCE_ACCELERATION_MAX (4000000 * 256)  ///< Q8 counts/s2

typedef struct {
    int64_t speed;         ///< counts/tick Q32
    int64_t acceleration;  ///< counts/tick2 Q32
    int64_t stop;          ///< counts Q32 within which it stops from its greatest speed
} tl_reference_limits_t;

typedef struct {
    int64_t position; ///< counts Q32
    int64_t velocity; ///< counts/tick Q32
    int64_t target;   ///< of the last step, counts Q32
    bool behind;      ///< more than one count from the target: the limits hold it back
} tl_reference_t;

/// Limits in ticks, from Q8 counts/s and counts/s2 (clamped to the ranges above). Task; 64-bit divisions.
tl_reference_limits_t tl_reference_limits(int32_t speed_q8_s, int32_t acceleration_q8_s2, uint32_t rate_hz);

/// At rest at `q`.
void tl_reference_set(tl_reference_t *reference, tl_count_q8_t q);

/// One tick towards `target`, within [low, high]: also a target that runs into an end at speed is left in time to stop
/// there. Where the limits have just been lowered, or the range, it brakes as fast as they allow.
void tl_reference_step(tl_reference_t *reference, tl_count_q8_t target, tl_count_q8_t low, tl_count_q8_t high,
                       const tl_reference_limits_t *limits);

/// One tick of coming to rest; true once it rests.
bool tl_reference_brake(tl_reference_t *reference, const tl_reference_limits_t *limits);

static inline tl_count_q8_t tl_reference_q(const tl_reference_t *reference) {
    return (tl_count_q8_t)((reference->position + (1 << 23)) >> 24);
}

/// Speed, Q8 counts/s.
static inline int32_t tl_reference_speed(const tl_reference_t *reference, uint32_t rate_hz) {
    return ((int32_t)(reference->velocity >> 16) * (int32_t)rate_hz) >> 8;
}

#endif
