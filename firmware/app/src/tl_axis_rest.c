#include "tautline/tl_axis_rest.h"

#include "tautline/tl_fast.h"

#define BIT(NAME) (1UL << TL_WIRE_FAULT_##NAME)

// After these nobody knows where the motor is;
#define OF_POSITION (BIT(ENCODER) | BIT(EDGES) | BIT(REVERSED) | BIT(SCALE) | BIT(UNMOVED))
// nor after these where the encoder showed nothing for so long, or no way but a count to and fro: it may have been
// lost, or one of its lines, and the motor have run on.
#define OF_MOTION (BIT(FOLLOWING) | BIT(CURRENT) | BIT(STALL))
#define UNSEEN_MS 5U
#define NO_WAY_MS 20
// After these somebody may have changed its wires.
#define OF_WIRING (OF_POSITION | OF_MOTION | BIT(DRIVER) | BIT(SUPPLY))

TL_FAST void tl_axis_off(tl_axis_t *axis) {
    tl_actuator_release(&axis->motor);
    axis->referenced = axis->referenced && !axis->guard.blind;
    axis->guard.blind = false;
    tl_axis_enter(axis, TL_WIRE_MODE_OFF);
    axis->plan.stream.used = 0;
    axis->plan.motion = NULL;
}

TL_FAST void tl_axis_fail(tl_axis_t *axis, tl_wire_fault_t fault, int32_t value, tl_us_t now_us) {
    tl_axis_off(axis);
    axis->guard.lapsed = false;
    const bool unseen = axis->guard.unseen_ms >= UNSEEN_MS || tl_actuator_unseen_ms(&axis->motor) >= NO_WAY_MS;
    if (((unseen ? OF_POSITION | OF_MOTION : OF_POSITION) >> fault & 1U) != 0) {
        axis->referenced = false;
    }
    if ((OF_WIRING >> fault & 1U) != 0) {
        axis->checked = false;
    }
    if (axis->fault == TL_WIRE_FAULT_NONE) {
        axis->fault = (uint8_t)fault;
        axis->guard.fault_us = now_us;
        axis->guard.fault_value = value;
        tl_axis_event(axis, TL_WIRE_EVENT_FAULT);
    }
}

TL_FAST void tl_axis_stop(tl_axis_t *axis, bool then_off) {
    if (axis->mode == TL_WIRE_MODE_OFF || (axis->mode == TL_WIRE_MODE_HOLD && !then_off)) {
        return;
    }
    if (axis->mode == TL_WIRE_MODE_CHECK) {
        tl_axis_off(axis);
        tl_axis_event(axis, TL_WIRE_EVENT_RESTED);
        return;
    }
    axis->plan.stream.used = 0;
    axis->plan.motion = NULL;
    tl_axis_enter(axis, then_off ? TL_WIRE_MODE_STOPPING_OFF : TL_WIRE_MODE_STOPPING);
}

TL_FAST void tl_axis_silence(tl_axis_t *axis) {
    const bool follows = tl_axis_is_following(axis);
    tl_undo_forget(&axis->tip.compensator.undo); // nobody sees any more whether it holds
    if (!follows && axis->mode != TL_WIRE_MODE_MOVE && axis->mode != TL_WIRE_MODE_HOME &&
        axis->mode != TL_WIRE_MODE_CHECK) {
        return;
    }
    tl_axis_stop(axis, !follows);
    axis->silent = true;
    axis->guard.lapsed = !follows;
    tl_axis_event(axis, TL_WIRE_EVENT_SILENT);
}

TL_FAST void tl_axis_settle(tl_axis_t *axis) {
    axis->plan.target = axis->q;
    tl_reference_set(&axis->plan.reference, axis->q);
    tl_path_set(&axis->path, axis->q);
}

TL_FAST void tl_axis_admit(tl_axis_t *axis) {
    tl_count_q8_t low = -TL_AXIS_RANGE_MAX, high = TL_AXIS_RANGE_MAX;
    if (axis->referenced) {
        low = axis->limits.q_low_q8;
        high = axis->limits.q_high_q8;
        const tl_table_t *table = &axis->tip.lookup.table;
        if (axis->has_table && table->q_min <= high && table->q_max >= low) { // else the host's limits hold
            low = table->q_min > low ? table->q_min : low;
            high = table->q_max < high ? table->q_max : high;
        }
    }
    axis->plan.low = low;
    axis->plan.high = high;
    tl_reference_t *reference = &axis->plan.reference;
    const tl_count_q8_t here = tl_reference_q(reference);
    reference->low = here < low ? here : low;
    reference->high = here > high ? here : high;
}
