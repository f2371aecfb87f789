// Planning one axis: what its control step does once a millisecond, a job in a tick.
#include "tautline/tl_axis.h"

// What the host asks for.
void tl_axis_listen(tl_axis_t *axis) {
    axis->stream.now_us += 1000000U / TL_AXIS_PLAN_HZ; // tl_axis_watch() keeps it to the clock
    if (tl_axis_is_following(axis)) {
        const int32_t value = tl_stream_next(&axis->stream);
        if (axis->mode == TL_WIRE_MODE_FOLLOW_TIP) {
            axis->c_next = value;
        } else {
            axis->target = value;
        }
    }
}

static void come_to_rest(tl_axis_t *axis) {
    if (!tl_reference_brake(&axis->reference, &axis->travel)) {
        return;
    }
    tl_reference_set(&axis->reference, tl_reference_q(&axis->reference));
    if (!tl_path_rests(&axis->path)) {
        return; // a millisecond or two later
    }
    tl_axis_event(axis, TL_WIRE_EVENT_RESTED);
    if (axis->mode == TL_WIRE_MODE_STOPPING) {
        axis->mode = TL_WIRE_MODE_HOLD;
    } else {
        axis->mode = TL_WIRE_MODE_OFF;
        tl_axis_drive(axis, 0);
    }
}

void tl_axis_plan(tl_axis_t *axis) {
    const tl_reference_limits_t *limits = &axis->travel;
    tl_count_q8_t target = axis->target;
    switch (axis->mode) {
    case TL_WIRE_MODE_OFF:
        tl_axis_rest(axis);
        return;
    case TL_WIRE_MODE_STOPPING:
    case TL_WIRE_MODE_STOPPING_OFF:
        come_to_rest(axis);
        return;
    case TL_WIRE_MODE_HOLD:
        target = tl_reference_q(&axis->reference);
        break;
    case TL_WIRE_MODE_MOVE:
        limits = &axis->move;
        target = axis->move_target;
        break;
    default:
        break;
    }
    tl_reference_step(&axis->reference, target, limits);
    if (axis->mode == TL_WIRE_MODE_MOVE && tl_reference_rests_at(&axis->reference, target) && axis->path.q == target &&
        tl_path_rests(&axis->path)) {
        axis->mode = TL_WIRE_MODE_HOLD;
        tl_axis_event(axis, TL_WIRE_EVENT_ARRIVED);
    }
}
