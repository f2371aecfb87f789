/// What stops axes that are well themselves: the stop input, and the fault of another axis of their group. The app's
/// axes lie in a row.
#ifndef TAUTLINE_TL_STOP_H
#define TAUTLINE_TL_STOP_H

#include "tautline/tl_axis.h"

/// All axes, once a millisecond, in the control step. The stop input faults an axis whether it is driven or not.
void tl_stop_watch(tl_axis_t *axes, tl_us_t now_us);

/// Where this axis has a fault of its own: those of its group that are driven go off, too, and name it. Control step,
/// or the task under the port's lock.
void tl_stop_group(const tl_axis_t *axis, tl_us_t now_us);

/// Whether another axis of this one's group has a fault of its own. Control step, or the task under the port's lock.
bool tl_stop_group_has_fault(const tl_axis_t *axis);

/// Whether the stop input is active, as this axis has it wired. Likewise.
static inline bool tl_stop_is_pressed(const tl_axis_t *axis) {
    return axis->guard.estop_ms != 0;
}

#endif
