// The control step of one axis. A port puts this file, and all that it reaches, where no flash is read.
#include "tautline/tl_axis.h"

#define ENCODER_JUMP 2048U // counts in one step: above any motor's speed, below a glitch's

void tl_axis_fail(tl_axis_t *axis, tl_wire_fault_t fault, tl_us_t now_us) {
    tl_axis_drive(axis, 0);
    axis->mode = TL_WIRE_MODE_OFF;
    axis->stream.used = 0;
    axis->motion = NULL;
    if (axis->fault == TL_WIRE_FAULT_NONE) {
        axis->fault = (uint8_t)fault;
        axis->fault_us = now_us;
        tl_axis_event(axis, TL_WIRE_EVENT_FAULT);
    }
}

void tl_axis_stop(tl_axis_t *axis, bool then_off) {
    if (axis->mode == TL_WIRE_MODE_OFF || (axis->mode == TL_WIRE_MODE_HOLD && !then_off)) {
        return;
    }
    axis->stream.used = 0;
    axis->motion = NULL;
    axis->mode = then_off ? TL_WIRE_MODE_STOPPING_OFF : TL_WIRE_MODE_STOPPING;
}

void tl_axis_silence(tl_axis_t *axis) {
    if (tl_axis_is_following(axis)) {
        tl_axis_stop(axis, false);
        axis->silent = true;
        tl_axis_event(axis, TL_WIRE_EVENT_SILENT);
    }
}

void tl_axis_rest(tl_axis_t *axis) {
    axis->target = axis->q;
    tl_reference_set(&axis->reference, axis->q);
    tl_path_set(&axis->path, axis->q);
}

// -- on every tick ----------------------------------------------------------------------------------------------

static inline void do_job(tl_axis_t *axis, uint32_t job) {
    const bool tip = axis->mode == TL_WIRE_MODE_FOLLOW_TIP;
    switch (job) {
    case 0U:
        tl_axis_listen(axis);
        break;
    case 1U:
        if (tip) {
            tl_compensator_feed(&axis->compensator, axis->c_next);
        }
        break;
    case 2U:
        if (tip) {
            tl_compensator_turn(&axis->compensator);
        }
        break;
    case 3U:
        if (tip) {
            axis->target = tl_compensator_take_up(&axis->compensator);
        } else if (axis->mode == TL_WIRE_MODE_CALIBRATE) {
            axis->target = tl_motion_tick(axis->motion).q;
        }
        break;
    default:
        tl_axis_plan(axis);
        break;
    }
}

void tl_axis_step(tl_axis_t *axis) {
    const tl_port_t *port = axis->port;
    const int32_t encoder = port->encoder(port->context, axis->index);
    const int32_t moved = (int32_t)((uint32_t)encoder - (uint32_t)axis->encoder);
    axis->encoder = encoder;
    if ((uint32_t)moved + ENCODER_JUMP >= 2U * ENCODER_JUMP) {
        tl_axis_fail(axis, TL_WIRE_FAULT_ENCODER, port->time_us(port->context)); // the position stays where it was
    } else {
        axis->q += moved * TL_COUNT_ONE; // the watch clamps it
        if (axis->mode == TL_WIRE_MODE_OFF) {
            axis->path.q = axis->q;
            tl_servo_observe(&axis->servo, axis->q);
            tl_axis_drive(axis, 0);
        } else {
            if (axis->slot == 0U) {
                tl_path_begin(&axis->path, &axis->reference);
                tl_servo_feed(&axis->servo, &axis->path);
            }
            tl_path_tick(&axis->path);
            tl_axis_drive(axis, tl_servo_step(&axis->servo, axis->q, &axis->path, axis->limits.duty_q15));
        }
    }
    uint32_t job = axis->slot;
    const bool last = job + 1U == axis->ticks;
    axis->slot = last ? 0U : job + 1U;
    while (job < TL_AXIS_JOBS) {
        do_job(axis, job++);
        if (!last || TL_AXIS_TICKS_MIN >= TL_AXIS_JOBS) { // else all that are left: below 5 kHz there are fewer ticks
            break;
        }
    }
}
