/// What a board tells unasked: telemetry, events, and how a calibration goes. The task alone.
#ifndef TAUTLINE_TL_REPORT_H
#define TAUTLINE_TL_REPORT_H

#include "tautline/tl_state.h"

/// Events and samples of every axis that wait.
void tl_report_axes(tl_app_t *app, tl_us_t now_us);

/// Time-outs and the end of a calibration.
void tl_report_calibration(tl_app_t *app, tl_us_t now_us);

/// Takes in a frame's marker during a calibration: a tl_wire_reason_t, or 0.
uint8_t tl_report_marker(tl_app_t *app, const tl_wire_marker_t *marker, tl_us_t now_us);

#endif
