"""A transmission with backlash for MuJoCo: play, law and what comes late, from the tables beside this file.

It needs numpy alone. With the model of scene_callback.xml, before each step:

    model = mujoco.MjModel.from_xml_path("scene_callback.xml")
    data = mujoco.MjData(model)
    control = Control(model)
    control.start(data, q=0.0)
    for q in motor:                     # where the motor is, mm or deg as tables.csv has it
        data.ctrl[control.actuator] = q * control.scale
        control(model, data)            # or once: mujoco.set_mjcb_control(control)
        mujoco.mj_step(model, data)

scene.xml needs no callback: rest(model, data, q) brings it to rest at q, then its control alone leads it.
Without MuJoCo, Transmission().start(q) and .step(q, dt) give the bending angle in deg.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
SLOWER = 5.0  # times creep_time: the slow part of creep


class Transmission:
    """Simulates one motor's transmission, step by step: the play, of width B(q), whose elements stand side by side on
    an axis x that warp.csv maps q to, so that B is 1 everywhere on it; then what comes late, and the law f_remain."""

    def __init__(self, folder: Path = HERE) -> None:
        """Reads transmission.json, tables.csv and warp.csv in a folder; starts in the middle of the tables."""
        self.about: dict[str, Any] = json.loads((folder / "transmission.json").read_text(encoding="utf-8"))
        self.grid, self.width, self.c_deg = _columns(folder / "tables.csv", 3)
        self.r = 0.5 * np.array(self.about["elements"]["width"])  # (elements,) half widths, of B
        self.w = np.array(self.about["elements"]["weight"])  # (elements,) sum 1
        self.warp = _columns(folder / "warp.csv", 2) if len(self.r) > 1 else None
        self.narrow = float(self.about["narrow"])
        self.values: dict[str, float] = self.about["parameters"]
        self.start(float(self.grid[len(self.grid) // 2]))

    def start(self, q: float) -> float:
        """Puts the motor at rest at q with the tip on the centre line; returns c, deg."""
        q = self._shaft(q)
        self.single = q  # where one play of width B is
        if self.warp is not None:
            x = _line(q, *self.warp)
            half = 0.5 * max(_held(q, self.grid, self.width), self.narrow)
            self.z = self._shared(x, _line(q - half, *self.warp) + 0.5)
        p = self._centre()
        self.before = p
        self.lag = [p, p]  # the outputs of both stages
        self.creep = [p, p]  # the fast part's and the slow part's
        return self._bent(p)

    def step(self, q: float, dt: float) -> float:
        """Moves the motor to q within dt s, in a straight line; returns c, deg, at the end."""
        q = self._shaft(q)
        half = 0.5 * self.width
        low, high = _beside(q, self.grid + half, self.grid), _beside(q, self.grid - half, self.grid)
        self.single = min(max(self.single, low), high)
        if self.warp is not None:
            x = _line(q, *self.warp)
            self.z = np.minimum(np.maximum(self.z, x - self.r), x + self.r)
        p = self._centre()
        before, self.before = self.before, p
        return self._bent(self._late(before, p, dt))

    def _centre(self) -> float:
        """The centre coordinate p, unit of q: the elements' mean, taken back through the warp; without a warp, and
        where B is narrow, that of the single play."""
        if self.warp is None:
            return self.single
        y = float(self.w @ self.z)
        q, x = self.warp
        p = 0.5 * (_line(y - 0.5, x, q) + _line(y + 0.5, x, q))
        return self.single if _held(p, self.grid, self.width) < self.narrow else p

    def _shared(self, x: float, y: float) -> Any:
        """Positions (elements,) whose weighted mean is y, for a motor at x, all on the warped axis, where B is 1: one
        common value, or as near to it as an element's half width r lets it be."""
        common = min(max(y, x - 0.5), x + 0.5) - x
        sign, left, rest, reached = math.copysign(1.0, common), abs(common), 1.0, 0.0
        for r, w in zip(self.r, self.w, strict=True):
            if left <= rest * (r - reached):
                break
            left -= rest * (r - reached)
            reached = float(r)
            rest -= float(w)
        at = reached + (left / rest if rest > 1e-9 else 0.0)
        return x + sign * np.minimum(at, self.r)

    def _late(self, u0: float, u1: float, dt: float) -> float:
        """The centre coordinate after a lag of up to two stages and then creep, at the end of a step of dt s in which
        it went from u0 to u1; unit of q. `lag`, s, is the sum of the stages' time constants, of which the second has
        the share `lag_second`."""
        get = self.values.get
        lag, second = get("lag", 0.0), get("lag_second", 0.0)
        if lag > 0.0:
            stages = (lag * (1.0 - second), lag * second)
            for i, time in enumerate(stages):
                if time > 0.0:
                    before = self.lag[i]
                    self.lag[i] = _first_order(before, u0, u1, dt, time)
                    u0, u1 = before, self.lag[i]
        share = get("creep_share", 0.0)
        if share:
            time, slow = get("creep_time", 1.0), get("creep_slow", 0.0)
            for i, each in enumerate((time, SLOWER * time)):
                self.creep[i] = _first_order(self.creep[i], u0, u1, dt, each)
            u1 -= share * (u1 - (1.0 - slow) * self.creep[0] - slow * self.creep[1])
        return u1

    def _bent(self, p: float) -> float:
        """The bending angle, deg, at the centre coordinate p; beyond the angle contact_c an obstacle holds a share of
        it back, setting in over contact_soft deg."""
        c = _line(p, self.grid, self.c_deg)
        get = self.values.get
        beyond = (c - get("contact_c", 0.0)) * get("contact_side", 1.0)
        if get("contact_hold", 0.0) and beyond > 0.0:
            soft = get("contact_soft", 0.0)
            yields = math.exp(-beyond / soft) if soft > 0.0 else 0.0
            c -= get("contact_hold", 0.0) * (beyond - soft * (1.0 - yields)) * get("contact_side", 1.0)
        return c

    def _shaft(self, q: float) -> float:
        """The true motor position where the encoder reads q, its error having one and two periods a turn."""
        get = self.values.get
        sin, cos, sin2, cos2 = (get(f"encoder_{name}", 0.0) for name in ("sin", "cos", "sin2", "cos2"))
        if not (sin or cos or sin2 or cos2):
            return q
        turn, x = 2.0 * math.pi / get("encoder_period", 1.0), q
        for _ in range(3):  # Newton's: the error is a small part of a turn
            s, c, s2, c2 = (f(k * turn * x) for k in (1.0, 2.0) for f in (math.sin, math.cos))
            error = sin * s + cos * c + sin2 * s2 + cos2 * c2
            slope = turn * (sin * c - cos * s + 2.0 * (sin2 * c2 - cos2 * s2))
            x -= (x - q - error) / max(1.0 - slope, 0.2)  # 0.2: a step stays finite
        return x


class Control:
    """Leads the joint that scene_callback.xml couples the tip to. Called once a step, by hand or by MuJoCo."""

    def __init__(self, model: Any, folder: Path = HERE) -> None:
        """model: the mujoco.MjModel of scene_callback.xml; folder: of the transmission's files."""
        self.transmission = Transmission(folder)
        about = self.transmission.about
        self.scale = float(about["scale"])  # of the control, per unit of q
        self.actuator = int(model.actuator(about["actuator"]).id)
        self.lead = model.joint(about["lead"])
        self.model = model
        self.time = -math.inf

    def start(self, data: Any, q: float) -> None:
        """Brings a simulation (mujoco.MjData) to rest with the motor at q, mm or deg, the tip on the centre line."""
        data.qpos[self.lead.qposadr[0]] = math.radians(self.transmission.start(q))
        rest(self.model, data, q, self.transmission.about)
        self.time = -math.inf

    def __call__(self, model: Any, data: Any) -> None:
        """Moves the transmission on by a step, to where the actuator's control has the motor, and sets the speed with
        which the led joint, and so the tip, gets there within the step. A second call in a step does nothing."""
        if data.time == self.time:  # a stage of the same step
            return
        self.time = float(data.time)
        dt = float(model.opt.timestep)
        c = math.radians(self.transmission.step(float(data.ctrl[self.actuator]) / self.scale, dt))
        data.qvel[self.lead.dofadr[0]] = (c - data.qpos[self.lead.qposadr[0]]) / dt


def rest(model: Any, data: Any, q: float, about: dict[str, Any] | None = None) -> None:
    """Brings either scene (mujoco.MjModel and MjData) to rest with the motor at q, mm or deg: every coordinate to where
    the equalities put it, which are in order from the motor to the tip. about: transmission.json, by default the one
    beside this file."""
    about = about or json.loads((HERE / "transmission.json").read_text(encoding="utf-8"))
    named = {str(model.joint(i).name): i for i in range(model.njnt)}
    for name in about["moves"]:
        if name in named:
            data.qpos[model.jnt_qposadr[named[name]]] = q
    place = model.jnt_qposadr
    for i in range(model.neq):
        if not str(model.equality(i).name).startswith(about["own"]):
            continue
        follower, leader = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        of_tip = str(model.equality(i).name) == about["leads"]
        leaders = [leader]
        if of_tip:  # tendons: over the tip's hinges, and over the joints that lead them
            first = int(model.tendon_adr[leader])
            leaders = [int(joint) for joint in model.wrap_objid[first : first + int(model.tendon_num[leader])]]
        from_rest = sum(data.qpos[place[joint]] - model.qpos0[place[joint]] for joint in leaders)
        moved = sum(float(a) * from_rest**k for k, a in enumerate(model.eq_data[i, :5]))  # MuJoCo's quartic
        if not of_tip:
            data.qpos[place[follower]] = model.qpos0[place[follower]] + moved
            continue
        hinges = [(place[named[name]], sign) for name, sign in about["tip"]]
        angle = sum(sign * model.qpos0[at] for at, sign in hinges) + moved
        for at, sign in hinges:
            data.qpos[at] = sign * angle / len(hinges)
    data.qvel[:] = 0.0
    data.ctrl[model.actuator(about["actuator"]).id] = q * about["scale"]


def _columns(path: Path, count: int) -> list[Any]:
    """The first `count` columns of a CSV below its header line, (n,) each."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [np.array([float(row[i]) for row in rows]) for i in range(count)]


def _line(x: float, grid: Any, values: Any) -> float:
    """The value at x: straight between the points of a rising grid, and on with the end spans' slopes."""
    i = min(max(int(np.searchsorted(grid, x)) - 1, 0), len(grid) - 2)
    slope = (values[i + 1] - values[i]) / (grid[i + 1] - grid[i])
    return float(values[i] + (x - grid[i]) * slope)


def _beside(x: float, grid: Any, values: Any) -> float:
    """The value at x: straight between the points of a rising grid, beyond its ends with a slope of 1."""
    return float(np.interp(x, grid, values)) + min(x - float(grid[0]), 0.0) + max(x - float(grid[-1]), 0.0)


def _held(x: float, grid: Any, values: Any) -> float:
    """The value at x: straight between the points of a rising grid, beyond its ends that of the end."""
    return float(np.interp(x, grid, values))


def _first_order(y: float, u0: float, u1: float, dt: float, time: float) -> float:
    """The output of a first-order element (time: its constant, s) that was y, after dt s in which its input went from
    u0 to u1 in a straight line."""
    behind = time * (u1 - u0) / dt
    return u1 - behind + (y - u0 + behind) * math.exp(-dt / time)
