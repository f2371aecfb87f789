#include "tautline/tl_axis_step.h"

#include "tautline/tl_axis_plan.h"
#include "tautline/tl_axis_rest.h"
#include "tautline/tl_fast.h"

TL_FAST void tl_axis_step(tl_axis_t *axis) {
    if (!tl_actuator_measure(&axis->motor, &axis->q)) { // tl_axis_watch() clamps it
        tl_axis_fail(axis, TL_WIRE_FAULT_ENCODER, axis->motor.jump,
                     axis->port->time_us(axis->port->context)); // the position stays
    } else if (!axis->closed) {
        axis->path.q = axis->q;
        tl_actuator_push(&axis->motor, axis->q, axis->trial.duty);
    } else {
        if (axis->slot == 0U) {
            tl_path_begin(&axis->path, &axis->plan.reference);
            tl_actuator_begin(&axis->motor, &axis->path);
        }
        tl_path_tick(&axis->path);
        tl_actuator_set(&axis->motor, axis->q, &axis->path);
    }
    uint32_t job = axis->slot;
    const bool last = job + 1U == axis->ticks;
    axis->slot = last ? 0U : job + 1U;
    while (job < TL_AXIS_JOBS) {
        tl_axis_job(axis, job++);
        if (!last || TL_AXIS_TICKS_MIN >= TL_AXIS_JOBS) { // else all that are left: below 5 kHz there are fewer ticks
            break;
        }
    }
}

TL_FAST void tl_axis_catch_up(tl_axis_t *axis, uint32_t elapsed_us, tl_us_t now_us) {
    if (!tl_actuator_measure_late(&axis->motor, elapsed_us, &axis->q)) {
        tl_axis_fail(axis, TL_WIRE_FAULT_ENCODER, axis->motor.jump, now_us);
    }
}
