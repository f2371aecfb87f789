"""A model as the board's table, and back. The blob's layout and its rules are C's (common/tl_table.h)."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tautline import _native
from tautline.elements import SINGLE, Elements, warp_of
from tautline.errors import TautError
from tautline.model import Array, Model, interpolate
from tautline.rig import MARKER, Rig
from tautline.undone import COUNT, DEG, INT32_MAX, Joint, Section, tables_and_sections

KINDS: dict[str, int] = _native.AXIS_KINDS
_KIND_NAMES = {value: name for name, value in KINDS.items()}
_UNIT_NAMES = {value: name for name, value in _native.AXIS_UNITS.items()}
_UINT32_MAX = int(np.iinfo(np.uint32).max)
_SLOPE = 2.0**28  # format: deg per count, Q28
_NANO = 1e-9
_US = 1e6  # format: in a second
_MOVED = 0.1  # loss: of the range, by which tables in use may be moved
_SERIAL = 8  # format: bytes of an instrument's serial
_SHARE, _WEIGHT = 2.0**28, 2**16  # format: of an element's width, and of its share of the motion
_PERIOD_LOG2 = 26  # format: of the warp, at most
_HALF_LOG2 = 26  # format: and of half the widest element
_WIDER = 1.5  # tolerance: times the width below which B counts as narrow, where the warp is off by more than
_WARP_OFF = 4.0, 0.02  # tolerance: counts, of B: how far the warp may be off between the nodes of a board's grid


@dataclass(frozen=True)
class Limits:
    """What the compensator may do, in the rig's unit."""

    speed_max: float  # unit/s, of the motor
    takeup_speed: float  # unit/s, added to the feed while backlash is crossed
    takeup_accel: float  # unit/s^2
    band: float  # unit; p must turn back by more to count as a reversal
    slope_min: float = 0.0  # deg/unit; spans of f that are flatter are refused, or crossed at flat_speed
    flat_speed: float = 0.0  # unit/s; 0 refuses
    strength: float = 1.0  # share of B that is compensated, 0..1
    adapt: tuple[float, float, float] | None = None  # in use: offset at most, unit; scale of B at least, at most

    @classmethod
    def of(cls, rig: Rig) -> Limits:
        """Moderate limits for a rig: at most the range in half a second; take-up at half that speed, reached within 0.1
        s."""
        actuator = rig.actuator
        return cls(
            speed_max=2.0 * actuator.span,
            takeup_speed=actuator.span,
            takeup_accel=10.0 * actuator.span,  # loss: a moderate one
            band=2.0 * actuator.encoder_resolution,
            slope_min=0.02 * abs(rig.coarse.gain),  # loss: flatter spans are crossed at flat_speed
            flat_speed=actuator.span,
        )

    @classmethod
    def in_use(cls, rig: Rig) -> Limits:
        """Moderate limits (`of`) for tables that may be moved in use, by up to a tenth of the range, and to a B between
        0 and twice as wide."""
        return replace(cls.of(rig), adapt=(_MOVED * rig.actuator.span, 0.0, 2.0))


@dataclass(frozen=True)
class Table:
    """The content of a blob, in the rig's unit and degrees."""

    axis: int
    kind: str  # bending, translation or rotation
    unit: str
    encoder_resolution: float  # unit per count
    q_range: tuple[float, float]
    coarse_gain: float  # deg per unit
    coarse_offset: float
    limits: Limits
    delay_s: float
    created_s: int  # since 1970
    model_id: bytes
    instrument: str  # the serial that it was made for, "" where it does not say
    q: Array  # (n,) nodes; empty for the identity
    width: Array  # (n,) B
    c_deg: Array  # (n,) f
    elements: Elements = SINGLE
    sections: Mapping[str, Section] = field(default_factory=dict)  # what else is undone, raw (common/tl_table.h)


def model_id(model: Model, joints: Mapping[str, Joint] | None = None) -> bytes:
    """The model's id, 8 bytes: a hash over unit, range and resolution of its motor, B, elements, f, delay and the
    sections that undo effects. joints: as of `encode`."""
    model, sections = tables_and_sections(model, joints)
    actuator = model.rig.actuator
    digest = hashlib.sha256(repr((actuator.unit, actuator.range, actuator.encoder_resolution, model.delay_s)).encode())
    shares = () if model.elements.single else (model.elements.width, model.elements.weight)
    for values in (model.q, model.width, model.c_deg, *shares):
        digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    if sections:
        digest.update(repr(sorted(sections.items())).encode())
    return digest.digest()[:8]


def encode(
    model: Model,
    axis: int = 0,
    limits: Limits | None = None,
    kind: str = "bending",
    created_s: int | None = None,
    instrument: str | None = None,
    joints: Mapping[str, Joint] | None = None,
) -> bytes:
    """Encodes the model as a blob for `axis`, with the sections that undo its effects. TautError, which says why, where
    a board would refuse it.

    limits: of the compensator, default moderate ones; kind: a key of KINDS; created_s: since 1970, default now; joints:
    which axis of the board moves a column that couples in, by column. instrument: the serial of the one that it was
    made for, at most 8 characters, the rig's where it is None: a board whose settings name another refuses the table.

    B and f are sampled on a grid of 2^k Q8 counts from the lower end of the range, with at most 257 nodes; the last
    node may lie beyond the range, and with several plays the first does: there B is held and f goes on with its last
    slope.
    """
    if model.simulator is not None:
        raise TautError("a model that begins with a simulator is over its tip, not the motor: calibrate for tables")
    identity = model_id(model, joints)
    model, sections = tables_and_sections(model, joints)
    rig = model.rig
    limits = limits or Limits.of(rig)
    if limits.adapt is not None:
        sections = {**sections, "adapt": _adapt_section(limits.adapt, rig)}
    q_raw, step_log2 = _nodes(model)
    q = q_raw * (rig.actuator.encoder_resolution / COUNT)
    width = np.interp(q, model.q, model.width)
    c_deg = interpolate(q, np.asarray(model.q, float), np.asarray(model.c_deg, float))
    fields = _header_fields(rig, axis, limits, kind, model.delay_of(MARKER), created_s)
    fields |= {"q0": int(q_raw[0]), "step_log2": step_log2}
    raw_width = _raw(width / rig.actuator.encoder_resolution * COUNT, "a backlash width")
    serial = instrument if instrument is not None else rig.actuator.instrument or ""
    if len(serial.encode()) > _SERIAL:
        raise TautError(f"instrument {serial!r}: its serial has {_SERIAL} characters at most")
    _check_sections(sections)
    blob: bytes = _native.table_encode(
        fields,
        width=raw_width,
        angle=_raw(c_deg * DEG, "f_remain"),
        model_id=identity,
        instrument=serial,
        plays=_plays_section(model, q_raw.astype(float), raw_width.astype(float)),
        sections=sections,
    )
    return _checked(blob, axis)


def _nodes(model: Model) -> tuple[Array, int]:
    """The table's nodes (n,), Q8 counts, and k, where they are 2^k apart: the least k with which at most
    TABLE_NODES_MAX nodes reach over the range. With several plays, which are looked up a width beyond either end, they
    reach over that too."""
    rig = model.rig
    q_min, q_max = _range(rig)
    if q_max - q_min < 1:
        raise TautError("actuator.range holds less than one encoder step: check actuator.encoder_resolution")
    ends = (0.0, 0.0) if model.elements.single else (float(model.width[0]), float(model.width[-1]))
    below, above = (_counts(width, rig, "a backlash width", _native.TABLE_WIDTH_MAX) for width in ends)
    span = q_max - q_min + below + above
    step_log2 = next(k for k in range(32) if -(-span >> k) <= _native.TABLE_NODES_MAX - 1)  # -(-a >> k): rounded up
    return q_min - below + (np.arange(-(-span >> step_log2) + 1, dtype=np.int64) << step_log2), step_log2


def _check_sections(sections: Mapping[str, Section]) -> None:
    """Raises TautError where a number of a section does not fit in 32 bits."""
    for name, section in sections.items():
        if any(abs(value) > INT32_MAX for values in section.values() for value in np.ravel(values).tolist()):
            raise TautError(
                f"section {name}, which undoes an effect, is too large for the board's numbers: diagnose again"
            )


def _adapt_section(adapt: tuple[float, float, float], rig: Rig) -> Section:
    """The blob's section `adapt`: how far tables may be moved in use. adapt: the largest offset, unit of q, and the
    least and largest share of B."""
    offset, least, most = adapt
    return {
        "offset": _counts(offset, rig, "limits.adapt"),
        "width_least_q15": _whole(least * _native.RATIO_ONE, "limits.adapt", 0, _native.RATIO_ONE),
        "width_most_q15": _whole(most * _native.RATIO_ONE, "limits.adapt", _native.RATIO_ONE, 2 * _native.RATIO_ONE),
    }


def _plays_section(model: Model, q: Array, width: Array) -> dict[str, Any] | None:
    """Section 1 of the blob, several plays, for widths (n,) at nodes q (n,), Q8 counts. The board interpolates the warp
    linearly between nodes; until that is accurate enough, `narrow`, the width below which B counts as that wide, is
    raised. None for a single play, or where `narrow` would exceed all of B: a single play is then used."""
    elements, unit = model.elements, model.rig.actuator.encoder_resolution / COUNT
    if elements.single:
        return None
    ends = np.rint(np.cumsum(elements.weight) * _WEIGHT).astype(int)
    weight_q16 = np.diff(ends, prepend=0)  # whole numbers that sum to _WEIGHT exactly
    width_share = np.array(elements.width) * _WEIGHT / (weight_q16 @ np.array(elements.width))  # mean 1 by weight_q16
    narrow = model.play.narrow / unit
    while narrow < width.max():
        warp = warp_of(model.q, model.width, narrow * unit)
        floored = np.maximum(np.interp(q * unit, model.q, model.width), narrow * unit)
        centre = np.interp(q * unit - 0.5 * floored, warp.q, warp.x) + 0.5  # G(p - B/2) + 1/2: the period's middle
        if _warp_error(q, width, narrow, centre) <= 1.0:
            periods, widest = float(np.abs(centre).max()), float(width_share[-1])
            # Binary places of a period, as many as leave the warp and half the widest element within their numbers.
            log2 = min(
                _PERIOD_LOG2,
                int(np.floor(np.log2(_native.TABLE_CENTRE_MAX / periods))),
                int(np.ceil(_HALF_LOG2 + 1 - np.log2(widest))) - 1,
            )
            return {
                "period_log2": log2,
                "narrow": int(np.ceil(narrow)) if (width < narrow).any() else 0,
                "width_q28": np.rint(width_share * _SHARE).astype(int).tolist(),
                "weight_q16": weight_q16.tolist(),
                "centre": _raw(centre * 2.0**log2, "the warp of the play's elements"),
            }
        narrow *= _WIDER
    return None


def _warp_error(q: Array, width: Array, narrow: float, centre: Array) -> float:
    """The largest error of the warp, interpolated linearly between nodes (a period should be 1), relative to the error
    that is allowed, where B is wider than `narrow`: at most 1 is accurate enough. q, width (n,): nodes and B, Q8
    counts; centre (n,): the warp at the nodes, in periods."""
    floored = np.maximum(width, narrow)
    up_at, down_at = q + 0.5 * floored, q - 0.5 * floored  # where the motor pushes p = q up, and down
    motor = np.linspace(up_at[0], down_at[-1], 4 * len(q))
    p_low, p_high = np.interp(motor, up_at, q), np.interp(motor, down_at, q)
    width_low, width_high = (np.interp(p, q, width) for p in (p_low, p_high))
    wide = (width_low > narrow) & (width_high > narrow)
    counts, share = _WARP_OFF
    off = np.abs(np.interp(p_high, q, centre) - np.interp(p_low, q, centre) - 1.0)
    allowed = np.maximum(counts * COUNT, share * width_low)
    return float((off * width_low / allowed)[wide].max(initial=0.0))


def decode(blob: bytes, axis: int | None = None) -> Table:
    """Reads a blob into physical units. TautError, with the reason, where a board would refuse it for `axis`, or for
    any axis where that is None."""
    try:
        fields = _native.FixedTable(blob, _native.TABLE_ANY_AXIS if axis is None else axis).fields
    except ValueError as error:
        raise TautError(f"the table is refused: {error}") from error
    resolution = fields["nano_units_per_count"] * _NANO
    unit = resolution / COUNT
    q_range = (fields["q_min"] * unit, fields["q_max"] * unit)
    c_min, c_max = fields["coarse_c_min"] / DEG, fields["coarse_c_max"] / DEG
    gain = (c_max - c_min) / (q_range[1] - q_range[0])
    nodes = np.arange(len(fields["width"]), dtype=np.int64)
    return Table(
        axis=fields["axis"],
        kind=_KIND_NAMES[fields["kind"]],
        unit=_UNIT_NAMES[fields["unit"]],
        encoder_resolution=resolution,
        q_range=q_range,
        coarse_gain=gain,
        coarse_offset=c_min - gain * q_range[0],
        limits=Limits(
            speed_max=fields["speed_max_q8"] * unit,
            takeup_speed=fields["takeup_speed_q8"] * unit,
            takeup_accel=fields["takeup_accel"] * resolution,
            band=fields["band"] * unit,
            slope_min=fields["slope_min_q28"] / _SLOPE / resolution,
            flat_speed=fields["flat_speed_q8"] * unit,
            strength=fields["strength_q15"] / _native.RATIO_ONE,
            adapt=_adapt_limits(fields["sections"].get("adapt"), unit),
        ),
        delay_s=fields["delay_us"] * 1e-6,
        created_s=fields["created_s"],
        model_id=fields["model_id"],
        instrument=fields["instrument"],
        q=(fields["q0"] + (nodes << fields["step_log2"])) * unit,
        width=fields["width"] * unit,
        c_deg=fields["angle"] / DEG,
        elements=_elements(fields["plays"]),
        sections=fields["sections"],
    )


def _adapt_limits(section: Mapping[str, int] | None, unit: float) -> tuple[float, float, float] | None:
    """`Limits.adapt` by the blob's section `adapt`: the largest offset, unit of q, and the least and largest share of
    B; None without that section. unit: unit of q per Q8 count."""
    if section is None:
        return None
    least, most = (section[f"width_{name}_q15"] / _native.RATIO_ONE for name in ("least", "most"))
    return section["offset"] * unit, least, most


def _elements(plays: dict[str, Any] | None) -> Elements:
    """The play's elements by the blob's section 1, their mean width scaled to 1; a single one without that section."""
    if plays is None:
        return SINGLE
    weight = np.array(plays["weight_q16"]) / _WEIGHT
    width = np.array(plays["width_q28"]) / _SHARE
    return Elements(tuple((width / (weight @ width)).tolist()), tuple(weight.tolist()))


def _header_fields(
    rig: Rig, axis: int, limits: Limits, kind: str, delay_s: float, created_s: int | None
) -> dict[str, int]:
    """The fields of the blob's header, in the board's units. TautError, which names the field, for a value that does
    not fit, and for an unknown kind or axis. delay_s: of the camera, below 0 counts as 0; created_s: since 1970, by
    default now."""
    if kind not in KINDS:
        raise TautError(f"{kind!r} is not a kind of axis: {', '.join(KINDS)}")
    if not 0 <= axis < _native.TABLE_AXES:
        raise TautError(f"axis {axis} does not exist: a board has axes 0 to {_native.TABLE_AXES - 1}")
    resolution = rig.actuator.encoder_resolution
    coarse = [_angle(rig.coarse.gain * q + rig.coarse.offset, "the coarse kinematics") for q in rig.actuator.range]
    return {
        "axis": axis,
        "kind": KINDS[kind],
        "unit": _native.AXIS_UNITS[rig.actuator.unit],
        "strength_q15": _whole(limits.strength * _native.RATIO_ONE, "limits.strength", 0, int(np.iinfo(np.uint16).max)),
        "nano_units_per_count": _whole(resolution / _NANO, "actuator.encoder_resolution", 1, _UINT32_MAX),
        "q_min": _range(rig)[0],
        "q_max": _range(rig)[1],
        "coarse_c_min": coarse[0],
        "coarse_c_max": coarse[1],
        "speed_max_q8": _counts(limits.speed_max, rig, "limits.speed_max"),
        "takeup_speed_q8": _counts(limits.takeup_speed, rig, "limits.takeup_speed"),
        "takeup_accel": _whole(limits.takeup_accel / resolution, "limits.takeup_accel", 0, INT32_MAX),
        "band": _counts(limits.band, rig, "limits.band"),
        "slope_min_q28": _whole(limits.slope_min * resolution * _SLOPE, "limits.slope_min", 0, INT32_MAX),
        "flat_speed_q8": _counts(limits.flat_speed, rig, "limits.flat_speed"),
        # a recording's clock may run ahead of its camera; a live camera's cannot
        "delay_us": _whole(max(delay_s, 0.0) * _US, "delay_s", 0, _UINT32_MAX),
        "created_s": _whole(int(time.time()) if created_s is None else created_s, "created_s", 0, _UINT32_MAX),
    }


def _range(rig: Rig) -> tuple[int, int]:
    """The motor's lowest and highest position, Q8 counts. TautError where a board cannot compute with them."""
    low, high = (_counts(q, rig, "actuator.range", _native.TABLE_POSITION_MAX) for q in rig.actuator.range)
    return low, high


def _counts(value: float, rig: Rig, name: str, most: int = _native.TABLE_VALUE_MAX) -> int:
    """The value, unit of q, in Q8 counts. TautError, which calls it `name`, where it is above `most`, Q8 counts, or not
    finite."""
    counts = value / rig.actuator.encoder_resolution
    if not abs(counts) * COUNT <= most:
        raise TautError(
            f"{name} is {counts:.0f} counts, and a board computes with {most // _native.COUNT_ONE} at most: "
            "check it and actuator.encoder_resolution"
        )
    return round(counts * COUNT)


def _angle(value: float, name: str) -> int:
    """The value, deg, in the board's Q16. TautError, which calls it `name`, where it does not fit."""
    limit: int = _native.TABLE_VALUE_MAX
    return _whole(value * DEG, name, -limit, limit)


def _whole(value: float, name: str, low: int, high: int) -> int:
    """The value rounded to a whole number. TautError, which calls it `name`, where that is not within low .. high or
    not finite."""
    if not np.isfinite(value) or not low <= round(value) <= high:
        raise TautError(
            f"{name} is too large or too small for the board's numbers: check it and the encoder resolution"
        )
    return round(value)


def _raw(values: Array, name: str) -> Array:
    """Values (n,), in the board's unit already, rounded to int32. TautError, which calls them `name`, where they do not
    fit."""
    limit = float(_native.TABLE_VALUE_MAX)
    if not np.all(np.isfinite(values)) or np.abs(values).max() > limit:
        raise TautError(f"{name} is too large for the board's numbers or not finite: check the model and its units")
    raw: Array = np.rint(values).astype(np.int32)
    return raw


def _checked(blob: bytes, axis: int) -> bytes:
    """Returns the blob if the board's own check accepts it for this axis. TautError with the board's reason where it
    does not."""
    name, text = _native.table_check(blob, axis)
    if name != "OK":
        raise TautError(f"the model cannot be loaded into a board: {text}")
    return blob
