#include "tautline/tl_axis_plan.h"

#include "tautline/tl_axis_rest.h"
#include "tautline/tl_fast.h"

TL_FAST void tl_axis_listen(tl_axis_t *axis) {
    tl_axis_planned_t *plan = &axis->plan;
    plan->stream.now_us += 1000000U / TL_AXIS_PLAN_HZ; // tl_axis_watch() keeps it to the clock
    if (tl_axis_is_following(axis)) {
        const int32_t value = tl_stream_next(&plan->stream);
        if (axis->mode == TL_WIRE_MODE_FOLLOW_TIP) {
            plan->c_next = value;
        } else {
            plan->target = value;
        }
    }
}

static void come_to_rest(tl_axis_t *axis) {
    tl_reference_t *reference = &axis->plan.reference;
    if (!tl_reference_brake(reference, &axis->plan.travel)) {
        return;
    }
    tl_reference_set(reference, tl_reference_q(reference));
    if (!tl_path_rests(&axis->path)) {
        return; // a millisecond or two later
    }
    tl_axis_event(axis, TL_WIRE_EVENT_RESTED);
    if (axis->mode == TL_WIRE_MODE_STOPPING) {
        tl_axis_enter(axis, TL_WIRE_MODE_HOLD);
    } else {
        tl_axis_off(axis);
    }
}

TL_FAST void tl_axis_plan(tl_axis_t *axis) {
    tl_axis_planned_t *plan = &axis->plan;
    const tl_reference_limits_t *limits = &plan->travel;
    tl_count_q8_t target = plan->target;
    const uint8_t mode = axis->mode;
    if (!axis->closed) {
        tl_axis_settle(axis);
        return;
    }
    if (mode == TL_WIRE_MODE_STOPPING || mode == TL_WIRE_MODE_STOPPING_OFF) {
        come_to_rest(axis);
        return;
    }
    if (mode == TL_WIRE_MODE_HOLD) {
        target = tl_reference_q(&plan->reference);
    } else if (mode == TL_WIRE_MODE_MOVE || mode == TL_WIRE_MODE_HOME) { // tl_axis_guard() leads, and sees it arrive
        limits = &plan->move;
        target = plan->move_target;
    }
    tl_reference_step(&plan->reference, target, limits);
}
