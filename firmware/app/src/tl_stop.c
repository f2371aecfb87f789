#include "tautline/tl_stop.h"

#include "tautline/tl_axis_rest.h"
#include "tautline/tl_fast.h"

#define ESTOP_MS 3U // a contact that bounces, or a disturbance, is shorter

static inline bool of_one_group(const tl_axis_t *axis, const tl_axis_t *other) {
    return other != axis && axis->settings.group != 0 && other->settings.group == axis->settings.group;
}

// One that went off with its group names the first; the others name that one, too.
static inline bool has_own_fault(const tl_axis_t *axis) {
    return axis->fault != TL_WIRE_FAULT_NONE && axis->fault != TL_WIRE_FAULT_GROUP;
}

TL_FAST void tl_stop_group(const tl_axis_t *axis, tl_us_t now_us) {
    const uint8_t group = axis->settings.group;
    if (group == 0 || !has_own_fault(axis)) {
        return;
    }
    // Where a hold ended for want of a host, one that holds lets go slowly, too: it may bear a load yet.
    const bool sinks = axis->fault == TL_WIRE_FAULT_HOST_LOST && axis->guard.sink != 0;
    tl_axis_t *other = (tl_axis_t *)axis - axis->index;
    for (const tl_axis_t *end = other + axis->port->axes; other != end; other++) {
        if (other->settings.group != group || other == axis || other->mode == TL_WIRE_MODE_OFF) {
            continue;
        }
        if (sinks && other->mode == TL_WIRE_MODE_HOLD) {
            other->guard.alone_ms = TL_AXIS_LET_GO;
        } else {
            tl_axis_fail(other, TL_WIRE_FAULT_GROUP, axis->index, now_us);
        }
    }
}

TL_FAST bool tl_stop_group_has_fault(const tl_axis_t *axis) {
    const tl_axis_t *other = axis - axis->index;
    for (uint8_t i = 0; i < axis->port->axes; i++, other++) {
        if (of_one_group(axis, other) && has_own_fault(other)) {
            return true;
        }
    }
    return false;
}

static void watch_input(tl_axis_t *axis, bool closed, tl_us_t now_us) {
    const bool stops = closed != (axis->settings.estop == TL_WIRE_ESTOP_OPEN);
    const uint8_t ms = axis->guard.estop_ms;
    axis->guard.estop_ms = (uint8_t)(!stops ? 0U : ms < ESTOP_MS ? ms + 1U : ESTOP_MS);
    if (axis->guard.estop_ms == ESTOP_MS && axis->fault == TL_WIRE_FAULT_NONE) {
        tl_axis_fail(axis, TL_WIRE_FAULT_ESTOP, 0, now_us);
    }
}

TL_FAST void tl_stop_watch(tl_axis_t *axes, tl_us_t now_us) {
    const tl_port_t *port = axes->port;
    const tl_axis_t *const end = axes + port->axes;
    if (port->estop_closed != NULL) {
        const bool closed = port->estop_closed(port->context);
        for (tl_axis_t *axis = axes; axis != end; axis++) {
            watch_input(axis, closed, now_us);
        }
    }
    for (tl_axis_t *axis = axes; axis != end; axis++) {
        tl_stop_group(axis, now_us);
    }
}
