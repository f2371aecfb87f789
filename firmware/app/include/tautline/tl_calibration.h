/// A calibration motion under way: generator, encoder history and onset detector of the one axis that calibrates.
#ifndef TAUTLINE_TL_CALIBRATION_H
#define TAUTLINE_TL_CALIBRATION_H

#include "tautline/tl_axis.h"
#include "tautline/tl_onset.h"

/// What a calibration needs while it runs, from tl_calibration_start() until tl_calibration_ended() has said so.
typedef struct {
    tl_motion_t motion;
    tl_history_t history;
    tl_onset_detector_t detector;
} tl_calibration_work_t;

typedef struct {
    tl_axis_t *axis; ///< NULL: none
    bool host_lost;  ///< it ends for that reason
    uint16_t reversals;
    tl_calibration_work_t work; ///< lost also by a start that is refused
} tl_calibration_t;

/// Why `request` cannot be, or 0 when the axis has begun to move. Task, not under the lock; 64-bit divisions.
uint8_t tl_calibration_start(tl_calibration_t *calibration, tl_axis_t *axis, const tl_wire_motion_start_t *request);

/// A frame has come, whatever it shows: the host is there. Under the lock.
void tl_calibration_frame(tl_calibration_t *calibration);

/// A finished reversal turns the motion round. Under the lock.
void tl_calibration_turn(tl_calibration_t *calibration, const tl_onset_t *onset);

/// Takes in a frame; true when that finishes a reversal and `*onset` is written. Task, not under the lock.
bool tl_calibration_marker(tl_calibration_t *calibration, const tl_wire_marker_t *marker, tl_onset_t *onset);

/// Time-outs. As above; call every millisecond or so.
bool tl_calibration_poll(tl_calibration_t *calibration, tl_us_t now_us, tl_onset_t *onset);

/// Whether it has ended since the last call; then *state says how and the axis holds, or has failed. Under the lock.
bool tl_calibration_ended(tl_calibration_t *calibration, tl_us_t now_us, uint8_t *state);

/// Comes to rest; `host_lost` makes that a fault. Under the lock.
void tl_calibration_stop(tl_calibration_t *calibration, bool host_lost);

void tl_calibration_onset_message(const tl_calibration_t *calibration, const tl_onset_t *onset,
                                  tl_wire_onset_t *message);
void tl_calibration_progress_message(const tl_calibration_t *calibration, const tl_axis_t *axis, uint8_t state,
                                     tl_us_t now_us, tl_wire_progress_t *message);

#endif
