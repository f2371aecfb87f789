"""A live diagnosis: recordings are diagnosed, the board makes the motion that is expected to tell the remaining
candidates apart best, and so on, until one answer is sure or no further motion would help."""

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

SURE = 0.95  # probability from which on an answer is sure
MOTION = "motion.csv"  # end of the name of a file with a motion that is to be recorded
_TELLS = 0.01  # nats: a motion that is expected to tell less is not worth a recording
_FIRST = "trapezoids"  # the first motion, where no recording is there yet from which a better one could be chosen

Progress = Callable[[float, str], None]
Answered = Callable[[Diagnosis, "Leading", str], None]


def answers_of(document: Mapping[str, Any]) -> dict[str, float]:
    """Reads the probability, 0 to 1, of every answer from the content of a diagnosis.json: of each effect by its id,
    and of "none" and "unknown"."""
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
        """Returns the likeliest answer in the content of a diagnosis.json."""
        probabilities = answers_of(document)
        name = max(probabilities, key=lambda name: probabilities[name])
        return cls(name, probabilities[name])

    def __str__(self) -> str:
        """Returns name and probability as text, such as "lag (97 %)"."""
        return f"{self.name} ({percent(self.probability)})"


@dataclass(frozen=True)
class Asked:
    """A live diagnosis that has ended."""

    diagnosis: Diagnosis
    recordings: tuple[Path, ...]  # folders of the recordings that were made
    answers: tuple[Leading, ...]  # the likeliest answer after each diagnosis
    why: str  # why the diagnosis ended, in words

    @property
    def sure(self) -> bool:
        """Whether the last answer has a probability of SURE or more."""
        return self.answers[-1].probability >= SURE


def why_stop(answers: Sequence[Leading], following: NextMotion | None, most: int) -> str:
    """Returns, in words, why a live diagnosis ends now; "" if it goes on. answers: the likeliest answer after each
    diagnosis so far; following: the motion that would be recorded next, None where no motion can tell candidates apart;
    most: the largest number of diagnoses."""
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
    """Diagnoses, records the motion that tells the candidates apart best, and diagnoses again, until `why_stop` gives a
    reason. Without `tests` the motion _FIRST is recorded before the first diagnosis. calibrated_on: the calibration
    whose model is the nominal; calibration: the recording, on the motor's clock, that it was made of; tests: earlier
    recordings of the instrument as it is now, may be empty. folder: new or empty, gets the recordings; most: the
    largest number of recordings. say: gets a line after every diagnosis; seen: gets every frame; answered: gets every
    diagnosis, its likeliest answer and why it is the last one ("" if it is not). Ctrl-C ends a recording early, and
    what was recorded is diagnosed all the same. TautError where `folder` is not empty, or the board or camera fails."""
    if folder.exists() and any(folder.iterdir()):
        raise TautError(f"{folder}: is not empty: name another folder for the recordings with --recordings")
    folder.mkdir(parents=True, exist_ok=True)
    recordings = list(tests)
    answers: list[Leading] = []
    asked: list[str] = []
    made: list[Path] = []
    following: NextMotion | None = None
    while True:
        if recordings or made:
            diagnosis = diagnose(calibrated_on.model, calibration, recordings, progress)
            following = diagnosis.next_motion
            answers.append(Leading.of(diagnosis.document))
            why = why_stop(answers, following, most + bool(tests))
            then = f"; next {following.why}" if following and not why else ""
            say(f"{_last_diagnosed_in_words(made, asked)}: {answers[-1]}{then}")
            answered(diagnosis, answers[-1], why)
            if why:
                return Asked(diagnosis, tuple(made), tuple(answers), why)
        path = folder / f"test-{len(made) + 1}"
        motion_file = _FIRST
        if following is not None:
            motion_file = str(folder / f"{path.name}-{MOTION}")
            motion.table(following.motion, live.rig.actuator.unit).to_csv(motion_file, index=False, float_format="%.6f")
        asked.append(following.why if following else _FIRST)
        record(live, path, motion_file, seen=seen, progress=_progress_of_recording(path.name, progress))
        made.append(path)
        on_clock, of_clock = on_motor_clock([load(path, live.rig)], live.rig, one_clock=not calibrated_on.offsets)
        for reason in of_clock:
            say(str(reason))
        recordings += on_clock


def _progress_of_recording(name: str, progress: Progress) -> Progress:
    """Returns a callback that hands the share done, 0 to 1, on to `progress`, always with the text that the recording
    `name` is being made."""
    return lambda fraction, text: progress(fraction, f"recording {name}")


def _last_diagnosed_in_words(made: Sequence[Path], asked: Sequence[str]) -> str:
    """Returns, in words, which recording was added before the last diagnosis: the newest of `made` with the reason for
    its motion, the last of `asked`; where none was made yet, the tests that were there before."""
    return f"{made[-1].name}, {asked[-1]}" if made else "what was recorded before"
