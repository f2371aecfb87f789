"""A live diagnosis: of what the recordings leave open the board is asked, by the motion that tells most, until one
answer is sure or nothing that it could record would help."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tautline.calibration.clock import on_motor_clock
from tautline.calibration.result import Calibration
from tautline.diagnosis import motion
from tautline.diagnosis.diagnose import Diagnosis, diagnose
from tautline.diagnosis.motion import NextMotion
from tautline.diagnosis.narration import percent
from tautline.errors import TautError
from tautline.live.following import record
from tautline.live.setup import Frame, Live
from tautline.recording import Recording, load

SURE = 0.95
MOTION = "motion.csv"
_TELLS = 0.01  # nats: a motion that is expected to tell less leaves all as likely as it is
_FIRST = "trapezoids"  # nothing is known yet that one could ask for

Progress = Callable[[float, str], None]
Answered = Callable[[Diagnosis, "Leading", str], None]


def answers_of(document: Mapping[str, Any]) -> dict[str, float]:
    """The probability of each effect by its id, and of "none" and "unknown", from a diagnosis.json."""
    probabilities = {c["id"]: float(c["probability"]) for c in document["candidates"]}
    none, unknown = float(document["probability_none"]), float(document["probability_unknown"])
    return probabilities | {"none": none, "unknown": unknown}


@dataclass(frozen=True)
class Leading:
    """The likeliest answer of a diagnosis."""

    name: str  # an effect's id, "none" or "unknown"
    probability: float

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Leading:
        """The likeliest answer of a diagnosis.json."""
        probabilities = answers_of(document)
        name = max(probabilities, key=lambda name: probabilities[name])
        return cls(name, probabilities[name])

    def __str__(self) -> str:
        """Its name and probability, such as "lag (97 %)"."""
        return f"{self.name} ({percent(self.probability)})"


@dataclass(frozen=True)
class Asked:
    """A live diagnosis that has ended."""

    diagnosis: Diagnosis
    recordings: tuple[Path, ...]  # that were made
    answers: tuple[Leading, ...]  # after each
    why: str  # it ended

    @property
    def sure(self) -> bool:
        """Whether the last answer has a probability of SURE or more."""
        return self.answers[-1].probability >= SURE


def why_stop(answers: Sequence[Leading], following: NextMotion | None, most: int) -> str:
    """Why a live diagnosis ends now, in words; "" where the motion `following`, which would come next, is worth
    recording. answers: the leading one after each diagnosis; most: how many diagnoses there may be."""
    last = answers[-1]
    if last.probability >= SURE:
        return f"one answer is sure: {last}"
    if following is None:
        return "no candidate has a path that a motion could tell from another"
    if following.information < _TELLS:
        expected = f"{following.information:.1g} of the {following.entropy:.2g} nats that are open"
        return f"no motion of this axis tells the candidates apart: {following.why} would tell {expected}"
    if len(answers) >= most:
        return "as many recordings were made as --most allows"
    return ""


def diagnose_live(
    live: Live,
    calibrated_on: Calibration,
    calibration: Recording,
    tests: Sequence[Recording],
    folder: Path,
    most: int = 5,
    progress: Progress = lambda fraction, text: None,
    say: Callable[[str], None] = lambda text: None,
    seen: Callable[[Frame], None] = lambda frame: None,
    answered: Answered = lambda diagnosis, leading, why: None,
) -> Asked:
    """Diagnoses, records the motion that tells most, and diagnoses again, until one answer is sure or no motion helps.
    calibrated_on: the calibration that is the nominal, calibration: the recording, on the motor's clock, that it was
    made of; tests: recordings of the instrument as it is now, made before, may be none. folder: empty or new, for the
    recordings; most: how many may be made. say: gets a line after every diagnosis; seen: every frame; answered: after
    every diagnosis that, what leads and why it ends ("" if it goes on). Ctrl-C ends a recording early, which is
    diagnosed all the same. TautError where `folder` is not empty, or the board or camera fails."""
    if folder.exists() and any(folder.iterdir()):
        raise TautError(f"{folder}: is not empty: name another folder for the recordings with --recordings")
    folder.mkdir(parents=True, exist_ok=True)
    known = list(tests)
    answers: list[Leading] = []
    asked: list[str] = []
    made: list[Path] = []
    following: NextMotion | None = None
    while True:
        if known or made:
            diagnosis = diagnose(calibrated_on.model, calibration, known, progress)
            following = diagnosis.next_motion
            answers.append(Leading.of(diagnosis.document))
            why = why_stop(answers, following, most + bool(tests))
            then = f"; next {following.why}" if following and not why else ""
            say(f"{_last_diagnosed_in_words(made, asked)}: {answers[-1]}{then}")
            answered(diagnosis, answers[-1], why)
            if why:
                return Asked(diagnosis, tuple(made), tuple(answers), why)
        path = folder / f"test-{len(made) + 1}"
        what = _FIRST
        if following is not None:
            what = str(folder / f"{path.name}-{MOTION}")
            motion.table(following.motion, live.rig.actuator.unit).to_csv(what, index=False, float_format="%.6f")
        asked.append(following.why if following else _FIRST)
        record(live, path, what, seen=seen, progress=_progress_of_recording(path.name, progress))
        made.append(path)
        known += on_motor_clock([load(path, live.rig)], live.rig, one_clock=not calibrated_on.offsets)


def _progress_of_recording(name: str, progress: Progress) -> Progress:
    """`progress` whose text is always that the recording `name` is being made."""
    return lambda fraction, text: progress(fraction, f"recording {name}")


def _last_diagnosed_in_words(made: Sequence[Path], asked: Sequence[str]) -> str:
    """Which recordings the last diagnosis added, in words: the newest of those `made`, with why its motion was `asked`
    for, or those that were there before."""
    return f"{made[-1].name}, {asked[-1]}" if made else "what was recorded before"
