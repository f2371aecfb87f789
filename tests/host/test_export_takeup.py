"""The take-up does not stutter: arcs and small oscillations, which made others' compensation shake or overshoot.

Marlin's added its steps within one segment of an arc ("bad stuttering on arcs"); dcservo's took each overshoot of the
motor for a reversal and answered it. Here each of 1000 random commands of both kinds goes through the board's own
compensator at 1 kHz with the limits that tables have.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import exported
import numpy as np
import pytest

from tautline import _native, tables
from tautline.compensation import compensate
from tautline.model import Model

RATE_HZ, COMMANDS, SECONDS = 1000, 1000, 1.5
COUNT = exported.model().rig.actuator.encoder_resolution / _native.COUNT_ONE  # mm: what a set-point is rounded to
ROUNDED_SPEED, ROUNDED_ACCEL, ROUNDED_JERK = (k * COUNT * RATE_HZ**n for n, k in ((1, 1.0), (2, 2.0), (3, 4.0)))
SEEN_MM = 5e-4  # half an encoder count: what nobody sees
SEEN_DEG = 11.6 * SEEN_MM  # by the steepest f
T = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
EASE = np.minimum(T / 0.2, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(T / 0.2, 1.0))  # commands begin at rest


def commands(count: int) -> Iterator[tuple[str, np.ndarray]]:
    """Angles, deg, at T: an axis of a circle, or a wobble on a drift; the feed is at most half of the motor's speed."""
    rng = np.random.default_rng(13033)
    for i in range(count):
        if i % 2:
            hz, fastest = rng.uniform(0.2, 3.0), rng.uniform(5.0, 80.0)
            wave = min(fastest / (2.0 * np.pi * hz), 30.0) * np.sin(2.0 * np.pi * (hz * T + rng.uniform()))
            yield "arc", EASE * wave + rng.uniform(-8.0, 8.0)
        else:
            hz, fastest = rng.uniform(1.0, 15.0), 10.0 ** rng.uniform(-0.5, 1.7)
            wave = fastest / (2.0 * np.pi * hz) * np.sin(2.0 * np.pi * (hz * T + rng.uniform()))
            yield "wobble", EASE * (wave + rng.uniform(-5.0, 5.0) * T) + rng.uniform(-20.0, 20.0)


def board(model: Model, c_deg: np.ndarray, table: object) -> tuple[np.ndarray, np.ndarray]:
    """Set-points and the p they are for, mm, from the board's code with the table's own limits."""
    raw = np.rint(c_deg * _native.DEG_ONE).astype(np.int32)
    q0 = int(table.angle_inverse(raw[:1])[0][0])
    q, p, _, flags = _native.FixedCompensator(table, RATE_HZ, _native.MODE_FULL, q0, int(raw[0])).run(raw)
    assert not (flags & _native.COMPENSATOR_FLAGS["CLIPPED"]).any()
    return q * COUNT, p * COUNT


@pytest.mark.parametrize("width", [0.1, 0.5, 1.5])
def test_the_take_up_keeps_its_limits_in_each_of_a_thousand_commands(width: float) -> None:
    """With one width everywhere q - p is the take-up alone: speed and acceleration are the table's, and the
    acceleration changes by twice itself in a tick at most. Nothing goes beyond half the width."""
    model = replace(exported.model(camera=False), width=np.full_like(exported.GRID, width))
    limits, table = tables.Limits.of(model.rig), _native.FixedTable(tables.encode(model))
    steps = 0
    for kind, c_deg in commands(COMMANDS):
        q, p = board(model, c_deg, table)
        ahead = q - p
        speed, accel, jerk = (np.abs(np.diff(ahead, n)).max() * RATE_HZ**n for n in (1, 2, 3))
        assert speed < limits.takeup_speed + ROUNDED_SPEED, kind
        assert accel < 1.01 * limits.takeup_accel + ROUNDED_ACCEL, kind
        assert jerk < 2.02 * limits.takeup_accel * RATE_HZ + ROUNDED_JERK, kind
        assert np.abs(ahead).max() < 0.5 * width + COUNT, kind
        steps += int(np.ptp(ahead) > 0.5 * width)
    assert steps > COMMANDS / 4  # most of the arcs took up, or nothing was tried


def envelopes(model: Model, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    half = 0.5 * np.interp(p, model.q, model.width)
    return p - half, p + half


def test_no_set_point_goes_beyond_what_was_asked_for() -> None:
    """B(q) with a bump. The motor is never further than the furthest place that a command needed so far, either way: so
    the tip is never beyond the command, and no overshoot is there to be answered."""
    model = exported.model(camera=False)
    table = _native.FixedTable(tables.encode(model))
    for kind, c_deg in commands(COMMANDS):
        q, p = board(model, c_deg, table)
        low, high = envelopes(model, p)
        start = q[0]
        assert (q <= np.maximum(np.maximum.accumulate(high), start) + SEEN_MM).all(), kind
        assert (q >= np.minimum(np.minimum.accumulate(low), start) - SEEN_MM).all(), kind
        tip = exported.law(exported.play(q))
        assert tip.max() <= c_deg.max() + SEEN_DEG and tip.min() >= c_deg.min() - SEEN_DEG, kind


def test_for_any_motor_the_set_points_keep_the_rigs_speed_and_go_no_further() -> None:
    """`taut compensate`: the rig has a speed, no acceleration. A twentieth of the commands: each makes a table."""
    given = exported.model(camera=False)
    model = replace(given, rig=replace(given.rig, actuator=replace(given.rig.actuator, speed_max=20.0)))
    for kind, c_deg in commands(COMMANDS // 20):
        points = compensate(model, T, c_deg, RATE_HZ)
        assert np.abs(np.diff(points.q)).max() * RATE_HZ < 20.0 * (1.0 + 1e-9), kind
        low, high = envelopes(model, model.remaining_inverse(c_deg))
        assert (points.q <= np.maximum.accumulate(high) + 1e-3).all(), kind
        assert (points.q >= np.minimum.accumulate(low) - 1e-3).all(), kind
