"""python -m tools.simulator_faults OUT [--cases N] [--seed S] [--fault NAME]: a fault in a user's MJCF, and a robot
that has it.

Three kinds of MJCF (an arm behind gears, one of tendons in two joints, one between antagonists' springs); nine faults,
none, and a cause that neither file nor library has; by --fault also a wrong ratio and a servo that lags. The robot is
the same mechanism with the fault, stepped eight times as finely by another integrator and seen with noise. Each case
is drawn by its seed alone and stored in OUT with what the diagnosis was told and said, so that a campaign that was
broken off goes on where it was.
"""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from tautline import trajectory
from tautline.diagnosis.diagnose import Diagnosis
from tautline.diagnosis.simulated import diagnose_simulator
from tautline.errors import TautError
from tautline.folders import write_file
from tautline.plain import plain
from tautline.prediction import foretold
from tautline.recording import Angle, Motor, Recording
from tautline.rig import Actuator, Coarse, Rig
from tautline.simulators import Simulator, mjcf
from tautline.simulators.nominal import nominal

Array = npt.NDArray[np.float64]

NOISE_DEG, SECONDS = 0.03, 10.0
STEP_S, ROBOT_STEP_S = 0.004, 0.0005
FIRST_SEED = 3_000_000  # scored; below it is tuned
_WORSE = 1.05  # times the simulator's own error, from which on a corrected model is worse
_MIXED = 7  # prime to the number of kinds: seeds that follow each other are unlike
_MOST = 3  # causes in a leading set
_CLOSABLE = 1.5  # times the noise that a simulator has to leave of an unseen motion, for a claim to be seen there

GEARED = """<worldbody>
  <body><joint name="motor" axis="0 1 0" damping="{damping}" frictionloss="{friction}" armature="{armature}"/>
    <geom type="cylinder" size="0.02 0.02" mass="0.05" euler="90 0 0"/></body>
  <body pos="0.1 0 0"><joint name="elbow" axis="0 1 0" damping="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="{mass}"/></body></worldbody>
  {coupling}
  <actuator><position name="servo" joint="motor" kp="{kp}" kv="0.02" timeconst="{lag}"/></actuator>"""
TENDONS = """<worldbody>
  <body><joint name="motor" axis="0 1 0" damping="{damping}" frictionloss="{friction}" armature="{armature}"/>
    <geom type="cylinder" size="0.02 0.02" mass="0.05" euler="90 0 0"/></body>
  <body pos="0.1 0 0"><joint name="elbow" axis="0 1 0" stiffness="0.02" damping="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.005" mass="{mass}"/>
    <body pos="0 0 -0.1"><joint name="wrist" axis="0 1 0" stiffness="0.02" damping="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.005" mass="{mass}"/><site name="tip"/></body></body>
  </worldbody>
  {coupling}
  <actuator><position name="servo" joint="motor" kp="{kp}" kv="0.02" timeconst="{lag}"/></actuator>"""
ANTAGONISTS = GEARED  # the same links, behind springs
_RIGID = '<equality><joint joint1="{joint}" joint2="motor" polycoef="0 {gain} {bend} 0 0" solref="0.01 1"/></equality>'
_SLACK = """<tendon><fixed limited="true" range="-{half} {half}" solreflimit="0.01 1"><joint joint="{joint}" coef="1"/>
  <joint joint="motor" coef="-{gain}"/></fixed></tendon>"""
_SPRINGS = """<tendon>
  <fixed springlength="-9 {dead}" stiffness="40" damping="0.05"><joint joint="elbow" coef="1"/>
    <joint joint="motor" coef="-{gain}"/></fixed>
  <fixed springlength="-9 {dead}" stiffness="40" damping="0.05"><joint joint="elbow" coef="-1"/>
    <joint joint="motor" coef="{gain}"/></fixed></tendon>"""


@dataclass(frozen=True)
class Mechanism:
    """`usual` is what the simulator has; slack, bend and the servo's lag (s) are 0 in it."""

    text: str
    usual: Mapping[str, float]
    rig: Rig
    tip: str
    speed: float  # of motions, units of q a second
    slack: float  # rad of the tip, of a fault
    bend: float  # of the tip's law, of a fault
    scale: float | None = None  # of a control per unit of q, where that is no angle of the motor

    def write(self, path: Path, step_s: float, integrator: str, off: Mapping[str, float]) -> Path:
        values = {**self.usual, "slack": 0.0, "bend": 0.0, "lag": 0.0, **off}
        option = f'<option timestep="{step_s}" integrator="{integrator}"/>'
        body = self.text.format(coupling=self._coupling(values), **values)
        path.write_text(f'<mujoco><compiler autolimits="true"/>{option}{body}</mujoco>', encoding="utf-8")
        return path

    def _coupling(self, values: Mapping[str, float]) -> str:
        slack, gain = values["slack"], values["gain"]
        if self.text is ANTAGONISTS and self.usual["springs"]:
            return _SPRINGS.format(dead=0.5 * slack if slack else -0.05, gain=gain)
        joints = ("elbow", "wrist") if "wrist" in self.text else ("elbow",)
        share = 1.0 / len(joints)
        if slack:
            return "".join(_SLACK.format(joint=j, half=0.5 * share * slack, gain=gain) for j in joints)
        return "".join(_RIGID.format(joint=j, gain=gain, bend=values["bend"]) for j in joints)


def _rig(unit: str, reach: float, gain: float) -> Rig:
    return Rig(Actuator(unit, (-reach, reach), 2e-4 * reach), Coarse(gain, 0.0))


_ARM = {"damping": 0.05, "friction": 0.01, "armature": 0.004, "mass": 0.15, "kp": 3.0}
_GEARED, _PULLED = {**_ARM, "gain": 0.5, "springs": 0}, {**_ARM, "gain": 1.0, "springs": 1}
_TENDON, _CAPSTAN = {**_ARM, "mass": 0.05, "gain": 0.6, "springs": 0}, 0.1  # rad of the motor per mm of tendon
MECHANISMS = {
    "geared": Mechanism(GEARED, _GEARED, _rig("deg", 60.0, 0.5), "joint:elbow", 80.0, 0.03, 0.08),
    "tendons": Mechanism(TENDONS, _TENDON, _rig("mm", 5.0, math.degrees(0.12)), "site:tip", 7.0, 0.06, 0.1, _CAPSTAN),
    "antagonists": Mechanism(ANTAGONISTS, _PULLED, _rig("deg", 60.0, 1.0), "joint:elbow", 80.0, 0.05, 0.0),
}
DELAYS = ("simulator.servo.delay", "acquisition.delay")
LAGS = (".damping", "servo.kv", "transmission.lag")  # of a stiff servo: a tip that follows in first order
FAULTS: dict[str, tuple[str, ...]] = {  # ends of the ids that are right; none and unknown are verdicts
    "none": (),
    "damping": LAGS,
    "friction": (".frictionloss",),
    "gain": ("servo.kp", ".load"),
    "armature": (".armature",),
    "mass": (".load", "servo.kp"),
    "command_delay": DELAYS,
    "sensor_delay": DELAYS,
    "slack": ("transmission.backlash",),
    "bend": ("configuration.remaining",),
    "unknown": (),
    "ratio": ("configuration.remaining",),
    "lag": ("servo.timeconst", *LAGS),
}
NAMED_ONLY = ("ratio", "lag")  # drawn where --fault names them: they came later, and a seed remains its case


@dataclass(frozen=True)
class Case:
    seed: int
    mechanism: str
    fault: str
    size: float  # of the fault, as a factor or in its own unit

    @classmethod
    def of(cls, seed: int, fault: str | None = None) -> Case:
        """The case of a seed, of that fault where one is named."""
        rng = np.random.default_rng(seed)
        faults = [each for each in FAULTS if each not in NAMED_ONLY] if fault is None else [fault]
        kinds = [(m, f) for f in faults for m in MECHANISMS if f != "bend" or MECHANISMS[m].bend]
        mechanism, fault = kinds[_MIXED * seed % len(kinds)]
        return cls(seed, mechanism, fault, float(rng.uniform(0.7, 1.3)))

    @property
    def off(self) -> dict[str, float]:
        """The robot's own values."""
        usual, one = MECHANISMS[self.mechanism].usual, MECHANISMS[self.mechanism]
        return {
            "damping": {"damping": 3.0 * self.size * usual["damping"]},
            "friction": {"friction": 5.0 * self.size * usual["friction"]},
            "gain": {"kp": 0.5 * self.size * usual["kp"]},
            "armature": {"armature": 5.0 * self.size * usual["armature"]},
            "mass": {"mass": 2.0 * self.size * usual["mass"]},
            "slack": {"slack": self.size * one.slack},
            "bend": {"bend": self.size * one.bend},
            "ratio": {"gain": (1.0 - 0.1 * self.size) * usual["gain"]},
            "lag": {"lag": 0.04 * self.size},
        }.get(self.fault, {})

    def robot(self, arm: Simulator, which: int) -> Recording:
        """Strokes with rests where `which` is 0, else wandering smoothly."""
        one = MECHANISMS[self.mechanism]
        rig, reach = one.rig, one.rig.actuator.range[1]
        seed = 10 * self.seed + which
        course = (
            trajectory.random_smooth(rig.actuator, one.speed, SECONDS, seed)
            if which
            else trajectory.trapezoids(rig.actuator, one.speed, 0.7 * reach, 6, 6.0 * one.speed, 0.4)
        )
        t_s = np.arange(0.0, course.duration_s, 0.005)
        motor = Motor(t_s, np.interp(t_s, course.t_s, course.q))
        late_s = 0.03 * self.size
        c_deg = arm.tip(motor, {"servo.delay": late_s} if self.fault == "command_delay" else {})
        seen_s = np.arange(0.1, t_s[-1], 0.02)
        shown = np.interp(seen_s - (late_s if self.fault == "sensor_delay" else 0.0), t_s, c_deg)
        rng = np.random.default_rng(seed)
        if self.fault == "unknown":  # somebody pushes: a walk that is pulled back
            pushes = rng.normal(0.0, 0.25 * self.size, len(seen_s))
            walk = np.zeros(len(seen_s))
            for k in range(1, len(walk)):
                walk[k] = 0.97 * walk[k - 1] + pushes[k]
            shown = shown + walk
        return Recording(f"robot{which}", motor, angle=Angle(seen_s, shown + rng.normal(0.0, NOISE_DEG, len(seen_s))))


def run(case: Case, folder: Path) -> dict[str, Any]:
    """What is stored of a case: plain."""
    one = MECHANISMS[case.mechanism]
    files = (
        one.write(folder / f"{case.seed}.xml", STEP_S, "implicitfast", {}),
        one.write(folder / f"{case.seed}-robot.xml", ROBOT_STEP_S, "Euler", case.off),
    )
    simulator, arm = (mjcf.simulator(file, "servo", one.tip, one.rig.actuator.unit, one.scale) for file in files)
    began = time.process_time()
    found = diagnose_simulator(simulator, [case.robot(arm, which) for which in (0, 1)], one.rig)
    document, unseen = found.document, case.robot(arm, 2)
    own = nominal(simulator, [unseen], one.rig).model  # at the step of the file
    before, after = (foretold(model, unseen, own) for model in (own, found.corrected))
    return {
        **{name: getattr(case, name) for name in ("seed", "mechanism", "fault", "size")},
        "verdict": document["verdict"],
        "right": right(case, found),
        "claimed": document["effects"][0]["probability"] if document["effects"] else None,
        "named": [[effect["id"], *effect["ambiguous_with"]] for effect in document["effects"]],
        "gap": document["gap"]["before"] / document["noise_floor"],
        "left": document["gap"]["after"] / document["noise_floor"],
        "worse": after / before,
        "unseen": before / NOISE_DEG,
        "step": document["simulator"].get("step", {}).get("error", 0.0) / document["noise_floor"],
        "core_s": time.process_time() - began,
        "evidence": found.evidence.to_json(),
    }


def right(case: Case, found: Diagnosis) -> bool:
    """The verdict where it is none or unknown, else a leading set of at most three with the fault's own cause."""
    document = found.document
    if not FAULTS[case.fault]:
        return bool(document["verdict"] == case.fault)
    leading = [[effect["id"], *effect["ambiguous_with"]] for effect in document["effects"]][:1]
    return any(name.endswith(FAULTS[case.fault]) for names in leading if len(names) <= _MOST for name in names)


def claim_error(case: Mapping[str, Any]) -> float | None:
    """By how much the share of the closable gap (power above the noise) that is said to be closed is more than what is
    closed of an unseen motion, in points of what that motion leaves (rms); None where nothing is named, or where the
    simulator alone is within _CLOSABLE times the noise, there or in what was diagnosed."""
    before = case.get("unseen", 0.0)
    if not case.get("named") or min(before, case["gap"]) < _CLOSABLE:
        return None
    said = max(0.0, case["left"] ** 2 - 1.0) / (case["gap"] ** 2 - 1.0)
    expected = math.sqrt(said * (before**2 - 1.0) + 1.0) / before
    return 100.0 * (case["worse"] - expected)


def stored(case: Case, out: Path, folder: Path) -> dict[str, Any]:
    path = out / f"{case.seed}.json"
    if not path.exists():
        try:
            told = run(case, folder)
        except TautError as error:
            told = {
                "seed": case.seed,
                "mechanism": case.mechanism,
                "fault": case.fault,
                "error": str(error),
                "right": False,
            }
        write_file(path, json.dumps(plain(told)))
    return dict(json.loads(path.read_text(encoding="utf-8")))


def shown(cases: list[dict[str, Any]]) -> Table:
    table = Table("seed", "mechanism", "fault", "gap", "left", "unseen", "step", "verdict", "named", "right", box=None)
    for case in cases:
        named = case.get("error") or ", ".join(" or ".join(names) for names in case["named"])
        figures = [f"{case[name]:.2f}" if name in case else "" for name in ("gap", "left", "worse", "step")]
        table.add_row(
            str(case["seed"]), case["mechanism"], case["fault"], *figures, case.get("verdict", "error"), named,
            "yes" if case["right"] else "no",
        )  # fmt: skip
    return table


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--cases", default=16, show_default=True, type=click.IntRange(1), help="Seeds that follow each other.")
@click.option("--seed", default=FIRST_SEED, show_default=True, help="The first; what is tuned is tuned below it.")
@click.option("--fault", type=click.Choice(list(FAULTS)), help="This one alone.")
def main(out: Path, cases: int, seed: int, fault: str | None) -> None:
    """Faults in three kinds of MJCF: what the diagnosis with the simulator says of each."""
    console = Console(width=200, highlight=False)
    out.mkdir(parents=True, exist_ok=True)
    done = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(seed, seed + cases):
            done.append(stored(Case.of(number, fault), out, Path(folder)))
            console.print(f"{len(done)} of {cases}: {done[-1]['mechanism']}, {done[-1]['fault']}")
    console.print(shown(done))
    faults = [case for case in done if FAULTS[case["fault"]]]
    rest = [case for case in done if not FAULTS[case["fault"]]]
    worse = [case for case in done if case.get("worse", 0.0) > _WORSE]
    claims = [error for case in done if (error := claim_error(case)) is not None]
    console.print(
        f"leads or in a set of at most {_MOST}: {sum(case['right'] for case in faults)} of {len(faults)}; none and "
        f"unknown: {sum(case['right'] for case in rest)} of {len(rest)}; corrected models worse than the simulator on "
        f"an unseen motion: {len(worse)} of {len(done)}"
    )
    if claims:
        console.print(
            f"claims of {len(claims)}: {np.mean(np.abs(claims)):.1f} points off in the mean, {np.mean(claims):+.1f} "
            f"with their sign, {max(claims, key=abs):+.1f} at worst"
        )


if __name__ == "__main__":
    main()
