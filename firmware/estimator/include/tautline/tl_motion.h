/// Calibration motion of one axis: back and forth on a ramp over the whole range (paper, III-B), each speed
/// out and back.
///
/// A pass goes from one end of the range to the other, with `cycles` turning points on the way. At each it
/// goes back until the onset of that reversal is confirmed, turns again and goes on until the onset of this
/// one is confirmed too; then it travels to the next turning point, at `transit` speed but for the last
/// `approach` before the turn. All else is at the pass's measuring speed, so image stop and image start are
/// seen at the same speed. After each onset the axis goes on by `approach` or more, so every reversal begins
/// on an envelope; before the first one it makes sure of that by a stroke of `stroke_max`. The turning points
/// are spread evenly between the pass's first onset and its far end, and those of the pass back lie so that
/// the middles of all strokes interleave over all of the range where B can be seen. A reversal with no onset
/// ends after `stroke_max` and the motion goes on.
///
/// Reversals: 4 cycles + 2 for each speed. Time, reference rig (10 mm, 0.35 mm/s, width 0.7 mm): 2.6 s a
/// reversal.
///
/// Use: tl_motion_start(), then tl_motion_tick() on every control tick; its output is the servo's reference.
/// Call tl_motion_onset() when a reversal of the detector has `started`, tl_motion_frame() for every frame of
/// the host: without frames for `host_timeout_us` the axis comes to rest and the state says
/// TL_MOTION_HOST_LOST. tl_motion_stop() at any time.
///
/// Limits: the position never leaves the range (or, begun outside it, what lies between start and range); the
/// speed is never above `transit`, its change never above `acceleration`; from any state it comes to rest
/// within v^2 / 2a.
///
/// Thread model: calls for one motion must not interrupt each other: make them in the control loop, or mask
/// it.
///
/// Cost of a tick: bounded; some ten 64-bit additions and at most ten 64-bit products; no division.
///
/// Memory: 190 bytes. Errors: tl_motion_start() refuses with a reason.
#ifndef TAUTLINE_TL_MOTION_H
#define TAUTLINE_TL_MOTION_H

#include "tautline/tl_fixed.h"

#ifdef __cplusplus
extern "C" {
#endif

#define TL_MOTION_SPEEDS 4 ///< measuring speeds, at most

typedef enum {
    TL_MOTION_IDLE = 0, ///< never started
    TL_MOTION_RUNNING,
    TL_MOTION_STOPPING,  ///< on its way to rest
    TL_MOTION_COMPLETE,  ///< at rest, all passes done
    TL_MOTION_STOPPED,   ///< at rest, by tl_motion_stop()
    TL_MOTION_HOST_LOST, ///< at rest, no frames came
} tl_motion_state_t;

typedef enum {
    TL_MOTION_OK = 0,
    TL_MOTION_BAD_RANGE,        ///< high - low must exceed 2 stroke_max; both, and the start, within +-4 M counts
    TL_MOTION_BAD_SPEED,        ///< 1 to TL_MOTION_SPEEDS speeds, each at least 1/4 count/s and at most transit
    TL_MOTION_BAD_ACCELERATION, ///< below resolution, or too small to stop from transit within stroke_max
    TL_MOTION_BAD_STROKE,       ///< approach at least 1 count, stroke_max at least 2 approach
    TL_MOTION_BAD_CYCLES,       ///< 1 to 100
    TL_MOTION_BAD_RATE,         ///< 1000 to 10000 Hz, transit at most 100 counts a tick
} tl_motion_error_t;

/// Lengths Q8 counts, speeds Q8 counts/s, acceleration Q8 counts/s^2.
typedef struct {
    tl_count_q8_t low, high;         ///< range to cover
    int32_t speed[TL_MOTION_SPEEDS]; ///< measuring speeds, a pass out and one back each
    uint8_t speed_count;
    uint8_t cycles;  ///< turning points of a pass
    int32_t transit; ///< speed of moves that measure nothing
    int32_t acceleration;
    tl_count_q8_t approach;   ///< travelled at measuring speed on the envelope before each turn
    tl_count_q8_t stroke_max; ///< a reversal without onset ends here; more than any backlash
    uint32_t host_timeout_us; ///< 0: never
    uint32_t rate_hz;         ///< of tl_motion_tick()
} tl_motion_config_t;

/// All zero: idle. Fields are the module's own. Positions counts Q32, speeds counts/tick Q32, all speeds
/// without sign.
typedef struct {
    tl_motion_config_t config;
    int64_t position;
    int64_t target;       ///< end of this leg
    int64_t began;        ///< where this leg began
    int64_t speed;        ///< along `direction`
    int64_t acceleration; ///< counts/tick^2 Q32
    int64_t transit;
    int64_t measuring[TL_MOTION_SPEEDS];
    int64_t first;            ///< where the first turning point of this pass could have been
    int64_t half_step;        ///< half the distance of this pass's turning points
    uint32_t half_step_share; ///< of the way from `first` to the far end, Q32
    uint32_t steps;           ///< ticks that braking takes: (steps - 1) acceleration < speed <= steps acceleration
    uint32_t measuring_steps[TL_MOTION_SPEEDS]; ///< the same at each measuring speed
    uint32_t quiet_ticks;                       ///< since the last frame
    uint32_t timeout_ticks;
    uint8_t pass, leg; ///< legs of a pass begin with a reversal; even ones go forward
    int8_t direction;  ///< of this leg
    uint8_t phase;
    uint8_t state, ends_as; ///< tl_motion_state_t, now and once at rest
} tl_motion_t;

/// The servo's reference of one tick.
typedef struct {
    tl_count_q8_t q;  ///< position, rounded; the generator itself keeps 32 fractional bits
    int32_t velocity; ///< feed-forward, Q8 counts/s
} tl_motion_reference_t;

/// Begins at rest at `q`, wherever that is; the first leg leads to the low end. On an error nothing changes.
/// The only call with 64-bit divisions.
tl_motion_error_t tl_motion_start(tl_motion_t *motion, const tl_motion_config_t *config, tl_count_q8_t q);

/// One control tick on. Also valid when not running: the reference rests. Before any start it is 0.
tl_motion_reference_t tl_motion_tick(tl_motion_t *motion);

/// The image has started after the reversal into `direction` (sign of dq). Ignored unless that is the
/// reversal under way: a late message does no harm.
void tl_motion_onset(tl_motion_t *motion, int8_t direction);

/// The host has sent a frame, with or without a marker.
void tl_motion_frame(tl_motion_t *motion);

/// Comes to rest within the limits, then TL_MOTION_STOPPED. Ignored unless running.
void tl_motion_stop(tl_motion_t *motion);

/// Where the motion is; TL_MOTION_IDLE before the first start.
tl_motion_state_t tl_motion_state(const tl_motion_t *motion);

/// 0 to 1000, never falls between two starts; 1000 only when complete.
uint16_t tl_motion_progress(const tl_motion_t *motion);

#ifdef __cplusplus
}
#endif

#endif
