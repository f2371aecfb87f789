/// Encoder history of one axis: where the motor was at any time within the last half second.
///
/// A frame arrives t_delay after the scene that it shows, so the motor position that belongs to it lies in
/// the past. tl_history_push() is called by the control loop on each of its ticks, at 1 kHz or faster;
/// positions are kept at whole milliseconds since the first push (linearly interpolated where the tick rate
/// is no multiple of 1 kHz) and read back with linear interpolation between milliseconds.
///
/// Thread model: one writer, any readers. The writer may interrupt a reader (a timer interrupt on the same
/// core), never the other way round. Nothing blocks. For a reader on another core, hold the control loop's
/// lock around it.
///
/// Memory: 2.1 kB for each axis. Errors: a status, never an invented position.
#ifndef TAUTLINE_TL_HISTORY_H
#define TAUTLINE_TL_HISTORY_H

#include "tautline/tl_fixed.h"

#ifdef __cplusplus
extern "C" {
#endif

#define TL_HISTORY_STEP_US 1000U ///< spacing of what is kept
#define TL_HISTORY_SPAN_MS 500U  ///< readable into the past from the newest push
#define TL_HISTORY_SIZE    512U  ///< ring entries; the rest keeps a reader from being overtaken for 10 ms
#define TL_HISTORY_GAP_MS  16U   ///< a longer pause between two pushes starts the history afresh

typedef enum {
    TL_HISTORY_OK = 0,
    TL_HISTORY_NOT_YET, ///< later than the newest whole millisecond, or nothing was pushed at all
    TL_HISTORY_TOO_OLD, ///< before the oldest that is kept (or before the pause that started it afresh)
} tl_history_status_t;

/// Fields are the module's own.
typedef struct {
    tl_count_q8_t q[TL_HISTORY_SIZE];
    tl_us_t grid_us;   ///< time of the newest ring entry
    tl_us_t pushed_us; ///< time of the newest push
    tl_count_q8_t pushed_q;
    uint32_t kept;           ///< entries that may be read, at most TL_HISTORY_SPAN_MS + 2
    volatile uint32_t count; ///< ring entries written; its change tells a reader that a push came between
} tl_history_t;

/// Empties the history. Not while a push or a read is under way.
void tl_history_init(tl_history_t *history);

/// Notes that the motor is at `q` at `t_us`. Times must rise: a push that does not is ignored; after a pause
/// longer than TL_HISTORY_GAP_MS everything before is forgotten. Cost: a few compares; at each whole
/// millisecond one store, and two 32-bit divisions where `t_us` is not whole; at most TL_HISTORY_GAP_MS of
/// those after a pause. No 64-bit product.
void tl_history_push(tl_history_t *history, tl_us_t t_us, tl_count_q8_t q);

/// The motor's position at `t_us`, rounded to 1/256 count, into `*q` (untouched unless TL_HISTORY_OK).
/// Cost: O(1), four 32-bit divisions at most, no 64-bit product.
tl_history_status_t tl_history_at(const tl_history_t *history, tl_us_t t_us, tl_count_q8_t *q);

#ifdef __cplusplus
}
#endif

#endif
