"""Faults that a simulated board can be given, and what is then said. Each is caused in the middle of a move, or before
the check of motor and encoder where that check is what finds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tautline.device import wire
from tautline.errors import TautError
from tautline.live.session import driving
from tautline.live.setup import Live
from tautline.simulated.simlink import SimLink

_RUN_S = 0.3  # from the beginning of a move until the fault is caused
_SHARE = 0.4  # of the range: where that move goes to
_PATIENCE_S = 3.0  # within which every fault is noticed
_SLICE_S = 0.5  # steps of virtual time in which a silent host lets the board run
_RESTS = 1.0  # counts: a motor that is so near to its last position rests


@dataclass(frozen=True)
class Fault:
    """A fault that a simulated board can have."""

    what: str  # in words
    request: str | None  # to the simulated board, on its sim link, that causes it; None: the host is silent
    at_check: bool = False  # caused before the check of motor and encoder, which finds it; else in the middle of a move


FAULTS = {
    "blocked": Fault("the motor is held fast", "inject {axis} blocked"),
    "unplugged": Fault("the encoder shows nothing any more", "inject {axis} unplugged", at_check=True),
    "reversed": Fault("the motor's wires are swapped", "inject {axis} reversed", at_check=True),
    "coarse": Fault("the encoder counts every eighth count", "inject {axis} coarse", at_check=True),
    "jump": Fault("the encoder jumps, once", "inject {axis} jump"),
    "driver": Fault("the motor driver reports a fault", "inject {axis} driver"),
    "supply": Fault("the motors' supply is low", "inject {axis} supply"),
    "estop": Fault("the stop button is pressed", "inject {axis} estop"),
    "silence": Fault("the host says nothing any more", None),
    "cable": Fault("the USB cable is pulled", "unplug"),
}


@dataclass(frozen=True)
class Noticed:
    """How a board noticed a fault."""

    says: str  # the line of the error
    fault: str | None  # the name of the fault in tl_wire.h's TL_WIRE_FAULTS, None where the board cannot be asked
    noticed_s: float | None  # from the fault to the motor off
    rest_s: float  # from the fault to the motor's rest
    way: float  # how far the motor moved after the fault, the rig's unit


def inject(link: SimLink, axis: int, name: str) -> None:
    """Causes a fault, a key of FAULTS, on a simulated board over its sim link. TautError where the board does not
    acknowledge it, or it is one that only a silent host can cause."""
    request = FAULTS[name].request
    if request is None:
        raise TautError("nobody can silence another program: stop it, or leave --sim out")
    answer = link.ask(request.format(axis=axis))
    if "{axis}" in request and answer.get("ills", [])[axis : axis + 1] != [name]:
        raise TautError(f"the simulated board did not acknowledge '{name}' of axis {axis}: it is another version")


def show(live: Live, name: str) -> Noticed:
    """Causes a fault, a key of FAULTS, once, on a simulated board whose axis is referenced: before a check of motor and
    encoder, or _RUN_S into a move. Returns how and when the board noticed it, from the error that this raises.
    TautError where the board notices nothing within _PATIENCE_S, or another error came."""
    assert live.plant is not None
    injected_s = live.plant.now_s
    try:
        if FAULTS[name].at_check:
            inject(live.plant.link, live.axis, name)
            live.board.ask("check", axis=live.axis)
            _wait_for_fault(live)
        else:
            with driving(live):
                q = _SHARE * live.rig.actuator.span / live.resolution  # counts
                live.board.ask("move", axis=live.axis, q=q, speed_s=0.25 * q)
                live.wait(_RUN_S)
                injected_s = live.plant.now_s
                if FAULTS[name].request is None:
                    while live.plant.now_s < injected_s + _PATIENCE_S:
                        live.plant.advance_to(live.plant.now_s + _SLICE_S)
                else:
                    inject(live.plant.link, live.axis, name)
                _wait_for_fault(live)
    except TautError as error:
        seen = _what_was_noticed(live, str(error), injected_s)
        if seen.fault == "NONE":
            raise  # of another cause
        return seen
    raise TautError(f"nobody noticed '{name}': report it")


def _wait_for_fault(live: Live) -> None:
    """Waits _PATIENCE_S, and returns if nothing happens. TautError as soon as the axis has a fault, or the board is
    gone."""
    for _ in range(round(_PATIENCE_S / 0.02)):
        live.wait(0.02)
        live.board.check_fault(live.axis)


def _what_was_noticed(live: Live, says: str, injected_s: float) -> Noticed:
    """Lets half a second pass and returns which fault the board has noticed, after how long (both None where the board
    does not answer), and for how long and how far the motor still moved. says: the error's text; injected_s: when the
    fault was caused, board time."""
    plant = live.plant
    assert plant is not None
    plant.advance_to(plant.now_s + 0.5)
    fault, noticed_s = None, None
    try:
        status = live.board.status(live.axis)
        fault = wire.name("FAULTS", status.fault)
        noticed_s = status.fault_us * 1e-6 - injected_s
    except TautError:
        pass  # the board is gone
    t, q, _, _ = plant.truth()  # times, s, and the motor's true position, the rig's unit
    since = t >= injected_s
    t, q = t[since], q[since]
    moving = np.flatnonzero(np.abs(q - q[-1]) > _RESTS * live.resolution)
    rest_s = float(t[moving[-1]] - injected_s) if len(moving) else 0.0
    return Noticed(says, fault, noticed_s, rest_s, float(np.ptp(q)))
