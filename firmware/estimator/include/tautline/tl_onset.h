/// Onset detector of one axis: the width of the backlash at each reversal, from marker samples and the
/// encoder history.
///
/// After a reversal at motor position q1 the image stands still until the backlash is crossed at q2; the
/// width there is B((q1 + q2) / 2) = |q2 - q1| (paper, eq. 1). Both edges are knots of the image position as
/// a function of the motor position at scene time (arrival - t_delay), not of time, so the motion needs no
/// constant speed:
///
/// - image stop: where the line of the approach meets the level. Beyond q1 it lies by speed times what
/// t_delay is wrong.
/// - image start: level, then level + slope (q - q2): the least-squares hinge, to a fraction of a frame.
///
/// The slope is a vector in the image; nothing is assumed about its direction. Noise is estimated in place:
/// the stated one serves until a still image was seen. Where the image jumps at the onset by more than it
/// moves in a frame, the two frames around the jump bracket q2. A marker that is elsewhere for a single frame
/// is left out; so a frame is judged when the next one comes.
///
/// An onset is confirmed when the generalised likelihood ratio of hinge against standstill, noise unknown,
/// passes `threshold`. The reversal is finished when its sigma is `sigma_wanted`, or `frames_max` frames were
/// seen after the knot, or more frames would cost more by the curvature of the image's path than they gain;
/// and still so a frame later.
///
/// Accuracy: 1.0 to 1.1 times the Cramer-Rao bound of unknown level, slope and knot, from 40 down to 0.3
/// sigma of slope a frame; the stated sigma covers 68 and 95 % where it says so, and wider where curvature is
/// allowed for but not there.
///
/// Use: tl_onset_sample() for every frame, also for those without a marker; tl_onset_poll() at 10 Hz or
/// faster, for time-outs when no frames come. Each returns true when a reversal is finished and `*onset` was
/// written.
///
/// Thread model: all calls for one detector from one thread, below the control loop; that only pushes the
/// history.
///
/// Memory: 1.7 kB for each axis.
///
/// Cost: bounded for every call, and all of it integers. It walks the history since the last frame (an entry
/// a millisecond, at most 500) and the last `frames_max` + 2 samples once, at five knots: some 16 000
/// instructions on a 64-bit machine; near a confirmation every knot, up to four times, and 30 64-bit
/// divisions a knot where the hinge fits badly.
///
/// Errors: a reason in the result. No call fails.
#ifndef TAUTLINE_TL_ONSET_H
#define TAUTLINE_TL_ONSET_H

#include "tautline/tl_history.h"

#ifdef __cplusplus
extern "C" {
#endif

#ifndef TL_ONSET_WINDOW
#define TL_ONSET_WINDOW 64 ///< samples that are kept: those that may still hold the knot, and the approach
#endif
#if TL_ONSET_WINDOW < 40 || TL_ONSET_WINDOW > 64
#error "TL_ONSET_WINDOW must be 40 to 64: fewer hide slow onsets, more overflow the 64-bit sums"
#endif
#define TL_ONSET_APPROACH 16 ///< samples before a turn that the line of the approach is made of, at most

#define TL_ONSET_UNKNOWN INT32_MAX ///< in tl_onset_t: not measured

typedef enum {
    TL_ONSET_USED = 0,
    TL_ONSET_NOT_ON_ENVELOPE, ///< the image did not move before the turn: the backlash was not entered from
                              ///< its edge
    TL_ONSET_NO_START,        ///< the stroke ended before the image moved: width is a lower bound
    TL_ONSET_OTHER_MOTION,    ///< another degree of freedom moved during the reversal
    TL_ONSET_MARKER_LOST,     ///< the marker was away for longer than lost_us during the reversal
    TL_ONSET_TIMED_OUT,       ///< neither an onset nor a turn within timeout_us
    TL_ONSET_TOO_FEW_SAMPLES, ///< fewer than two frames on the level, or than frames_min after the knot
    TL_ONSET_SLOPE_TOO_SMALL, ///< the image moves too little for its noise (near the straight pose): sigma >
                              ///< sigma_usable
} tl_onset_reason_t;

/// One reversal. Positions and widths in Q8 counts; a sigma is one standard deviation.
typedef struct {
    tl_us_t turn_us;          ///< when the motor turned
    tl_us_t start_us;         ///< scene time of the image start; turn_us without one
    tl_count_q8_t q1;         ///< where the motor turned
    tl_count_q8_t q2;         ///< image start, TL_ONSET_UNKNOWN without one
    tl_count_q8_t width;      ///< |q2 - q1|; with TL_ONSET_NO_START the lower bound; else TL_ONSET_UNKNOWN
    tl_count_q8_t sigma;      ///< of width, TL_ONSET_UNKNOWN without an image start
    tl_count_q8_t stop;       ///< how far beyond q1, along the approach, the image stopped; TL_ONSET_UNKNOWN
    tl_count_q8_t sigma_stop; ///< of stop, TL_ONSET_UNKNOWN
    int32_t speed_stop;       ///< |dq/dt| on the approach, Q8 counts/s: stop / speed_stop is true - nominal t_delay
    int32_t speed_start;      ///< |dq/dt| across the image start, Q8 counts/s
    int32_t slope;            ///< |d(image)/dq| after the start, px Q12 for 256 counts
    tl_px_q12_t noise;        ///< of the marker, each coordinate, as measured so far
    int8_t direction;         ///< sign of dq after the turn
    uint8_t reason;           ///< tl_onset_reason_t; TL_ONSET_USED: it counts
    bool started;             ///< the image was seen to start: the tip follows again, the stroke may end
    uint16_t frames;          ///< valid samples between the turn and the end of the reversal
} tl_onset_t;

/// One frame's marker.
typedef struct {
    tl_us_t arrival_us; ///< when the frame arrived, board time; must rise, else the sample is ignored
    tl_px_q12_t u, v;   ///< image position, within +-4096 px
    tl_px_q12_t sigma;  ///< its stated standard deviation, each coordinate; 0: not stated, noise_px is taken
    bool valid;         ///< false: the frame came, the marker was not found
    bool other_motion;  ///< translation or rotation moved, or the scene did: this reversal does not count
} tl_marker_t;

/// tl_onset_defaults() fills it in; speeds and lengths there suit the reference rig (0.001 mm a count, 25
/// Hz).
typedef struct {
    uint32_t delay_us;          ///< nominal t_delay, 0 to 400000; 80000
    uint32_t guard_us;          ///< t_delay's uncertainty: frames this close after a turn are in neither line; 20000
    uint32_t lost_us;           ///< a marker away for longer spoils the reversal; 400000
    uint32_t timeout_us;        ///< longest time from a turn to its onset; 30000000
    tl_count_q8_t turn;         ///< a retreat from the extreme by this much is a turn; 4 counts
    tl_count_q8_t sigma_wanted; ///< an onset as good as this is finished; 1.5 counts
    tl_count_q8_t sigma_usable; ///< one worse than this is not used; 25 counts
    tl_px_q12_t noise_px;       ///< marker noise to begin with where a sample states none; 0.1 px
    uint32_t curvature;         ///< relative change of slope along the path, 1/2^20 for a count; 400 is 0.38/mm at 1 um
    uint16_t threshold;         ///< likelihood ratio (2 ln) that confirms, Q4; 24: fewer than 1e-4 false alarms in
                                ///< 200 frames
    uint8_t frames_min;         ///< fewest frames after the knot, 3 or more; 4
    uint8_t frames_max;         ///< frames after the knot that end a reversal in any case, < TL_ONSET_WINDOW - 1; 32
} tl_onset_config_t;

typedef struct {
    tl_count_q8_t q; ///< at scene time
    tl_px_q12_t u, v;
    uint32_t t_us;  ///< scene time, low word
    int32_t weight; ///< 16 (noise_px / sigma)^2, 1 to 64
} tl_onset_sample_t;

/// Weighted sums of a straight line, image position over motor position. Positions from the reversal's
/// references.
typedef struct {
    int64_t w, x, xx, u, v, xu, xv, yy;
    int32_t n;
} tl_onset_sums_t;

/// Fields are the module's own, but `ignored`, `lost` and `missed` may be read as counters. Small and often used ones
/// come first: near offsets take less code on a Cortex-M0+.
typedef struct {
    int8_t direction; ///< of the motor, 0 until it has moved
    uint8_t phase;
    uint8_t oldest, held; ///< ring of samples
    uint8_t known;        ///< how many of `waiting` and `believed` are there; 3: the latter may be an outlier itself
    bool placed;          ///< `extreme` and `opposite` hold a position
    bool on_envelope;     ///< an image start was seen since the last turn: the tip follows
    bool entered;         ///< the reversal under way began on an envelope
    bool settled;         ///< the last frame had nothing to wait for
    bool told;            ///< this call has written a reversal
    bool noise_measured;  ///< no longer the stated one
    int32_t noise_dof;
    int64_t noise_sum;      ///< weighted squared residuals, Q16 px^2
    tl_us_t arrival_us;     ///< of the last frame
    tl_us_t scanned_us;     ///< the motor's turns are known up to here
    tl_us_t seen_us;        ///< scene time of the last valid sample
    tl_us_t extreme_us;     ///< when the motor was last at `extreme`
    tl_count_q8_t extreme;  ///< farthest position along `direction`
    tl_count_q8_t opposite; ///< before the first direction is known: the other end of where the motor was
    tl_px_q12_t reference_u, reference_v;
    int32_t approach_scale;
    tl_count_q8_t approach_span;
    uint32_t ignored;         ///< frames whose time did not rise
    uint32_t lost;            ///< frames without a marker, outliers, or older than the history
    uint32_t missed;          ///< reversals too short to be seen at all
    tl_onset_sums_t all;      ///< image of every sample of this reversal, the oldest ones fading; no x
    tl_onset_sums_t approach; ///< the line before the turn, x in 2^approach_scale Q8 counts from q1
    tl_onset_t reversal;      ///< the one under way: what the turn and the approach gave
    tl_onset_config_t config;
    tl_onset_sample_t waiting;  ///< the last one: the next tells whether it is an outlier
    tl_onset_sample_t believed; ///< the one before it that was none, or may be one
    tl_onset_sample_t window[TL_ONSET_WINDOW];
} tl_onset_detector_t;

/// A configuration that tl_onset_init() takes: the reference rig's.
tl_onset_config_t tl_onset_defaults(void);

/// Forgets everything; false, and the detector is unusable, if a field of `config` is out of its range.
bool tl_onset_init(tl_onset_detector_t *detector, const tl_onset_config_t *config);

/// Takes in one frame. True: a reversal is finished, `*onset` says how.
bool tl_onset_sample(tl_onset_detector_t *detector, const tl_history_t *history, const tl_marker_t *marker,
                     tl_onset_t *onset);

/// Ends a reversal whose time is out or whose frames no longer come. True as above.
bool tl_onset_poll(tl_onset_detector_t *detector, const tl_history_t *history, tl_us_t now_us, tl_onset_t *onset);

#ifdef __cplusplus
}
#endif

#endif
