/// The control step of one axis.
#ifndef TAUTLINE_TL_AXIS_STEP_H
#define TAUTLINE_TL_AXIS_STEP_H

#include "tautline/tl_axis.h"

/// Reads the encoder, drives the motor. At port->control_hz.
void tl_axis_step(tl_axis_t *axis);

/// Takes in what the motor has moved while no step came, before the step that comes late: a flash that is erased lets
/// none through, and a motor that is off may be turned by hand meanwhile.
void tl_axis_catch_up(tl_axis_t *axis, uint32_t elapsed_us, tl_us_t now_us);

#endif
