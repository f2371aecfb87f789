"""python -m tools.undone: how much of what an instrument's effect costs do the tables take away, open loop?

Neither instrument shares an equation with the package. What is found of the effect becomes tables; the board's own
code then leads the tip along another trajectory at 1 kHz. `effects` has one effect at a time, at three strengths;
`plays` has hysteresis that is no play, or several, undone by several plays and by one; `real` predicts runs of a real
tool with both.
"""

from __future__ import annotations

import time

import click
import numpy as np
import numpy.typing as npt

from tautline import _native, tables, trajectory
from tautline.model import Model
from tautline.rig import Actuator
from tools.undone import hysteresis, real
from tools.undone.learn import beside, diagnosed, fitted
from tools.undone.plants import INSTRUMENTS, Instrument, Values

Array = npt.NDArray[np.float64]

RATE_HZ = 1000
SETTLED_S = 8.0
LIMITS = tables.Limits(speed_max=100.0, takeup_speed=50.0, takeup_accel=5000.0, band=0.002)


def set_points(instrument: Instrument, model: Model, t: Array, c_deg: Array) -> Array:
    """The board's, of a host that tells it the load every 20 ms."""
    load, other = beside(t)
    table = _native.FixedTable(tables.encode(model, limits=LIMITS, joints=instrument.joints))
    c = np.rint(c_deg * _native.DEG_ONE).astype(np.int32)
    at = int(np.clip(table.angle_inverse(c[:1])[0][0], table.fields["q_min"], table.fields["q_max"]))
    board = _native.FixedCompensator(table, RATE_HZ, _native.MODE_FULL, at, int(c[0]))
    q = np.empty(len(c))
    coupled = "joints" in table.fields["sections"]
    count = instrument.joints[instrument.joint].resolution
    step = 1 if coupled else 20
    for i in range(0, len(c), step):
        if i % 20 == 0:
            board.load(round(load[i] * 256.0), 20)
        if coupled:
            board.joint(0, round(other[i] / count * _native.COUNT_ONE))
        q[i : i + step] = board.run(c[i : i + step])[0]
    return q * model.rig.actuator.encoder_resolution / _native.COUNT_ONE


def tip_off(instrument: Instrument, model: Model, values: Values, t: Array, c_deg: Array) -> float:
    c = instrument.moved(values, t, set_points(instrument, model, t, c_deg), *beside(t))
    return float(np.sqrt(np.mean((c - c_deg)[t > SETTLED_S] ** 2)))


@click.group()
def main() -> None:
    """How much of what an instrument's effect costs do the tables take away, open loop?"""


@main.command("effects")
@click.option("--instrument", "which", type=click.Choice(list(INSTRUMENTS)), default="second", show_default=True)
@click.option("--learnt", type=click.Choice(["diagnosed", "fitted"]), default="diagnosed", show_default=True)
@click.option("--effect", "only", multiple=True, help="Part of an effect's name; all without.")
@click.option("--seconds", default=40.0, show_default=True, help="Of the trajectory that is scored.")
def of_effects(which: str, learnt: str, only: tuple[str, ...], seconds: float) -> None:
    """The tip's error, deg rms: old tables, new ones, and the old ones without the effect, as its true inverse would
    leave it."""
    instrument = INSTRUMENTS[which]()
    ends = 0.65 * np.sort(instrument.model.c_deg[[0, -1]])
    planned = trajectory.random_smooth(Actuator("deg", (float(ends[0]), float(ends[1])), 1e-3), 15.0, seconds, 3)
    t = np.arange(0.0, planned.t_s[-1], 1.0 / RATE_HZ)
    c_deg = np.interp(t, planned.t_s, planned.q)
    columns = "effect", "strength", "named", "old tables", "new tables", "true inverse", "gained of what it gains"
    print("| " + " | ".join(columns) + " |\n|" + " --- |" * len(columns))
    for name, strengths in instrument.strengths.items():
        if only and not any(part in name for part in only):
            continue
        for values in strengths:
            begun = time.monotonic()
            outcome = diagnosed(instrument, values) if learnt == "diagnosed" else fitted(instrument, name, values)
            old, new = (tip_off(instrument, model, values, t, c_deg) for model in (outcome.old, outcome.new))
            true = tip_off(instrument, outcome.old, {}, t, c_deg)
            says = ", ".join(f"{key} {value:.4g}" for key, value in values.items())
            gained = 100.0 * (old - new) / (old - true) if old > true else np.nan
            print(
                f"| {name} | {says} | {outcome.named} | {old:.4f} | {new:.4f} | {true:.4f} | {gained:.0f} % |",
                flush=True,
            )
            click.echo(f"{name}: {time.monotonic() - begun:.0f} s, {outcome.new.effects}", err=True)


main.add_command(hysteresis.main, "plays")
main.add_command(real.main, "real")

if __name__ == "__main__":
    main()
