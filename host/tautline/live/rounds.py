"""Plans the rounds of a live calibration: which motion comes next, whether B(q) is known well enough, and why it cannot
become so.

Nothing here moves anything: a `Round` is what the board is asked for, a `Standing` what the recording so far says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.calibration.coverage import Gap, not_measured
from tautline.calibration.onset import BOUND
from tautline.calibration.result import Calibration
from tautline.effects import OWNER
from tautline.errors import TautError
from tautline.rig import Actuator

Array = npt.NDArray[np.float64]
Span = tuple[float, float]

# Shares of the range.
_FRAME = 0.0224  # per frame at most: 5.6 mm/s of 10 mm at 25 Hz; much faster leaves too few frames a knot
_SECOND = 0.56  # per second at most, however fast the camera
_APPROACH, _STROKE, _LONGEST_STROKE = 0.03, 0.25, 0.45  # before a turn; a reversal without an onset: usually, at most
_ABOVE = 1.001  # tolerance: times the top speed, which the board rounds to its counts
_WHOLE = 0.4  # where strokes would take more of the range, passes over all of it are made
BESIDE = 0.02  # strokes go on for the backlash and so much more beyond what they measure

_OF_TOP_SPEED, _OF_TOP_ACCELERATION = 0.4, 0.8  # of the axis' limits
_RAMP_S = 0.05  # from rest to measuring speed
_SPEEDS = (1.0, 0.6, 0.8, 0.5)  # shares of the fastest, of the rounds in turn: so B by speed is told from a delay
_CYCLES = 3  # turning points of a pass
_LATENCY_S = 0.4  # from an onset until the board has confirmed it
_MOST_PASSES = 4
_FRAMES_A_STROKE = 6  # in which the tip moves, at least
_STROKES = (1, 6)  # there and back, at least and at most
_AIM = 0.9  # share of the goal above which a place is measured further: else its neighbour would need the next round
FEWEST = 2  # rounds that are made before a calibration gives up
# What the board takes for an onset, in shares of the range: it ends strokes, it measures nothing.
_SIGMA_WANTED, _SIGMA_USABLE = 1e-3, 1e-2

_BY_SPEED = OWNER["width_per_speed"].id  # the effect of a B that depends on the motor's speed
_HOPELESS = 2.0  # a goal that needs more than this many times the longest time allowed is given up at once
_UNTIL_MM, _UNTIL_SHARE = 3e-3, 5e-4  # the usual goal for sigma of B: mm; share of a range in deg


@dataclass(frozen=True)
class Round:
    """One run of the board's calibration motion. Lengths in the rig's unit, speeds in it per second."""

    low: float
    high: float
    speeds: tuple[float, ...]  # of its passes, one out and one back each
    cycles: int  # turning points of a pass
    transit: float  # speed where nothing is measured
    acceleration: float  # unit/s^2
    approach: float  # on the envelope before each turn, at the pass's speed
    stroke: float  # a reversal without an onset ends here
    sigma_wanted: float  # an onset as good as this ends its stroke
    sigma_usable: float  # one that is vaguer is not used

    def says(self, unit: str) -> str:
        """Returns the round in words, with its positions and speeds. unit: of q."""
        speeds = " and ".join(f"{speed:.3g}" for speed in dict.fromkeys(self.speeds))
        return f"{self.low:.3g} to {self.high:.3g} {unit} at {speeds} {unit}/s"


@dataclass(frozen=True)
class Stroke:
    """Moves there and back between two positions. In the rig's unit."""

    low: float
    high: float
    speed: float  # unit/s
    times: int  # there and back


@dataclass(frozen=True)
class Strokes:
    """A round of slow strokes at one place after the other, where B(q) is known worst."""

    places: tuple[Stroke, ...]
    transit: float  # speed between places, the rig's unit/s

    def says(self, unit: str) -> str:
        """Returns the strokes in words, with their positions. unit: of q."""
        return " and ".join(f"{place.low:.3g} to {place.high:.3g} {unit}" for place in self.places) + " and back"


@dataclass(frozen=True)
class Means:
    """What a set-up allows for the motions of a calibration. In the unit of q."""

    low: float  # of the range
    high: float
    speeds: tuple[float, ...]  # of the rounds in turn, unit/s
    acceleration: float  # unit/s2
    frame_s: float  # from one frame to the next

    @classmethod
    def of(
        cls, low: float, high: float, frame_rate_hz: float, top_speed: float, top_acceleration: float,
        speeds: tuple[float, ...] | None = None,
    ) -> Means:  # fmt: skip
        """Chooses speeds (unless `speeds` are given) and acceleration of calibration passes over the range from low to
        high. The fastest speed is the least of: _FRAME of the range per frame, _SECOND of it per second, a share of the
        motor's top speed, and what a share of its top acceleration reaches within _RAMP_S. The rounds take the shares
        _SPEEDS of that. All in the unit of q."""
        if speeds is None:
            fast = min(
                _FRAME * frame_rate_hz * (high - low), _SECOND * (high - low), _OF_TOP_SPEED * top_speed,
                _OF_TOP_ACCELERATION * top_acceleration * _RAMP_S,
            )  # fmt: skip
            speeds = tuple(fast * share for share in _SPEEDS)
        acceleration = min(max(speeds) / _RAMP_S, _OF_TOP_ACCELERATION * top_acceleration)
        return cls(low, high, speeds, acceleration, 1.0 / frame_rate_hz)

    @property
    def span(self) -> float:
        """Length of the range, unit of q."""
        return self.high - self.low


@dataclass(frozen=True)
class Place:
    """A stretch of positions of the centre coordinate p, unit of q."""

    low: float
    high: float
    sigma: float  # the largest standard deviation of B in it, unit of q


@dataclass(frozen=True)
class Standing:
    """How well B(q) is known so far: its largest standard deviation, `worst`, is at `where`."""

    worst: float  # one standard deviation, unit of q
    where: float  # position, unit of q
    need: tuple[Place, ...]  # where sigma is above _AIM times the goal
    ends: Span  # of what is measured, unit of q
    missing: tuple[Gap, ...]  # where B can be seen and is not measured yet, the lowest first
    widest: float  # the largest B, unit of q
    unmoved: float  # the longest stroke that moved nothing, unit of q; 0 where none did
    work: float  # time that the goal takes everywhere, in times of the time so far
    doubt: str  # the calibration's first reason that is not mild, in words; empty where it has none
    by_speed: bool = False  # whether B may depend on the motor's speed

    @classmethod
    def of(cls, calibration: Calibration, low: float, high: float, until: float) -> Standing:
        """Takes from a calibration of what was recorded so far how well it knows B. low, high: the range; until: the
        wanted sigma of B; all in the unit of q. Where the calibration has measured no B yet, sigma is infinite."""
        model = calibration.model
        # A reversal without an onset (BOUND) tells only that B is longer than its stroke.
        unmoved = max((onset.low for onset in calibration.onsets if onset.used and onset.kind == BOUND), default=0.0)
        doubt = next((str(reason) for reason in model.quality.reasons if not reason.mild), "")
        inside = model.is_measured
        if not inside.any() or model.measured[0] >= model.measured[1]:
            return cls(
                worst=np.inf, where=0.5 * (low + high), need=(), ends=(low, high),
                missing=(Gap(low, high, "no turn gave a width"),), widest=0.0, unmoved=unmoved, work=np.inf,
                doubt=doubt,
            )  # fmt: skip
        q, widest = model.q[inside], float(model.width[inside].max())
        sigma = np.where(np.isfinite(model.width_sigma), model.width_sigma, np.inf)[inside]
        worst = int(np.argmax(sigma))
        return cls(
            worst=float(sigma[worst]),
            where=float(q[worst]),
            need=_insufficient_places(q, sigma, until, widest),
            ends=(float(q[0]), float(q[-1])),
            missing=calibration.gaps,
            widest=widest,
            unmoved=unmoved,
            work=float(np.mean(np.maximum(sigma / until, 1.0) ** 2)),  # variance falls as time grows
            doubt=doubt,
            by_speed=any(reason.code == _BY_SPEED for reason in model.quality.reasons),
        )

    @property
    def covered(self) -> bool:
        """Whether B is measured, well or not, wherever it can be seen, but for a little at the ends."""
        return not self.missing

    def reached(self, until: float) -> bool:
        """Whether sigma of B is `until` or less, unit of q, wherever B can be seen."""
        return self.covered and self.worst <= until

    def share(self, until: float) -> float:
        """Returns the progress towards the goal `until` (sigma of B, unit of q), 0 to 1: the wanted variance over the
        present one, as variance falls in inverse proportion to time."""
        return min((until / self.worst) ** 2, 1.0) if self.worst > 0 else 1.0


def _insufficient_places(q: Array, sigma: Array, until: float, apart: float) -> tuple[Place, ...]:
    """Finds the stretches of positions q (n,) where sigma of B (n,) is above _AIM times the goal `until`; stretches
    that are `apart` or less from each other are joined. All in the unit of q."""
    too_vague = np.flatnonzero(sigma > _AIM * until)
    runs = np.split(too_vague, np.flatnonzero(np.diff(q[too_vague]) > apart) + 1) if len(too_vague) else []
    return tuple(Place(float(q[run[0]]), float(q[run[-1]]), float(sigma[run].max())) for run in runs)


def check_speeds(speeds: Sequence[float], top_speed: float, unit: str) -> None:
    """TautError where a speed is above the axis' top speed, unit of q per s."""
    if max(speeds) > _ABOVE * top_speed:
        raise TautError(f"the axis moves at {top_speed:.6g} {unit}/s at most: give --speed up to that")


def default_until(actuator: Actuator) -> float:
    """Returns the goal, a standard deviation of B in the unit of q, for a user who names none: 3 um, or 0.05 % of the
    range of an actuator in deg."""
    return _UNTIL_MM if actuator.unit == "mm" else _UNTIL_SHARE * actuator.span


def in_words(sigma: float, unit: str) -> str:
    """Formats a standard deviation, unit of q, for a person: in um where the unit is mm; "unknown" where it is not
    finite."""
    if not np.isfinite(sigma):
        return "unknown"
    return f"{1e3 * sigma:.2g} µm" if unit == "mm" else f"{sigma:.2g} {unit}"


# -- the next round ---------------------------------------------------------------------------------------------------


def strokes_made(done: Sequence[Round | Strokes]) -> bool:
    """Whether there are strokes among the rounds that are done. The first round is always of passes, and a small sigma
    is believed only once both kinds have been made."""
    return any(isinstance(made, Strokes) for made in done)


def first_round(means: Means) -> Round:
    """The first round: one pass over all of the range, out and back, at the highest speed."""
    return _round_over(means, means.speeds[:1])


def next_round(
    means: Means, standing: Standing, until: float, done: Sequence[Round | Strokes], seconds: float
) -> Round | Strokes:
    """Chooses the round after those that are `done`, which took `seconds` s. The first of these that applies: a pass at
    the slowest speed, if `slower_pass_tells`; a pass over the whole range, if some of it is not measured; strokes where
    sigma of B is too large for the goal `until`, unit of q, and the first time also at both ends, where a pass stays
    for a frame or two only; if these places are much of the range, as many passes over all of it as the goal needs."""
    if slower_pass_tells(means, standing, until, done):
        return _round_over(means, (min(means.speeds),))
    speed = means.speeds[len(done) % len(means.speeds)]
    if not standing.covered:
        return _round_over(means, (speed,), _LONGEST_STROKE if standing.unmoved > 0 else _STROKE)
    variance_ratio = (standing.worst / until) ** 2  # the present one over that of the goal
    need = standing.need if strokes_made(done) else _with_ends(standing, until)
    if sum(place.high - place.low for place in need) <= _WHOLE * means.span:
        return Strokes(
            tuple(_stroke_for(means, place, standing.widest, until, seconds) for place in need), means.speeds[0]
        )
    # A place's variance falls in inverse proportion to the time spent there. A pass crosses the range out and back, and
    # at each of its turning points the backlash, the approach and what the board takes to confirm, there and back.
    approach = _APPROACH * means.span
    pass_s = (2 * means.span + 4 * _CYCLES * (standing.widest + approach + _LATENCY_S * speed)) / speed
    passes = int(np.clip(np.ceil(seconds * (variance_ratio - 1.0) / pass_s), 1, _MOST_PASSES))
    return _round_over(means, (speed,) * passes)


def slower_pass_tells(means: Means, standing: Standing, until: float, done: Sequence[Round | Strokes]) -> bool:
    """Whether to make a pass at the slowest speed: B may depend on speed, the range is covered, the goal `until`, unit
    of q, is not reached, and no such pass was made yet. At one speed such an effect looks nearly like a delay, and what
    remains of it may be chance."""
    slowest = min(means.speeds)
    slow_pass_made = any(isinstance(each, Round) and min(each.speeds) <= slowest for each in done)
    return standing.by_speed and standing.covered and standing.worst > until and not slow_pass_made


def why_another(standing: Standing, until: float, unit: str, done: Sequence[Round | Strokes]) -> str:
    """Says why another round follows those that are `done`. until: the goal, a sigma of B in unit of q."""
    if not standing.covered:
        return f"{not_measured([(gap.low, gap.high) for gap in standing.missing], unit)} yet"
    sigma, wanted = in_words(standing.worst, unit), in_words(until, unit)
    if standing.by_speed and not standing.reached(until):
        return f"sigma is {sigma} where {wanted} is wanted, as B may go with the motor's speed"
    if standing.reached(until) and not strokes_made(done):
        return f"sigma is {sigma} where {wanted} is wanted, but passes alone are not believed: turns at both ends first"
    return f"sigma is {sigma} at {standing.where:.3g} {unit} where {wanted} is wanted"


def no_longer_reached(best: float, standing: Standing, until: float, unit: str) -> str:
    """Returns an addition to the text on why the goal was not reached, where it had looked reached after an earlier
    round; else "". best: the smallest worst sigma after any round; until: the goal; both in unit of q."""
    if best > until or standing.reached(until):
        return ""
    return (
        f"; sigma looked like {in_words(best, unit)} before, and what was measured since does not bear that out: the "
        "larger one is kept"
    )


def _with_ends(standing: Standing, until: float) -> tuple[Place, ...]:
    """Returns the places whose sigma is too large, and both ends of what is measured, from low to high. An end that is
    added has no length, and the goal `until` as its sigma."""
    first, last = (Place(end, end, until) for end in standing.ends)
    need = standing.need
    below = () if need and need[0].low <= first.low else (first,)
    above = () if need and need[-1].high >= last.high else (last,)
    return (*below, *need, *above)


def _stroke_for(means: Means, place: Place, widest: float, until: float, seconds: float) -> Stroke:
    """Plans the strokes across a place: longer than it by half the `widest` B and a margin on either side, slow enough
    for _FRAMES_A_STROKE frames in which the tip moves, and as often as the goal `until` takes there. seconds: what all
    rounds so far took. Lengths and sigmas in the unit of q."""
    beside = BESIDE * means.span
    reach = 0.5 * widest + beside
    low, high = max(place.low - reach, means.low), min(place.high + reach, means.high)
    tip_moves = place.high - place.low + 2 * beside
    speed = min(_SPEEDS[1] * means.speeds[0], tip_moves / (_FRAMES_A_STROKE * means.frame_s))
    # A place's variance falls in inverse proportion to the time spent there: its share of `seconds` so far. Next to the
    # ends of the range that was one visit, and strokes there and back are two: hence half the ratio at least.
    variance_ratio = (place.sigma / until) ** 2  # the present one over that of the goal
    wanted_s = (variance_ratio - 1.0) * seconds * tip_moves / means.span
    times = int(np.clip(np.ceil(max(0.5 * variance_ratio, 0.5 * wanted_s * speed / tip_moves)), *_STROKES))
    return Stroke(low, high, speed, times)


def _round_over(means: Means, speeds: tuple[float, ...], stroke: float = _STROKE) -> Round:
    """Returns a round of passes over all of the range at these speeds, unit/s. stroke: share of the range after which a
    reversal without an onset ends."""
    span = means.span
    return Round(
        means.low, means.high, speeds, _CYCLES, transit=max(means.speeds[0], *speeds), acceleration=means.acceleration,
        approach=_APPROACH * span, stroke=stroke * span, sigma_wanted=_SIGMA_WANTED * span,
        sigma_usable=_SIGMA_USABLE * span,
    )  # fmt: skip


# -- why it never will be ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CameraView:
    """How well the camera has seen the marker so far."""

    noise_px: float  # from frame to frame at rest; NaN where it never rested
    unseen: Span  # positions at which the marker was mostly lost, empty (0, 0)


def why_not(
    standing: Standing, until: float, unit: str, camera: CameraView, seconds: float, at_most_s: float, rounds: int
) -> str:
    """Says why the goal cannot be reached, a sentence with its remedy; "" where it is reached or may be yet. A
    calibration is given up when the time is up, or after FEWEST rounds where a part of the range is not measured or the
    goal would take more than _HOPELESS times at_most_s. until: the goal, unit of q; seconds: the time so far; rounds:
    how many were made."""
    out_of_time = seconds >= at_most_s
    if standing.reached(until) or (rounds < FEWEST and not out_of_time):
        return ""
    if not standing.covered:
        return _why_not_measured(standing, unit, camera)
    needed = seconds * standing.work
    if not out_of_time and needed <= _HOPELESS * at_most_s:
        return ""
    worst = f"sigma is {in_words(standing.worst, unit)} at {standing.where:.3g} {unit}"
    low, high = camera.unseen
    if low - standing.widest < standing.where < high + standing.widest and low < high:
        return f"{worst}: {_marker_not_seen(camera, unit)}"
    if standing.doubt:
        return f"{worst}, and more frames of the same do not help: {standing.doubt}"
    noise = f" with {camera.noise_px:.2g} px of noise in the marker" if np.isfinite(camera.noise_px) else ""
    time = f", and {needed:.0f} s would be needed" if np.isfinite(needed) else ""
    return (
        f"{worst}{noise}{time}: steady the camera, light or enlarge the marker, name a larger --until, or give it time "
        "with --at-most"
    )


def _why_not_measured(standing: Standing, unit: str, camera: CameraView) -> str:
    """Says why B could not be measured in a part of the range, with a remedy."""
    if camera.unseen[0] < camera.unseen[1]:
        return _marker_not_seen(camera, unit)
    if standing.unmoved > 0:
        return (
            f"strokes of {standing.unmoved:.3g} {unit} moved nothing: the range leaves no room to cross the backlash: "
            "check that the tip is free to move, or widen actuator.range in rig.toml"
        )
    missing = "; ".join(gap.says(unit) for gap in standing.missing)
    return f"{missing}; see that the tip is free to move there and that the marker is found"


def _marker_not_seen(camera: CameraView, unit: str) -> str:
    """Says at which positions the marker was lost, with a remedy."""
    low, high = camera.unseen
    return (
        f"the marker is not seen from {low:.3g} to {high:.3g} {unit}: bring it into view there, or take these "
        "positions out of actuator.range in rig.toml"
    )
