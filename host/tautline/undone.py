"""What a corrected model's effects become in a board's tables: sections 2 to 11 (common/tl_table.h), and elements."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.effects.library.rate_dependent_backlash import added_width, follows_s
from tautline.elements import Elements, Hysteresis
from tautline.errors import TautError
from tautline.model import Effect, Model
from tautline.nearest import Nearest, merged_elements, nearest_plays

Array = npt.NDArray[np.float64]

COUNT = float(_native.COUNT_ONE)  # of a table's blob, Q8: one encoder count
DEG = float(_native.DEG_ONE)  # the same, Q16: one degree
INT32_MAX = int(np.iinfo(np.int32).max)
_LEAD = 2e-3, 0.125  # tolerance: s, share of a lag's stage: the filter within which it is made up for
_APART = 1.5  # tolerance: times: the two stages' filters
_CREEP_MOST = 0.9  # limit: of the motion: more of it is not made up for at once
_PLACE_MAX = 2**24  # limit: Q8 counts, of a distance in a section: PLACE_MAX of common/src/tl_sections.c
_GAIN_MOST = 1000.0  # tolerance: of a follower
_STEP_LOG2_MAX = 22  # format: of a section's step: common/src/tl_sections.c
# Of a section's small table, in its steps, as common/tl_table.h says: dense where a curve begins.
_NODES = np.array([0, 1, 2, 3, *(2**k * half for k in range(1, 7) for half in (2, 3)), _native.TABLE_STEPS], float)
COUPLED = "configuration.axis_coupling"
_WHERE = {COUPLED: " (without --joint)"}  # format: where tables undo it but for this
_LATE = "transmission.lag", "transmission.creep"
_SLOWER = 5.0  # format: times, the slow part of a creep: host/native/effects/creep.c
_NEAREST, _POINTS = 1e-4, 4000  # tolerance: of the travel, the first place where a table's curve is asked; how many

Section = dict[str, int | list[int]]


@dataclass(frozen=True)
class Joint:
    """An axis of the board that moves what a column of motor.csv recorded."""

    axis: int
    resolution: float  # of the column's unit, per encoder count


def parameters_of(model: Model) -> dict[str, dict[str, Any]]:
    """Parameters, by effect id, of the model's effects that its tables, rig and delay do not hold already."""
    from tautline.effects import BY_ID, of_this_version

    return {effect.id: dict(effect.parameters) for effect in of_this_version(model) if BY_ID[effect.id].holds is None}


def in_words(remains: Iterable[str]) -> str:
    """A list in words, for a message, of the ids that `not_undone` gave. An effect that tables could undo has behind
    it, in brackets, what is missing for that."""
    return ", ".join(name + _WHERE.get(name, "") for name in remains)


def not_undone(model: Model, joints: Mapping[str, Joint] | None = None) -> list[str]:
    """Ids of the model's effects that its tables do not undo: those that no board can, and coupled axes where no axis
    of the board is known for them. joints: as in `tables_and_sections`."""
    from tautline.effects import BY_ID, of_this_version

    ids = [effect.id for effect in of_this_version(model) if not BY_ID[effect.id].on_board]
    if any(effect.id == COUPLED for effect in model.effects) and "joints" not in tables_and_sections(model, joints)[1]:
        ids.append(COUPLED)
    return ids


def stands_in(model: Model) -> Nearest | None:
    """The plays that a board has in place of the model's hysteresis; None where a board's tables can hold that
    itself."""
    if model.friction is None and len(model.elements.width) <= _native.TABLE_PLAYS_MAX:
        return None
    low, high = model.rig.actuator.range
    # As bytes, by which `_nearest` can look up what it has found before: an array cannot be a key.
    q, width = (np.asarray(values, dtype=float).tobytes() for values in (model.q, model.width))
    return _nearest(q, width, model.friction or model.elements, low, high)


@lru_cache(maxsize=16)
def _nearest(q: bytes, width: bytes, hysteresis: Hysteresis, low: float, high: float) -> Nearest:
    """`nearest_plays` within the motor's range low .. high, kept for the last 16 models. q, width: the table of B as
    the bytes of float64 arrays, as an array cannot be a key."""
    return nearest_plays(np.frombuffer(q), np.frombuffer(width), hysteresis, (low, high))


def tables_and_sections(model: Model, joints: Mapping[str, Joint] | None = None) -> tuple[Model, dict[str, Section]]:
    """Returns the model that a board's own tables hold, and the sections, by name, that undo its other effects. In that
    model plays stand for a hysteresis that no table holds (`stands_in`), or else for a gradual onset. Effects that the
    board cannot undo have no section (`not_undone` names them), nor has one in which all numbers are 0. joints: by
    column of motor.csv that couples in, the axis of the board that moves it."""
    parameters = parameters_of(model)
    if (near := stands_in(model)) is not None:
        model = replace(model, elements=near.elements, friction=None)
    elif onset := parameters.get("transmission.smooth_onset"):
        model = replace(model, elements=onset_elements(model.elements, onset))
    count = model.rig.actuator.encoder_resolution / COUNT  # unit of q per Q8 count
    sections: dict[str, Section] = {}
    if encoder := parameters.get("actuator.encoder_periodic"):
        sections["encoder"] = _encoder_section(encoder, count)
    if asymmetry := parameters.get("transmission.asymmetric_backlash"):
        sections |= _sides_sections(asymmetry, count)
    if speed := parameters.get("transmission.rate_dependent_backlash"):
        sections["speed"] = _speed_section(speed, model, count)
    if late := {name: value for of in _LATE for name, value in parameters.get(of, {}).items()}:
        sections["late"] = _late_section(late)
    sections |= _pressed_section(asymmetry or {}, speed or {}, sections, model, count)
    if load := parameters.get("transmission.load_dependence"):
        sections["load"] = _load_section(load, model, count)
    if coupling := parameters.get(COUPLED):
        sections |= _joints_sections(coupling, model, joints or {})
    return model, {name: section for name, section in sections.items() if any(map(np.any, section.values()))}


def _encoder_section(v: Mapping[str, float], count: float) -> Section:
    """Section `encoder`: the once-per-turn error's first and second harmonics in Q8 counts, and its period; {} where
    all harmonics round to 0. v: the effect's parameters; count: unit of q per Q8 count. TautError where the period is
    too long."""
    names = {"sine": "sin", "cosine": "cos", "sine2": "sin2", "cosine2": "cos2"}
    section: Section = {to: round(v.get(f"encoder_{name}", 0.0) / count) for to, name in names.items()}
    period = round(v["encoder_period"] / count * 16.0)  # format: Q12 of an encoder's count
    if period > INT32_MAX:
        raise TautError(f"the encoder's turn of {v['encoder_period']:g} is too long for a board's numbers")
    return section | {"period_q12": period} if any(section.values()) else {}


def _step_log2(reach: float) -> int:
    """Base-2 logarithm of the step with which a section's small table, of TABLE_STEPS steps, reaches at least to
    `reach`, Q8 counts or Q8 counts/s; clipped to what the board allows."""
    return int(np.clip(np.ceil(np.log2(max(reach, 1.0) / _native.TABLE_STEPS)), 0, _STEP_LOG2_MAX))


def _sides_sections(v: Mapping[str, float], count: float) -> dict[str, Section]:
    """Section `sides` of an asymmetric backlash, in Q8 counts. After the play turned towards its wider side it lags by
    L(x) = |asymmetry| exp(-(x / travel)^form) more, x being the motor's travel since it took the play up. The table has
    L over the play's own travel, d = x + L(0) - L(x). Section `anew`, us, is added where a rest of that time lets L
    begin anew. {} where L(0) is below 1. v: the effect's parameters; count: unit of q per Q8 count."""
    size, travel, form = abs(v["asymmetry"]) / count, v["asymmetry_travel"] / count, v.get("asymmetry_form", 1.0)
    if size < 1.0:
        return {}
    most = travel * np.log(size) ** (1.0 / form) + travel  # beyond where L is 1
    x = np.concatenate([[0.0], np.geomspace(_NEAREST * travel, most, _POINTS)])
    late = size * np.exp(-((x / travel) ** form))
    moved = x + late[0] - late
    step_log2 = _step_log2(moved[-1])
    values = np.rint(np.interp(_NODES * 2.0**step_log2, moved, late)).astype(int)
    side = 1 if v["asymmetry"] > 0.0 else -1
    sections: dict[str, Section] = {"sides": {"side": side, "step_log2": step_log2, "late": values.tolist()}}
    if np.isfinite(renewed_s := _native.renewed_s(dict(v))):
        sections["anew"] = {"rest_us": round(1e6 * renewed_s)}  # format: us
    return sections


def _speed_section(v: Mapping[str, float], model: Model, count: float) -> Section:
    """Section `speed`: by how much the width grows (`extra`, Q8 counts), over motor speeds up to twice the range in a
    second; the time in which this follows the speed; and whether it is held while the motor rests. v: the effect's
    parameters; count: unit of q per Q8 count."""
    step_log2 = _step_log2(2.0 * model.rig.actuator.span / count)
    speed = _NODES * 2.0**step_log2 * count
    extra = added_width(v, float(model.q[-1] - model.q[0]), speed)
    return {
        "step_log2": step_log2,
        "time_us": round(1e6 * follows_s(v)),  # format: us
        "held": int(v.get("width_held", 0.0) != 0.0),
        "extra": np.minimum(np.rint(extra / count), _PLACE_MAX).astype(int).tolist(),
    }


def _pressed_section(
    asymmetry: Mapping[str, float],
    speed: Mapping[str, float],
    beside: Mapping[str, Section],
    model: Model,
    count: float,
) -> dict[str, Section]:
    """Section `pressed`: the mean of B over the grid, Q8 counts, and, of the widths that sections `sides` and `speed`
    add, the shares, Q16, that are larger or smaller from place to place as B is. {} where all shares are 0 or there is
    no B. asymmetry, speed: parameters of the two effects; beside: the sections made so far; count: unit of q per Q8
    count."""
    shares = {"sides": asymmetry.get("asymmetry_pressed", 0.0), "speed": speed.get("speed_pressed", 0.0)}
    between = 0.5 * (model.width[1:] + model.width[:-1])
    mean = round(float(np.average(between, weights=np.diff(model.q))) / count)
    pressed = {f"{name}_q16": round(share * 65536.0) if name in beside else 0 for name, share in shares.items()}
    return {"pressed": {"mean": mean, **pressed}} if mean > 0 and any(pressed.values()) else {}


def _late_section(v: Mapping[str, float]) -> Section:
    """Section `late`: the inverse of lag and creep, as y + sum a (y - y_T), where y_T follows y at first order with
    time T: gains a in Q16, times T in us. Lag has two stages in a row, whose time constants sum to `lag`, s, and of
    which the second has the share `lag_second`; its inverse is exact but for a short filter per stage. Creep is undone
    up to a share _CREEP_MOST; its slow part is _SLOWER times slower (effects/creep.c). {} without both. v: parameters
    of both effects."""
    lag, second = v.get("lag", 0.0), v.get("lag_second", 0.0)
    above, below = np.poly1d([1.0]), np.poly1d([1.0])  # the inverse's numerator and denominator, of Laplace's s
    filtered = 0.0
    for stage in sorted([lag * second, lag * (1.0 - second)]):
        if stage > 0.0:
            filtered = max(_LEAD[0], _LEAD[1] * stage, _APART * filtered)
            above, below = above * np.poly1d([stage + filtered, 1.0]), below * np.poly1d([filtered, 1.0])
    share, slow = min(v.get("creep_share", 0.0), _CREEP_MOST), v.get("creep_slow", 0.0)
    if share != 0.0:
        fast = np.poly1d([v["creep_time"], 1.0])
        slowly = np.poly1d([_SLOWER * v["creep_time"], 1.0]) if slow > 0.0 else np.poly1d([1.0])
        above = above * fast * slowly
        below = below * ((1.0 - share) * fast * slowly + share * (1.0 - slow) * slowly + share * slow * fast)
    poles = np.sort(np.real(below.roots))  # apart from one another
    # equation: partial fractions: a (y - y_T) is a T s / (T s + 1), of residue a p at its pole p = -1 / T
    gains = np.clip(above(poles) / below.deriv()(poles) / poles, -_GAIN_MOST, _GAIN_MOST)
    gains_q16 = [round(float(gain) * 65536.0) for gain in gains]  # format: Q16
    times_us = [round(-1e6 / float(pole)) for pole in poles]  # format: us
    free = _native.TABLE_LATE_MAX - len(poles)
    return {"gain_q16": gains_q16 + [0] * free, "time_us": times_us + [0] * free} if len(poles) else {}


def _load_section(v: Mapping[str, float], model: Model, count: float) -> Section:
    """Section `load`: for each mNm above the reference load (mNm, Q8), the shares by which width and gain grow (Q24)
    and the offset (counts, Q16); and the angle `middle` (deg, Q16), about which the gain acts. v: the effect's
    parameters; count: unit of q per Q8 count."""
    reference = model.load_reference_mNm
    return {
        "reference": round(reference * 256.0),  # format: Q8
        "width": round(v.get("width_per_load", 0.0) * 2.0**24),
        "gain": round(v.get("gain_per_load", 0.0) * 2.0**24),
        "offset": round(v.get("offset_per_load", 0.0) / (count * COUNT) * 2.0**16),
        "middle": round(float(model.c_deg[len(model.c_deg) // 2]) * DEG),
    }


def _joints_sections(v: Mapping[str, Any], model: Model, joints: Mapping[str, Joint]) -> dict[str, Section]:
    """Section `joints`, for the columns that couple in and whose axis is known: its axis + 1 (0: none), backlash in Q8
    counts, and deg per count in Q28. Where these axes move the motor before the play, deg per count is 0 and section
    `before` has counts of the motor per count, Q20. {} where no axis is known. v: the effect's parameters; joints: by
    column."""
    from tautline.effects import kind_of

    kind = kind_of(Effect(COUPLED, dict(v)))
    columns = {p.name: p.follows or kind.column for p in kind.amplitudes}
    known = [(joints[of], name) for name, of in columns.items() if v.get(name) and of in joints]
    if not known:
        return {}
    free = [0] * (_native.TABLE_JOINTS - len(known))
    plays = [float(v.get(f"{name.removeprefix('c_per_')}_play", 0.0)) for _, name in known]
    deg = [float(v[name]) * joint.resolution for joint, name in known]  # of a count
    section: Section = {
        "axis": [joint.axis + 1 for joint, _ in known] + free,
        "play": [round(play / j.resolution * COUNT) for (j, _), play in zip(known, plays, strict=True)] + free,
        "slope": [round(slope * 2.0**28) for slope in deg] + free,  # format: Q28
    }
    if not v.get("coupled_before"):
        return {"joints": section}
    of_motor = float(np.ptp(model.q) / (model.c_deg[-1] - model.c_deg[0])) / model.rig.actuator.encoder_resolution
    before: Section = {"slope_q20": [round(slope * of_motor * 2.0**20) for slope in deg] + free}  # format: Q20
    return {"joints": section | {"slope": [0] * _native.TABLE_JOINTS}, "before": before}


# -- gradual onsets -----------------------------------------------------------------------------------------------


def onset_elements(elements: Elements, v: Mapping[str, float]) -> Elements:
    """The elements of a model with a gradual onset (transmission.smooth_onset, parameters v): each of `elements`
    becomes several, whose thresholds are spread about its own, and these are merged to as many as a board has."""
    spread, share = _native.onset_lots(dict(v))
    width = np.outer(elements.width, spread).ravel()
    weight = np.outer(elements.weight, share).ravel()
    order = np.argsort(width, kind="stable")
    return merged_elements(width[order], weight[order])
