"""The topics as HTML: an index and a page each; what an effect does is drawn from the simulation."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tautline import effects, trajectory
from tautline.effects import Kind
from tautline.explain.collect import topics
from tautline.explain.topic import KINDS, Topic
from tautline.folders import replaced_folder
from tautline.model import Model
from tautline.recording import Motor
from tautline.reports import figures, pages
from tautline.simulated import instrument

INDEX = "index.html"
_TIMES = 4.0  # format: of the change that a user would notice, so that it is seen in a picture
_CONTACT_DEG, _CONTACT_HOLD = 25.0, 0.9  # format: where a contact is drawn, within the motion's bending; its hold
_PERIOD = 0.3  # format: of the motor's range, an encoder's turn as it is drawn
_FEW = 5  # format: amplitudes that are shown together


def write_all(folder: Path) -> Path:
    """Writes the pages of all topics, and their index, into a folder, all or nothing; returns the path of the index.
    TautError where the folder holds something else."""
    known = topics()
    with replaced_folder(folder, next(iter(known.values())).file) as target:
        for topic in known.values():
            page = {
                "title": topic.code,
                "topic": topic,
                "kind": KINDS[topic.kind],
                "see": [known[code] for code in topic.see],
                "picture": picture(topic),
            }
            pages.write_page("topic.html", page, target / topic.file)
        groups = [(title, [topic for topic in known.values() if topic.kind == kind]) for kind, title in KINDS.items()]
        index = {"title": "What tautline's messages mean", "groups": groups}
        pages.write_page("topics.html", index, target / INDEX)
    return folder / INDEX


def picture(topic: Topic) -> pages.Picture | None:
    """The picture on an effect's page; None for a topic that is no effect, and for an effect that changes no path but
    only scatters."""
    kind = effects.BY_ID.get(topic.code)
    if kind is None or kind.event:
        return None
    return pages.picture(
        drawn(kind),
        f"What {topic.code} does",
        "Simulated on the reference instrument. Left: tip or marker, without (grey) and with (red) the effect. "
        f"Right: the difference over time, {_TIMES:g} times what a user would notice.",
    )


@mpl.rc_context(figures.STYLE)
def drawn(kind: Kind) -> Figure:
    """Draws what an effect does on the reference instrument, simulated without and with it. Left the characteristic, or
    the marker's track where only the image changes; right the difference over time, deg or px. In the motion
    translation and rotation sway, and a load of 20 mNm comes half-way, so that each effect has what it needs."""
    rig = instrument.reference_rig()
    plant = instrument.preset("reference", rig)
    q = np.linspace(*rig.actuator.range, 201)
    width, c_deg = plant.backlash(q), plant.bend(q)
    model = Model(
        rig, q, width=width, width_sigma=np.zeros_like(q), c_deg=c_deg, delay_s=rig.delay_s, measured=rig.actuator.range
    )
    motor = _motion()
    t_s = motor.t_s
    values = parameters(kind, rig.actuator.span, float(t_s[-1]))
    without, with_it = (effects.simulate(model, motor, t_s, each) for each in ({}, values))
    by_angle = kind.through_angle or kind.stage == "acquisition"
    made_figure, axes = figures.figure(11, 3.4, 1, 2)
    left, right = axes[0]
    for seen, colour, name in ((without, figures.GREY, "without"), (with_it, figures.MODEL, "with it")):
        x, y = (motor.q, seen.c_deg) if by_angle else seen.image_px.T
        left.plot(x, y, color=colour, lw=1.2, label=name)
    if by_angle:
        left.set(xlabel=f"q ({rig.actuator.unit})", ylabel="bending c (deg)")
        right.plot(t_s, with_it.c_deg - without.c_deg, color=figures.MODEL, lw=1.2)
        right.set(ylabel="difference (deg)")
    else:
        left.set(xlabel="u (px)", ylabel="v (px)")
        left.invert_yaxis()
        apart = with_it.image_px - without.image_px
        for column, colour, name in ((0, figures.UP, "across"), (1, figures.DOWN, "down")):
            right.plot(t_s, apart[:, column], color=colour, lw=1.2, label=name)
        right.set(ylabel="difference (px)")
        right.legend()
    left.set_title("The characteristic" if by_angle else "The marker in the image")
    left.legend()
    right.set(xlabel="time (s)")
    right.set_title("What it changes")
    return made_figure


def _motion() -> Motor:
    """The motion in which effects are drawn, q in mm: strokes of several lengths, translation and rotation that sway,
    and a load of 20 mNm from half-way on."""
    turns = [-4.0, 4.0, -4.0, 3.0, -2.0, 0.5, 0.5]
    made = trajectory.through(turns, speed=2.5, acceleration=20.0, dwell_s=1.0)
    t_s, q = made.t_s[::10], made.q[::10]  # at 100 Hz
    sway = np.sin(2 * np.pi * t_s / 9.0)
    load_mNm = 20.0 * (t_s > t_s.mean())
    return Motor(t_s, q, translation_mm=2.0 * sway, rotation_deg=20.0 * sway, load_mNm=load_mNm)


def parameters(kind: Kind, span: float, seconds: float) -> dict[str, float]:
    """Parameter values at which an effect is visible: amplitudes at _TIMES their scale, shapes at their first start.
    span: of the motor's range, unit of q, for parameters that are shares of it; seconds: of the motion, in whose middle
    happens what happens once."""
    kind = kind.happening(1) if kind.moments else kind
    shown = kind.amplitudes
    if len(shown) > _FEW:  # a rigid motion's first part, or one piece of a curve
        shown = shown[:1] if not shown[0].name[-1].isdigit() else shown[len(shown) // 2 :][:1]
    values = {p.name: p.inside(_TIMES * p.scale * p.share(span), span) for p in shown}
    for p in kind.shapes:
        values[p.name] = (p.shape[0] if p.shape else p.scale) * p.share(span)
    values |= {"encoder_period": _PERIOD * span} if "encoder_period" in values else {}
    values |= dict.fromkeys(kind.moments, 0.5 * seconds)
    values |= {"contact_c": _CONTACT_DEG, "contact_hold": _CONTACT_HOLD} if "contact_c" in values else {}
    return values
