#include "tautline/tl_axis_watch.h"

#include "tautline/tl_fast.h"
#include "tautline/tl_stop.h"

#include <stdatomic.h>

TL_FAST uint16_t tl_axis_flags(const tl_axis_t *axis) {
    uint32_t flags = axis->noted;
    if (axis->mode == TL_WIRE_MODE_FOLLOW_TIP) {
        const uint32_t now = axis->tip.compensator.flags;
        flags |= TL_WIRE_FLAG_COMPENSATING;
        flags |= (now & (TL_COMPENSATOR_BELOW | TL_COMPENSATOR_ABOVE | TL_COMPENSATOR_CLIPPED)) != 0
                     ? TL_WIRE_FLAG_SATURATED_RANGE
                     : 0U;
        flags |= (now & (TL_COMPENSATOR_LIMITED | TL_COMPENSATOR_FLAT)) != 0 ? TL_WIRE_FLAG_SATURATED_SPEED : 0U;
        flags |= (now & TL_COMPENSATOR_TAKE_UP) != 0 ? TL_WIRE_FLAG_TAKE_UP : 0U;
    }
    flags |= axis->mode != TL_WIRE_MODE_OFF ? TL_WIRE_FLAG_ENABLED : 0U;
    flags |= axis->plan.reference.velocity == 0 && axis->trial.duty == 0 ? TL_WIRE_FLAG_AT_REST : 0U;
    flags |= axis->fault != TL_WIRE_FAULT_NONE ? TL_WIRE_FLAG_FAULT : 0U;
    flags |= axis->silent ? TL_WIRE_FLAG_SILENT : 0U;
    flags |= axis->referenced ? TL_WIRE_FLAG_REFERENCED : 0U;
    flags |= axis->checked ? TL_WIRE_FLAG_CHECKED : 0U;
    flags |= axis->guard.driver_ms != 0 ? TL_WIRE_FLAG_DRIVER_FAULT : 0U;
    flags |= tl_stop_is_pressed(axis) ? TL_WIRE_FLAG_ESTOP : 0U;
    return (uint16_t)flags;
}

#define PUSHING_ROUNDS                                                                                                 \
    2U // of tl_undo_pushing(): a fourth of the error of the steepest encoder is left, else next to none

static void note(tl_axis_t *axis) {
    uint32_t flags = 0;
    const uint8_t pushed = tl_actuator_pushed(&axis->motor);
    axis->guard.pushed = (uint8_t)(axis->guard.pushed | pushed);
    flags |= pushed != 0 ? TL_WIRE_FLAG_SATURATED_DUTY : 0U;
    if (axis->mode != TL_WIRE_MODE_OFF) {
        const tl_reference_t *reference = &axis->plan.reference;
        flags |= reference->clamped ? TL_WIRE_FLAG_SATURATED_RANGE : 0U;
        flags |= reference->behind && axis->mode != TL_WIRE_MODE_MOVE ? TL_WIRE_FLAG_SATURATED_SPEED : 0U;
    }
    axis->noted = (uint16_t)flags;
}

static void sample(tl_axis_t *axis, tl_us_t now_us) {
    tl_axis_telemetry_t *telemetry = &axis->telemetry;
    if (telemetry->divider == 0 || ++telemetry->skipped < telemetry->divider) {
        return;
    }
    telemetry->skipped = 0;
    if (telemetry->head - telemetry->tail == TL_AXIS_SAMPLES) {
        telemetry->dropped++;
        return;
    }
    tl_sample_t *into = &telemetry->samples[telemetry->head % TL_AXIS_SAMPLES];
    into->t_us = (uint32_t)now_us;
    into->q = axis->q;
    into->q_ref = axis->path.q;
    into->p = axis->has_table ? axis->tip.play.p : axis->q;
    into->c_ref = axis->tip.c_ref;
    into->c_est = axis->has_table ? tl_play_angle(&axis->tip.play) : 0;
    into->duty = (int16_t)tl_clamp(axis->motor.duty, INT16_MIN, INT16_MAX);
    into->flags = tl_axis_flags(axis);
    atomic_signal_fence(memory_order_release); // the sample is whole before the task can see it
    telemetry->head = telemetry->head + 1U;
}

TL_FAST void tl_axis_join(tl_axis_t *axis) {
    const tl_table_joints_t *joints = &axis->tip.lookup.table.joints;
    const tl_axis_t *first = axis - axis->index;
    for (uint32_t i = 0; i < TL_TABLE_JOINTS; i++) {
        const uint32_t other = (uint32_t)joints->axis[i] - 1U; // none: beyond all
        if (other < axis->port->axes) {
            axis->tip.compensator.undo.moved.joint[i] = first[other].q;
        }
    }
    tl_undo_join(&axis->tip.compensator.undo, &axis->tip.lookup);
}

// The play operator's result does not depend on how often it is stepped, but for a reversal's tip: 0.03 counts at
// 200 000 counts/s2. So is the error of the history, which joins its points by straight lines.
TL_FAST void tl_axis_watch(tl_axis_t *axis, tl_us_t now_us) {
    axis->q = tl_clamp(axis->q, -TL_TABLE_VALUE_MAX, TL_TABLE_VALUE_MAX); // a step adds 2000 counts at most
    if (axis->history != NULL) {
        tl_history_push(axis->history, now_us, axis->q);
    }
    if (axis->has_table) {
        const tl_lookup_t *lookup = &axis->tip.lookup;
        const tl_undo_t *undo = &axis->tip.compensator.undo;
        const bool undoes = lookup->table.has != 0;
        if (undoes) {
            tl_axis_join(axis);
        }
        const bool off = undoes || undo->active; // the encoder reads otherwise than the motor pushes
        tl_play_step(&axis->tip.play, off ? tl_undo_pushing(undo, lookup, axis->q, PUSHING_ROUNDS) : axis->q);
    }
    tl_axis_planned_t *plan = &axis->plan;
    plan->stream.now_us = now_us + plan->lead_us;
    axis->tip.c_ref = (plan->c_last[0] >> 1) + (plan->c_last[1] >> 1);
    plan->c_last[1] = plan->c_last[0];
    plan->c_last[0] = plan->c_next;
    note(axis);
    sample(axis, now_us);
}
