"""The mechanisms: MJCF of each topology, and a motion driven through it.

motor q -> play -> carriage p, which friction holds -> tendon with a Kelvin element v and a moving anchor -> s -> tip.
What plays, and what s moves, differs by topology. Lengths in mm, angles in rad, forces in one unit throughout (a
carriage that is let go weighs 0.01); nothing is scaled to what the library expects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

STEP_S = 1e-3
PACKAGE = "mujoco"
TENDON = 630.0  # stiffness of the transmission's tendon, per unit of q
RETURN = 60.0  # ... of the spring that pulls s back to the middle
_KELVIN = 600.0  # ... of the Kelvin element in series with the tendon
_HOLDS = 1000.0  # friction that holds the carriage wherever the motor leaves it
_MOVED = 0.01  # armature of what the tendon moves
_LINKS = 8  # hinges of the bending section
_MAXWELL = 5  # friction elements side by side, each behind a spring: the motion starts gradually
_LEAD_S = 4.0  # from rest in the middle to where a motion begins; not recorded


@dataclass(frozen=True)
class Topology:
    name: str
    unit: str  # of q in files: mm or deg
    half: float  # of the motor's range, in the mechanism's own unit (mm or rad)
    width: float  # of its play, in that unit
    reach_mm: float  # the last link: bending_length_mm stands before it
    bending_mm: float  # 0.02: a hinge, which is an arc of no length
    seen: bool  # by a camera; else an angle sensor stands at the joint
    gain: float  # rad of tip per unit of q
    gravity: float  # mm/s^2, across the joint
    body: Callable[[Topology, Values], str]

    @property
    def scale(self) -> float:
        """Of a file's q: its unit per the mechanism's."""
        return math.degrees(1.0) if self.unit == "deg" else 1.0


@dataclass(frozen=True)
class Values:
    """What is switched on, in the mechanism's units; empty: the nominal instrument."""

    given: Mapping[str, float]

    def __call__(self, name: str, otherwise: float = 0.0) -> float:
        return float(self.given.get(name, otherwise))


@dataclass(frozen=True)
class MechanismPath:
    """What happened, every STEP_S."""

    q: Array  # motor, own unit
    s: Array  # what the tendon moves, own unit
    tip_mm: Array  # (n, 3) in the base's frame
    other: Array  # the other joint, rad


def drive(topology: Topology, values: Values, q: Array, other: Array, load: Array, anchor: Array) -> MechanismPath:
    """`q` is what the motor is told; `other` what the other joint is, rad; `load` pulls at s; `anchor` is where the
    tendon's far end sits, unit of q. All sampled every STEP_S."""
    import mujoco  # the package is optional
    from mujoco import rollout

    model = _compiled(topology, tuple(sorted(values.given.items())))
    lead = int(_LEAD_S / STEP_S)
    ramp = 0.5 * (1.0 - np.cos(np.pi * np.minimum(np.arange(lead) / (0.75 * lead), 1.0)))
    told = np.stack([q, other, load, anchor, np.zeros_like(q)][: model.nu], axis=1)  # the last follows speed alone
    told = np.concatenate([ramp[:, None] * told[0], told])
    data = mujoco.MjData(model)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    start = np.zeros(size)
    mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    _, felt = rollout.rollout(model, data, start[None], told[None])
    felt = felt[0, lead:]
    return MechanismPath(felt[:, 0], felt[:, 1], felt[:, 2:5], felt[:, 5])


def backlash(topology: Topology, values: Values, at: float = 0.0) -> float:
    """The play's width by the truth: two slow full strokes, the motor's distance between them where s is at `at`."""
    n = int(20.0 / STEP_S)
    stroke = 0.9 * topology.half * np.cos(np.linspace(0.0, 2.0 * np.pi, 2 * n))
    still = np.zeros(2 * n)
    course = drive(topology, values, stroke, still, still, still)
    ends = []
    for part in (slice(0, n), slice(n, None)):
        s, q = course.s[part], course.q[part]
        order = np.argsort(s)
        ends.append(float(np.interp(at, s[order], q[order])))
    return ends[1] - ends[0]


@lru_cache(maxsize=8)
def _compiled(topology: Topology, given: tuple[tuple[str, float], ...]) -> Any:
    import mujoco

    values = Values(dict(given))
    model: Any = mujoco.MjModel.from_xml_string(document(topology, values))
    model.dof_invweight0[:] = 1.0 / model.dof_M0  # of a slide it leaves the armature out: its friction would be soft
    if topology in (PULLEYS, ANTAGONISTS):  # the tip's own centre does not move: the wall would be rigid, and diverge
        of_c, of_s = (float(model.dof_M0[model.joint(name).dofadr[0]]) for name in "cs")
        inertia = of_c + of_s / topology.gain**2
        model.body_invweight0[model.site("tip").bodyid, 0] = topology.reach_mm**2 / inertia
    gap = 0.5 * topology.width * values("widened", 1.0)
    for i in range(model.ntendon):  # lengths are known once it is put together
        name, rest = model.tendon(i).name, model.tendon_length0[i]
        if name.startswith("slack"):
            model.tendon_range[i] = (0.0, rest + gap)
        elif name.startswith("elastic"):
            model.tendon_lengthspring[i] = (0.0, rest + gap - _HOLDS / _ELASTIC)  # friction stretches it
        elif name.startswith("taut"):
            model.tendon_lengthspring[i] = (0.0, rest - _PRETENSION)
    return model


def document(topology: Topology, values: Values) -> str:
    """MJCF."""
    rotary = topology.unit == "deg"
    kind = "hinge" if rotary else "slide"
    axis = "0 1 0" if rotary else "0 0 1"
    friction = f'frictionloss="{_HOLDS}" solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001"'
    inertia = _MOVED * (1.0 + values("ringing"))
    viscous = values("ring_damping", 3.5) + TENDON * values("damper")
    slow = (_KELVIN + TENDON * RETURN / (TENDON + RETURN)) * values("kelvin_s", 0.004)
    kelvin = _KELVIN / values("kelvin_soft", 1.0)
    elements = range(_MAXWELL if values("bristles") else 0)
    moved = (
        f'armature="{inertia}" damping="{viscous}" stiffness="{RETURN}" frictionloss="{values("rubbing")}" '
        'solreffriction="0.002 1" solimpfriction="0.999 0.999 0.001"'
    )
    light = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-6 1e-6 1e-6"/>'
    bristle = "".join(
        f'<body>{light}<joint name="m{i}" type="{kind}" axis="{axis}" armature="0.002" '
        f'frictionloss="{TENDON * values("bristles") * (i + 1) * topology.half * 0.01}" '
        'solreffriction="0.002 1" solimpfriction="0.999 0.999 0.001"/></body>'
        for i in elements
    )
    brushes = "".join(
        f'<fixed name="b{i}" stiffness="{TENDON * values("bristles")}" damping="0.3">'
        f'<joint joint="s" coef="1"/><joint joint="m{i}" coef="-1"/></fixed>'
        for i in elements
    )
    back = "0 0 -1" if topology is PULLEYS else axis
    parts = {
        "@motor": f'type="{kind}" axis="{axis}" armature="100"',
        "@carriage": f'type="{kind}" axis="{back}" armature="{10 * _MOVED}" {friction}',
        "@moved": moved,
        "@light": light,
    }
    body = topology.body(topology, values)
    for name, what in parts.items():
        body = body.replace(name, what)
    # A force that depends on speed and saturates: with the motion it takes from friction what it had at rest
    # (Stribeck), against it the drag of a viscous fluid that gives way.
    grip = values("grip")
    gripping = (
        f'<general joint="s" gainprm="0" biastype="affine" biasprm="0 0 {grip / values("grip_speed", 1.0)}" '
        f'forcelimited="true" forcerange="{-abs(grip)} {abs(grip)}"/>'
    )
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{STEP_S}" integrator="implicitfast" gravity="{-topology.gravity} 0 0" cone="elliptic">
    <flag eulerdamp="disable"/>
  </option>
  <default><geom contype="0" conaffinity="0"/><tendon solreflimit="0.002 1" solimplimit="0.99 0.999 0.001"/></default>
  <worldbody>
    <body>{light}<joint name="v" type="{kind}" axis="{axis}" armature="{_MOVED}"
      stiffness="{kelvin}" damping="{slow}"/></body>
    <body>{light}<joint name="a" type="{kind}" axis="{axis}" armature="0.1"/></body>
    <body>{light}<joint name="o" type="hinge" axis="0 0 1" armature="0.1" damping="0.1"/></body>
    {bristle}
    {_wall(topology, values)}
    {body}
  </worldbody>
  <tendon>
    <fixed name="stage" stiffness="{TENDON}" springlength="{values("homing")}">
      <joint joint="s" coef="1"/><joint joint="p" coef="-1"/><joint joint="v" coef="1"/>
      <joint joint="a" coef="-1"/><joint joint="o" coef="{-values("pull")}"/>
    </fixed>
    {brushes}
    {_plays(topology, values)}
  </tendon>
  <equality>{_tied(topology)}</equality>
  <actuator>
    <position joint="q" kp="4e6" kv="4e4"/>
    <position joint="o" kp="4e3" kv="40"/>
    <motor joint="s"/>
    <position joint="a" kp="4e3" kv="40"/>
    {gripping if grip else ""}
  </actuator>
  <sensor><jointpos joint="q"/><jointpos joint="s"/>
    <framepos objtype="site" objname="tip"/><jointpos joint="o"/></sensor>
</mujoco>"""


_ROUTE_MM = 30.0
_WEIGHT = 1e-4  # at the arm's end; what _MOVED is measured in
_PRETENSION = 0.2  # mm that the section's tendons are stretched at rest
_ELASTIC = 2e4  # stiffness of the antagonist tendons, per mm


def _wall(topology: Topology, values: Values) -> str:
    """A box that the tip's ball meets at an angle; the tip of a hinge, or of an arc, is there then."""
    if not values("wall_soft"):
        return ""
    c, side = values("wall_at"), values("wall_side", 1.0)
    bend, reach = topology.bending_mm, topology.reach_mm
    x = bend * (1.0 - math.cos(c)) / c + reach * math.sin(c)
    z = bend * math.sin(c) / c + reach * math.cos(c)
    away = 0.5 + 2.0  # the ball's radius, half the box
    x, z = side * (x + away * math.cos(c)), z - away * math.sin(c)
    return (
        f'<geom type="box" size="2 4 6" pos="{x} 0 {z}" euler="0 {side * c} 0" contype="1" conaffinity="1" '
        f'solref="{values("wall_soft")} 1" friction="0.05 0.001 0.0001" solimp="0.95 0.99 0.1"/>'
    )


def _tip(topology: Topology, values: Values) -> str:
    reach = topology.reach_mm + (0.0 if topology is SECTION else 0.5 * topology.bending_mm)
    solid = f'contype="1" conaffinity="1" solref="{values("wall_soft")} 1"' if values("wall_soft") else ""
    return f'<site name="tip" pos="0 0 {reach}"/><geom type="sphere" size="0.5" mass="1e-6" pos="0 0 {reach}" {solid}/>'


def _plays(topology: Topology, values: Values) -> str:
    """What is between motor and carriage. The slack of those with sites is set once their lengths are known."""
    if topology is PULLEYS:
        return "".join(
            f'<spatial name="slack{i}" limited="true" range="0 1"><site site="q{i}"/><geom geom="idler{i}" '
            f'sidesite="beside{i}"/><site site="p{i}"/></spatial>'
            for i in (0, 1)
        )
    if topology is ANTAGONISTS:
        return "".join(
            f'<spatial name="elastic{i}" stiffness="{_ELASTIC}" damping="10" springlength="0 1"><site site="q{i}"/>'
            f'<site site="p{i}"/></spatial>'
            for i in (0, 1)
        )
    half = 0.5 * topology.width * values("widened", 1.0)
    play = (
        f'<fixed name="play" limited="true" range="{-half} {half}"><joint joint="q" coef="1"/>'
        '<joint joint="p" coef="-1"/></fixed>'
    )
    if topology is not SECTION:
        return play
    for joint in ("s", "s2"):
        sites = "".join(f'<site site="d{joint}{i}"/>' for i in range(_LINKS + 1))
        play += f'<spatial name="taut{joint}" stiffness="40" damping="0.05"><site site="at{joint}"/>{sites}</spatial>'
    return play


def _tied(topology: Topology) -> str:
    if topology is SECTION:
        return '<joint joint1="s2" joint2="s" polycoef="0 -1 0 0 0" solref="0.002 1"/>'
    if topology in (PULLEYS, ANTAGONISTS):
        return f'<joint joint1="c" joint2="s" polycoef="0 {topology.gain} 0 0 0" solref="0.002 1"/>'
    return ""


def _pulleys(topology: Topology, values: Values) -> str:
    """The motor's slide pulls two tendons that run over idlers and turn back to a carriage: each may hang slack."""
    sides = ((0, 1.0), (1, -1.0))
    fixed = "".join(
        f'<geom name="idler{i}" type="cylinder" size="3 2" pos="0 7 {side * _ROUTE_MM}" euler="0 1.5707963 0"/>'
        f'<site name="beside{i}" pos="0 7 {side * (_ROUTE_MM + 4)}"/>'
        for i, side in sides
    )
    at_motor = "".join(f'<site name="q{i}" pos="0 4 0"/>' for i, _ in sides)
    at_carriage = "".join(f'<site name="p{i}" pos="0 10 0"/>' for i, _ in sides)
    return f"""{fixed}<body>@light<joint name="q" @motor/>{at_motor}</body>
      <body>@light<joint name="p" @carriage/>{at_carriage}</body>{_lever(topology, values)}"""


def _antagonists(topology: Topology, values: Values) -> str:
    """Two elastic tendons, slack where the other pulls, between the motor's slide and a carriage that rubs."""
    return f"""<body>@light<joint name="q" @motor/><site name="q0" pos="5 0 -20"/><site name="q1" pos="5 0 20"/></body>
      <body>@light<joint name="p" @carriage/><site name="p0" pos="5 0 20"/><site name="p1" pos="5 0 -20"/></body>
      {_lever(topology, values)}"""


def _lever(topology: Topology, values: Values) -> str:
    """s is a slide; a rack turns it into the angle of a wrist."""
    return f"""<body>@light<joint name="s" type="slide" axis="0 0 1" @moved/></body>
      <body pos="0 0 {0.5 * topology.bending_mm}">@light<joint name="c" type="hinge" axis="0 1 0"
        armature="0.001" damping="0.001"/>
      {_tip(topology, values)}
      </body>"""


def _section(topology: Topology, values: Values) -> str:
    link = topology.bending_mm / _LINKS
    close = "</body>" * _LINKS
    chain = ""
    for i in range(_LINKS):
        chain += f'<body pos="0 0 {link if i else 0.5 * link}">@light<joint name="h{i}" type="hinge" axis="0 1 0" '
        chain += 'armature="0.01" stiffness="40" damping="4"/>'
        chain += "".join(
            f'<site name="d{joint}{i + 1}" pos="{side * 1.5} 0 {0.5 * link}"/>'
            for side, joint in ((1, "s"), (-1, "s2"))
        )
    end = f'<body pos="0 0 {0.5 * link}">{_tip(topology, values)}</body>'
    slides = "".join(
        f'<body pos="{side * 1.5} 0 -10">@light<joint name="{joint}" type="slide" axis="0 0 -1" '
        f'{moved}/><site name="at{joint}"/></body>'
        f'<site name="d{joint}0" pos="{side * 1.5} 0 0"/>'
        for side, joint, moved in ((1, "s", "@moved"), (-1, "s2", 'armature="0.01"'))
    )
    return f"""<body>@light<joint name="q" @motor/></body><body>@light<joint name="p" @carriage/></body>
      {slides}{chain}{end}{close}"""


def _joint(topology: Topology, values: Values) -> str:
    """A hinge with a weight at its end, behind a gear with play."""
    mass = _WEIGHT + values("payload")
    return f"""<body>@light<joint name="q" @motor/></body><body>@light<joint name="p" @carriage/></body>
      <body><joint name="s" type="hinge" axis="0 1 0" @moved/>{_tip(topology, values)}
      <geom type="sphere" size="1" mass="{mass}" pos="0 0 {topology.reach_mm}"/></body>"""


PULLEYS = Topology("mujoco.pulleys", "mm", 4.0, 0.5, 12.0, 0.02, True, 0.25, 0.0, _pulleys)
ANTAGONISTS = Topology("mujoco.antagonists", "mm", 5.0, 0.8, 10.0, 0.02, True, 0.19, 0.0, _antagonists)
SECTION = Topology("mujoco.section", "mm", 1.6, 0.25, 6.0, 18.0, True, 0.65, 0.0, _section)
ARM = Topology("mujoco.arm", "deg", 0.7, 0.05, 10.0, 0.02, False, 1.0, 9810.0, _joint)
COUPLED = Topology("mujoco.coupled", "deg", 0.6, 0.035, 10.0, 0.02, False, 1.0, 0.0, _joint)
TOPOLOGIES = (PULLEYS, ANTAGONISTS, SECTION, ARM, COUPLED)
