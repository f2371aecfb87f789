"""A live calibration that goes on until B(q) is known well enough, and says why where that cannot be."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from tautline.calibration.options import Options
from tautline.calibration.result import Calibration
from tautline.errors import TautError
from tautline.live.rounds import (
    Means,
    Round,
    Standing,
    Strokes,
    check_speeds,
    default_until,
    first_round,
    in_words,
    next_round,
    no_longer_reached,
    slower_pass_tells,
    strokes_made,
    why_another,
    why_not,
)
from tautline.live.session import Motion, Motions, check_rig, moving, probe
from tautline.live.setup import Frame, Live
from tautline.live.watch import Show, View, Watch

AT_MOST_S = 120.0  # that a calibration takes, unless the user says otherwise
_LOST_S = 3.0  # a marker that was not seen for so long does not come back by itself
_FINEST = 0.02  # of a count: a finer goal is refused


@dataclass(frozen=True)
class Goal:
    """How well B(q) is to be known: everywhere that it can be seen, as one standard deviation in unit of q."""

    until: float | None = None  # None: what suits the rig
    at_most_s: float = AT_MOST_S
    speeds: tuple[float, ...] | None = None  # of the rounds in turn, unit/s


@dataclass(frozen=True)
class Reached:
    """How far a calibration came towards its goal."""

    motion: Motion
    rounds: tuple[Round | Strokes, ...]  # that were made
    standing: Standing  # in the end
    until: float  # the goal for sigma of B, unit of q
    why: str  # why the goal was not reached, empty where it was

    @property
    def reached(self) -> bool:
        """Whether the goal was reached."""
        return not self.why


def calibrate_until(
    live: Live,
    folder: Path,
    goal: Goal | None = None,
    options: Options | None = None,
    video: bool = False,
    show: Show | None = None,
    progress: Callable[[float, str], None] | None = None,
    resting: Callable[[], bool] = lambda: False,
) -> tuple[Calibration, Reached]:
    """Calibrates a live set-up as quickly as it can: fast passes over the range, then rounds where B(q) is known worst,
    until the goal is reached or out of reach. All is recorded in `folder`; the calibration is what `calibrate` with
    `options` makes of that recording. show: gets what is known after every frame; progress: the share done, 0 to 1, and
    a word. While `resting()` is true the axis rests, motor on, at the end of its stroke; the interrupted round is then
    made again. Stopped at any time (Ctrl-C, an error), the axis comes to rest and what was recorded stays. TautError
    where the rig does not fit, or the goal is finer than the encoder can tell."""
    check_rig(live)
    goal = goal or Goal()
    until = _checked_until(live, goal)
    means = _means(live, goal)
    low, high = live.rig.actuator.range
    with moving(live, folder, low, high, video) as motions:
        view = View(low, high, live.rig.actuator.unit, until, "checking scale and sign", onsets=motions.made.onsets)

        def shown(view: View) -> None:
            """Hands what is known on to `show` and `progress`."""
            if show:
                show(view)
            if progress:
                progress(view.share, f"{view.reversals} reversals")

        with closing(Watch(live, motions.recorder, view, options, shown)) as watch:
            shown(view)

            def on_probe_frame(frame: Frame) -> None:
                """Records and shows a frame of the probe, in which no reversal is counted."""
                motions.recorder.add(frame)
                watch.frame(frame, 0)

            probe(live, on_probe_frame, means.speeds[0])
            if resting():
                watch.rest(resting)
            rounds, why = _make_rounds(motions, watch, means, until, goal.at_most_s, resting)
        calibration, standing = view.calibration, view.standing
    assert calibration is not None and standing is not None
    return calibration, Reached(motions.made, tuple(rounds), standing, until, why)


def _checked_until(live: Live, goal: Goal) -> float:
    """Returns the sigma of B to aim at, unit of q: the goal's, else what suits the rig. TautError where it is finer
    than _FINEST of an encoder count."""
    unit, default = live.rig.actuator.unit, default_until(live.rig.actuator)
    until = default if goal.until is None else goal.until
    if until < _FINEST * live.resolution:
        raise TautError(
            f"{in_words(until, unit)} is far below the encoder's count of {live.resolution:g} {unit}: name the goal "
            f"with its unit, as in --until '{in_words(default, unit)}'"
        )
    return until


def _means(live: Live, goal: Goal) -> Means:
    """Returns what rounds are planned with: the range, the camera's frame rate, the motor's limits and the goal's
    speeds."""
    camera = live.rig.camera
    assert camera is not None  # check_rig
    limits = live.board.ask("get_limits", axis=live.axis)
    acceleration, top_speed = float(limits.acceleration_s2) * live.resolution, live.top_speed
    if goal.speeds:
        check_speeds(goal.speeds, top_speed, live.rig.actuator.unit)
    return Means.of(*live.rig.actuator.range, camera.frame_rate_hz, top_speed, acceleration, goal.speeds)


class _MarkerLoss:
    """Notices where the marker has been lost for so long that it does not come back by itself."""

    def __init__(self, folder: Path) -> None:
        """folder: of the recording, for the error."""
        self._folder = folder
        self._since_s: float | None = None  # None where the marker is seen

    def check(self, frame: Frame, now_s: float) -> None:
        """Takes in the next frame at now_s, s. TautError where the marker has not been seen for more than _LOST_S."""
        if frame.sighting.valid:
            self._since_s = None
        elif self._since_s is None:
            self._since_s = now_s
        elif now_s - self._since_s > _LOST_S:
            raise TautError(
                f"the marker was last seen {now_s - self._since_s:.0f} s ago: bring it into view, or pick its "
                f"colour again with 'taut marker'; what was recorded is in {self._folder}"
            )


def _make_rounds(
    motions: Motions, watch: Watch, means: Means, until: float, at_most_s: float, resting: Callable[[], bool]
) -> tuple[list[Round | Strokes], str]:
    """Makes rounds until the goal `until` (sigma of B, unit of q) is reached or out of reach, for at_most_s at most.
    Returns the rounds made, and why the goal was not reached ("" if it was). resting: as in `calibrate_until`."""
    view = watch.view
    rounds: list[Round | Strokes] = []
    best = float("inf")  # the smallest of the worst sigmas after each round
    loss = _MarkerLoss(motions.made.folder)

    def enough(frame: Frame) -> bool:
        """Takes in a frame; returns whether the present round may end: the goal is reached, or the time is up.
        TautError where the marker has been lost for too long."""
        fresh = watch.frame(frame, motions.made.reversals)
        loss.check(frame, view.seconds)
        reached = fresh and view.standing is not None and view.standing.reached(until)
        return view.seconds > at_most_s or (reached and strokes_made(rounds[:-1]))

    while True:
        standing = view.standing
        if standing is None or not rounds:
            wanted: Round | Strokes = first_round(means)
            because = ""
        else:
            wanted = next_round(means, standing, until, rounds, view.seconds)
            because = f" ({why_another(standing, until, view.unit, rounds)})"
            best = min(best, standing.worst if standing.covered else best)
        rounds.append(wanted)
        view.doing = f"round {len(rounds)}: {wanted.says(view.unit)}{because}"
        _make_round(motions, watch, wanted, enough, resting)
        motions.record_rest()
        watch.settle()
        assert view.standing is not None
        if view.standing.reached(until) and strokes_made(rounds):
            return rounds, ""
        why = why_not(view.standing, until, view.unit, watch.camera_view(), view.seconds, at_most_s, len(rounds))
        # While there is time, a slower pass that tells something is made before giving up.
        if why and not (view.seconds < at_most_s and slower_pass_tells(means, view.standing, until, rounds)):
            return rounds, why + no_longer_reached(best, view.standing, until, view.unit)


def _make_round(
    motions: Motions,
    watch: Watch,
    wanted: Round | Strokes,
    enough: Callable[[Frame], bool],
    resting: Callable[[], bool],
) -> None:
    """Makes one round, until it is complete or `enough(frame)`, which gets every frame, is true. Where `resting()`
    becomes true the round is broken off, the axis rests as long as it stays true, and the round is made again from its
    beginning."""
    broken_off = False

    def enough_or_rest(frame: Frame) -> bool:
        """Returns whether the round may end after this frame; sets `broken_off` where a rest was asked for, as that may
        be over before the stroke is."""
        nonlocal broken_off
        ends = enough(frame)
        broken_off = resting() or broken_off
        return ends or broken_off

    while True:
        broken_off = False
        if isinstance(wanted, Strokes):
            motions.stroke(wanted, enough_or_rest)
        else:
            motions.run(wanted, enough_or_rest)
        if not broken_off and not resting():
            return
        watch.rest(resting)
