/// What is seen and told of one axis once a millisecond.
#ifndef TAUTLINE_TL_AXIS_WATCH_H
#define TAUTLINE_TL_AXIS_WATCH_H

#include "tautline/tl_axis.h"

/// Forward play, encoder history, telemetry: after the step in which axis->slot came back to 0.
void tl_axis_watch(tl_axis_t *axis, tl_us_t now_us);

/// Where the axes are that its table names: they move this one's angle, or its motor before the play. The app's axes
/// lie in a row. The watch does it; before it for who begins with a table.
void tl_axis_join(tl_axis_t *axis);

/// tl_wire_flag_t now, and those that came within the last millisecond.
uint16_t tl_axis_flags(const tl_axis_t *axis);

#endif
