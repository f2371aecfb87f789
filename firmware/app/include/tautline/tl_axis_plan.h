/// The plan of one axis: a job in each tick of a millisecond, TL_AXIS_JOBS of them. Control step.
#ifndef TAUTLINE_TL_AXIS_PLAN_H
#define TAUTLINE_TL_AXIS_PLAN_H

#include "tautline/tl_axis.h"

/// The first: set-points in. The last: reference out. Those between are the compensator's, or the calibration motion's.
void tl_axis_listen(tl_axis_t *axis);
void tl_axis_plan(tl_axis_t *axis);

static inline void tl_axis_job(tl_axis_t *axis, uint32_t job) {
    const bool tip = axis->mode == TL_WIRE_MODE_FOLLOW_TIP;
    switch (job) {
    case 0U:
        tl_axis_listen(axis);
        if (tip && axis->tip.compensator.undoes) {
            tl_compensator_hear(&axis->tip.compensator, axis->plan.c_next);
        }
        break;
    case 1U:
        if (tip) {
            tl_compensator_feed(&axis->tip.compensator, axis->plan.c_next);
        }
        break;
    case 2U:
        if (tip) {
            tl_compensator_turn(&axis->tip.compensator);
        }
        break;
    case 3U:
        if (tip) {
            axis->plan.target = tl_compensator_take_up(&axis->tip.compensator);
        } else if (axis->mode == TL_WIRE_MODE_CALIBRATE) {
            axis->plan.target = tl_motion_tick(axis->plan.motion).q;
        }
        break;
    default:
        if (tip && axis->tip.compensator.undoes) {
            axis->plan.target = tl_compensator_reach(&axis->tip.compensator);
        }
        tl_axis_plan(axis);
        break;
    }
}

#endif
