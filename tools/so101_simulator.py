"""python -m tools.so101_simulator [DATA]: a one-joint MJCF of a low-cost servo as the nominal of a diagnosis, and what
the corrected model leaves of motions that it did not see.

DATA holds so101/ and xl330/: commands drive the MJCF, its joint is compared with the joint's own sensor. Each joint is
diagnosed on one motion, other ones inside its range are predicted by the simulator as it is, by the corrected one, by
what a user writes in an afternoon (a delay, a play of constant width and a polynomial of fifth order, fitted to the
same motion) and, where its packages are installed, by `mujoco.sysid`'s fit of the same MJCF. All in deg rms; `covers`
is the share of readings inside of a method's own 90 % interval. The floor is what two periods of one motion differ by;
--every has beside each motion what the play leaves of it where it is fitted to that motion itself, and what one play
leaves that is fitted to all unseen motions of the joint: about what such a play can do at best.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from tautline.diagnosis.diagnose import Diagnosis
from tautline.diagnosis.simulated import diagnose_simulator
from tautline.model import Model
from tautline.prediction import predict_with_sigma
from tautline.recording import Recording, load
from tautline.rig import Rig
from tautline.simulators import Simulator, mjcf
from tools import so101_simulator_sysid
from tools.so101 import Array, constant_play, find, inside, measured, play_of_all, settled

Rows = npt.NDArray[np.bool_]
Told = Callable[[Recording], tuple[Array, Array | None]]  # deg, and one standard deviation of a reading

MOTIONS = {  # diagnosed on
    "rotation": "so101/rotation-single-joint-rotation",
    "elbow": "so101/elbow-single-joint-elbow",
    "pendulum, kp 100": "xl330/sin-sin-490g-100mm-kp100",
    "pendulum, kp 400": "xl330/sin-sin-490g-100mm-kp400",
}
METHODS = ("as it is", "corrected", "play", "sysid")
OWN, ALL = "play fitted to it", "one play fitted to all of these"
_NINE_OF_TEN = 1.645
_PERIODIC = "so101/rotation-repetitive-motion"
# Damping, armature, friction and gain are those that public models of these servos have, to a digit.
ARM = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.005" integrator="implicitfast"{gravity}/>
  <worldbody><body>
    <joint name="joint" axis="0 1 0" damping="0.6" frictionloss="0.05" armature="0.03"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.02" mass="0.2"/>
  </body></worldbody>
  <actuator><position name="servo" joint="joint" kp="18"/></actuator>
</mujoco>
"""
NO_GRAVITY = ' gravity="0 0 0"'  # the rotation's axis is upright
PENDULUM = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody><body>
    <joint name="joint" axis="0 1 0" damping="0.05" frictionloss="0.02" armature="0.003"/>
    <geom type="sphere" size="0.01" pos="0 0 -0.1" mass="0.49"/>
  </body></worldbody>
  <actuator><position name="servo" joint="joint" kp="{kp}"/></actuator>
</mujoco>
"""
# Its stall torque of 0.52 Nm is at full duty, which an error of 885 / (KP / 128) counts of 0.088 deg gives.
PENDULUM_KP = {"kp100": 0.3, "kp400": 1.2}  # Nm/rad


@dataclass(frozen=True)
class Result:
    joint: str
    found: Diagnosis
    core_s: dict[str, float]
    unseen: dict[str, dict[str, tuple[float, float]]]  # of each motion by method: deg rms, share that is covered

    @property
    def methods(self) -> list[str]:
        return [m for m in METHODS if all(m in of for of in self.unseen.values())]

    def medians(self) -> dict[str, float]:
        return {m: float(np.median([of[m][0] for of in self.unseen.values()])) for m in self.methods}

    def covers(self, method: str) -> float:
        return float(np.mean([of[method][1] for of in self.unseen.values()]))


def simulator(folder: Path, motion: str) -> Simulator:
    path = folder / f"{motion.replace('/', '-')}.xml"
    if motion.startswith("xl330"):
        path.write_text(PENDULUM.format(kp=PENDULUM_KP[motion.rsplit("-", 1)[1]]))
    else:
        path.write_text(ARM.format(gravity=NO_GRAVITY if "rotation" in motion else ""))
    return mjcf.simulator(path, "servo", "joint:joint")


def by_model(model: Model) -> Told:
    def told(run: Recording) -> tuple[Array, Array | None]:
        assert run.angle is not None
        prediction = predict_with_sigma(model, run.motor, run.angle.t_s - model.delay_s)
        return prediction.c_deg, prediction.c_sigma_deg

    return told


def unseen_of(
    run: Recording, data: Path, motion: str, delay_s: float, width: float
) -> Iterator[tuple[Recording, Rows]]:
    """The other motions of the joint, at the same gain, and the readings of each that count."""
    folder = (data / motion).parent
    rig = Rig.load(folder / "rig.toml")
    if folder.name == "xl330":
        for path in sorted(folder.glob(f"*{motion.rsplit('-', 1)[1]}")):
            if path.name != run.name:
                other = load(path, rig)
                yield other, np.ones(len(measured(other)), dtype=bool)
        return
    for path in sorted(folder.glob(f"{run.name.split('-')[0]}-*")):
        other = load(path, rig)
        rows = settled(other, 1.2 * width, max(delay_s, 0.1))
        if path.name != run.name and inside(other, run) and rows.any():
            yield other, rows


def on(joint: str, data: Path, folder: Path, own: bool = False) -> Result:
    """own: with the play of each unseen motion itself, and one of all."""
    motion = MOTIONS[joint]
    rig = Rig.load((data / motion).parent / "rig.toml")
    run, model = load(data / motion, rig), simulator(folder, motion)
    began = time.process_time()
    found = diagnose_simulator(model, [run], rig)
    core_s = {"corrected": time.process_time() - began}
    delay_s, width, play = constant_play(run)
    methods: dict[str, Told] = {
        "as it is": by_model(found.nominal),
        "corrected": by_model(found.corrected),
        "play": lambda other: (play(other), None),
    }
    if so101_simulator_sysid.available():
        identified = so101_simulator_sysid.identify(model, rig, run)
        core_s["sysid"] = identified.core_s
        methods["sysid"] = lambda other: (identified.told(rig, other), identified.sigma(rig, other))
    unseen, others = {}, list(unseen_of(run, data, motion, delay_s, width))
    if own:
        best = play_of_all(*zip(*others, strict=True))
        methods[OWN] = lambda other: (constant_play(other)[2](other), None)
        methods[ALL] = lambda other: (best(other), None)
    for other, rows in others:
        told = {m: told(other) for m, told in methods.items()}
        unseen[other.name] = {m: _scored(measured(other), *of, rows) for m, of in told.items()}
    return Result(joint, found, core_s, unseen)


def _scored(seen: Array, c_deg: Array, sigma: Array | None, rows: Rows) -> tuple[float, float]:
    off = (seen - c_deg)[rows]
    covered = np.nan if sigma is None else float(np.mean(np.abs(off) < _NINE_OF_TEN * sigma[rows]))
    return float(np.sqrt(np.mean(off**2))), covered


def floor(data: Path) -> float:
    """deg rms: what one period of a motion that repeats differs from the next by, over the root of two."""
    run = load(data / _PERIODIC, Rig.load((data / _PERIODIC).parent / "rig.toml"))
    assert run.angle is not None
    t_s = np.arange(run.motor.t_s[0], run.motor.t_s[-1], 0.02)
    q, c = np.interp(t_s, run.motor.t_s, run.motor.q), np.interp(t_s, run.angle.t_s, measured(run))
    lags = np.arange(100, len(t_s) // 3)
    lag = int(lags[np.argmin([np.mean((q[k:] - q[:-k])[len(q) // 10 :] ** 2) for k in lags])])
    alike = np.abs(q[lag:] - q[:-lag]) < 0.1  # deg
    return float(np.sqrt(np.mean((c[lag:] - c[:-lag])[alike] ** 2) / 2.0))


def shown(results: Sequence[Result]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    words = ("joint", "verdict", "named")
    for name in ("joint", "unseen", *METHODS, "core-s", "covers", "of sysid", "verdict", "named"):
        table.add_column(name, justify="left" if name in words else "right")
    for result in results:
        document, medians = result.found.document, result.medians()
        values = {
            each["name"]: f", {each['nominal']:.3g} -> {each['value']:.3g}"
            for each in document["simulator"]["parameters"]
        }
        named = ", ".join(
            f"{' or '.join([effect['id'], *effect['ambiguous_with']])} ({effect['probability']:.2f}"
            f"{values.get(effect['id'].removeprefix('simulator.'), '')})"
            for effect in document["effects"]
        )
        table.add_row(
            result.joint,
            str(len(result.unseen)),
            *(f"{medians[m]:.3f}" if m in medians else "" for m in METHODS),
            " / ".join(f"{seconds:.0f}" for seconds in result.core_s.values()),
            *(f"{result.covers(m):.0%}" if m in medians else "" for m in ("corrected", "sysid")),
            document["verdict"],
            named,
        )
    return table


def told(results: Sequence[Result], of: str) -> str:
    """Of all motions of these together."""
    every = [rms for result in results for rms in result.unseen.values()]
    methods = [m for m in METHODS if all(m in rms for rms in every)]
    bounds = [m for m in (OWN, ALL) if all(m in rms for rms in every)]
    medians = ", ".join(f"{m} {np.median([rms[m][0] for rms in every]):.3f}" for m in [*methods, *bounds])

    def beside(method: str, other: str) -> str:
        times = [rms[method][0] / rms[other][0] for rms in every]
        return f"to {other} {np.median(times):.2f} in the median and {max(times):.2f} at worst"

    ratios = ", ".join(beside("corrected", other) for other in methods[2:])
    of_all = f"; {ALL} {beside(ALL, 'play')}" if ALL in bounds else ""
    return f"{of}: {len(every)} unseen motions, medians in deg: {medians}; corrected {ratios}{of_all}"


@click.command()
@click.argument("data", required=False, type=click.Path(path_type=Path, exists=True))
@click.option("--every", is_flag=True, help="List every motion too.")
def main(data: Path | None, every: bool) -> None:
    """What a diagnosis makes of a user's simulator, on real joints, in deg rms on motions that it did not see."""
    console = Console(width=220, highlight=False)
    if data is None and (arm := find()) is not None:
        data = arm.parent
    if data is None:
        console.print("no SO-101 data beside the repository: name the folder of so101/ and xl330/")
        return
    with tempfile.TemporaryDirectory() as folder:
        results = [on(joint, data, Path(folder), every) for joint in MOTIONS]
    console.print(shown(results))
    for name, rms in [item for result in results for item in result.unseen.items()] if every else []:
        console.print(f"{name}: " + "  ".join(f"{m} {value:.3f}" for m, (value, _) in rms.items()))
    console.print(told(results[:2], "SO-101"))
    console.print(told(results[2:], "XL330"))
    console.print(f"floor, from one period of a motion to the next: {floor(data):.3f} deg")


if __name__ == "__main__":
    main()
