/// What the servo follows between two points of the reference: the reference is planned once a millisecond, the servo
/// asks on every tick.
///
/// The points r[k] are joined by the uniform quadratic B-spline through their midpoints: position and speed are
/// continuous, the acceleration is the plan's own, and the curve never leaves the points' range.
/// Each tick is the middle of its interval: 1/2 to ticks - 1/2 of a millisecond. A tick costs two sums; the beginning
/// of a millisecond three 32-bit products. Rounding is below 1/2048 count and does not add up. Control step only.
#ifndef TAUTLINE_TL_PATH_H
#define TAUTLINE_TL_PATH_H

#include "tautline/tl_reference.h"

/// Fields are the module's own, but `q`, `speed` and `bend` may be read.
typedef struct {
    tl_count_q8_t q;    ///< where the servo should be now, and, next, how fast
    int32_t speed;      ///< counts/tick Q24
    int32_t bend;       ///< change of speed a tick
    tl_count_q8_t base; ///< a position nearby
    int32_t offset;     ///< from it, counts Q24, and half of a Q8 count for rounding
    int32_t velocity;   ///< of the point at which the last millisecond began, counts/ms Q24
    uint32_t share;     ///< 1 / ticks of a millisecond, Q16
} tl_path_t;

/// At rest at `q`. ticks: of a millisecond, 1 to 10. Task; a 32-bit division.
void tl_path_init(tl_path_t *path, tl_count_q8_t q, uint32_t ticks);

/// At rest at `q`.
void tl_path_set(tl_path_t *path, tl_count_q8_t q);

/// A millisecond begins, and the reference has just been planned one point further.
void tl_path_begin(tl_path_t *path, const tl_reference_t *reference);

/// Whether it has come to rest where the reference rests.
static inline bool tl_path_rests(const tl_path_t *path) {
    return path->speed == 0 && path->bend == 0;
}

/// One tick.
static inline void tl_path_tick(tl_path_t *path) {
    path->offset += path->speed;
    path->speed += path->bend;
    path->q = path->base + (path->offset >> 16);
}

#endif
