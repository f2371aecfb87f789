"""The topics of `taut explain` as HTML pages, one each and an index; the pages of effects have simulated pictures."""

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
_TIMES = 4.0  # format: an effect is drawn this many times as large as a user would notice
_CONTACT_DEG, _CONTACT_HOLD = 25.0, 0.9  # format: a contact's angle, within the motion's bending, and its hold
_PERIOD = 0.3  # format: an encoder's turn as it is drawn, as a share of the motor's range
_FEW = 5  # format: most amplitudes of an effect that are drawn together


def write_all(folder: Path) -> Path:
    """Writes the pages of all topics and their index into a folder, all or nothing, in place of earlier ones. Returns
    the path of the index. TautError where the folder holds something else."""
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
    """The picture on an effect's page; None for a topic that is not an effect, and for an event (Kind.event), which
    only adds scatter and has no path that could be drawn."""
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
    """A figure of what an effect does to the reference instrument, simulated under `_motion` without and with it. Left:
    the angle over q, or the marker's track in the image for an effect that changes the image alone. Right: the
    difference over time, deg or px."""
    rig = instrument.reference_rig()
    plant = instrument.preset("reference", rig)
    q = np.linspace(*rig.actuator.range, 201)
    width, c_deg = plant.backlash(q), plant.bend(q)
    model = Model(
        rig, q, width=width, width_sigma=np.zeros_like(q), c_deg=c_deg, delay_s=rig.delay_s, measured=rig.actuator.range
    )
    motor = _motion()
    t_s = motor.t_s
    values = visible_parameters(kind, rig.actuator.span, float(t_s[-1]))
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
    """The motion under which effects are drawn, q in mm at 100 Hz: strokes of several lengths, translation (2 mm) and
    rotation (20 deg) that sway with a period of 9 s, and a load of 20 mNm from half-way on; so each effect has what it
    depends on."""
    turns = [-4.0, 4.0, -4.0, 3.0, -2.0, 0.5, 0.5]
    made = trajectory.through(turns, speed=2.5, acceleration=20.0, dwell_s=1.0)
    t_s, q = made.t_s[::10], made.q[::10]  # at 100 Hz
    sway = np.sin(2 * np.pi * t_s / 9.0)
    load_mNm = 20.0 * (t_s > t_s.mean())
    return Motor(t_s, q, translation_mm=2.0 * sway, rotation_deg=20.0 * sway, load_mNm=load_mNm)


def visible_parameters(kind: Kind, span: float, seconds: float) -> dict[str, float]:
    """Parameter values, by name, at which an effect is visible in a picture: amplitudes at _TIMES their scale, shape
    parameters at the first value that a fit starts from. span: length of the motor's range, unit of q, for parameters
    that are shares of it; seconds: length of the motion, in whose middle an effect happens that happens once. Of an
    effect with many amplitudes, such as the pieces of a curve, one is set."""
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
