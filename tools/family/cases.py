"""Which cases there are, and each of them drawn: mechanism, set-up, motions, causes and how strong they are."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from tools.family import motion, ranges, refit
from tools.family import view as views
from tools.family.causes import LISTED, NOMINAL, UNLISTED
from tools.family.causes.base import Cause
from tools.family.line import Line, Part, lay
from tools.family.mechanisms import MECHANISMS
from tools.family.plant import Plant, Seen, probe, run, stamps

SHARES = {"single": 150, "unknown": 40, "none": 40, "pair": 40, "triple": 15, "nominal": 15}  # of 300
SECTIONS = ("sheath", "backbone")  # bend as a section in a channel; the others are stiff levers on a pivot
SECTION_ONLY = ("kinematics.nonconstant_curvature", "registration.direction_dependent", "breathing_base")
NOT_WITH = {  # what one could not tell from the other by any recording
    frozenset(("acquisition.delay", "transmission.lag")),
    frozenset(("acquisition.delay", "acquisition.clock_rate")),
    frozenset(("registration.static", "registration.shift")),
    frozenset(("registration.static", "camera.distortion")),
    frozenset(("registration.static", "kinematics.nonconstant_curvature")),
    frozenset(("camera.distortion", "kinematics.nonconstant_curvature")),
    frozenset(("transmission.drift", "transmission.slip")),
    frozenset(("configuration.contact", "camera.distortion")),
    frozenset(("configuration.contact", "configuration.remaining")),
}
TARGET = (2.3, 90.0)  # times the noise that a single cause is set to, log-uniform
TARGET_OF_MANY = (5.0, 90.0)  # in pairs and triples
FAINTEST = 2.0  # times the noise below which a case is drawn again
ATTEMPTS = 8  # draws of a case until its causes reach what they are set to
LOG_RATES = (50.0, 100.0, 100.0, 200.0, 250.0, 500.0, 1000.0)  # Hz
FRAME_RATES = (15.0, 20.0, 25.0, 30.0, 30.0, 50.0, 60.0)
GAP = 20.0  # s between recordings


@dataclass(frozen=True)
class Case:
    name: str
    kind: str
    mechanism: str
    seed: int
    plant: Plant
    parts: list[Part]
    line: Line
    causes: list[Cause]
    noise: float  # px or deg, one standard deviation of one coordinate
    memory: float
    log_rate: float
    resolution: float
    frame_rate: float
    one_clock: bool
    dropped: float
    motions: dict[str, str]
    strengths: list[dict[str, float]] = field(default_factory=list)  # of each cause: times_noise, times_before


def plan(seed: int, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """Each case's kind and causes: every id in turn, in an order that the seed shuffles."""
    rng = np.random.default_rng([seed, 1])
    exact = {k: count * v / 300 for k, v in SHARES.items()}
    counts = {k: int(v) for k, v in exact.items()}
    for kind in sorted(exact, key=lambda k: counts[k] - exact[k])[: count - sum(counts.values())]:
        counts[kind] += 1
    singles = [i for i in LISTED if i not in NOMINAL]
    wheel = {
        "single": _wheel(rng, singles),
        "unknown": _wheel(rng, list(UNLISTED)),
        "nominal": _wheel(rng, list(NOMINAL)),
    }
    listed = _wheel(rng, list(LISTED))
    out: list[tuple[str, tuple[str, ...]]] = []
    for kind, number in counts.items():
        for _ in range(number):
            if kind == "none":
                out.append((kind, ()))
            elif kind in wheel:
                out.append((kind, (next(wheel[kind]),)))
            else:
                out.append((kind, _together(listed, 2 if kind == "pair" else 3)))
    return [out[i] for i in rng.permutation(len(out))]


def _wheel(rng: np.random.Generator, ids: list[str]) -> Iterator[str]:
    while True:
        yield from (ids[i] for i in rng.permutation(len(ids)))


def _together(wheel: Iterator[str], number: int) -> tuple[str, ...]:
    picked: list[str] = []
    while len(picked) < number:
        new = next(wheel)
        if new in picked or any(frozenset((new, old)) in NOT_WITH for old in picked):
            continue
        picked.append(new)
    return tuple(picked)


def draw(seed: int, index: int, kind: str, ids: tuple[str, ...]) -> Case:
    """A case whose causes are as strong as they were set to be; drawn again, another way, where that cannot be."""
    best: Case | None = None
    for attempt in range(ATTEMPTS):
        case = _draw(np.random.default_rng([seed, 2, index, attempt]), index, kind, ids)
        case = _set(case, np.random.default_rng([seed, 3, index, attempt]))
        weakest = min((strength(c, s) for c, s in zip(case.causes, case.strengths, strict=True)), default=np.inf)
        if weakest >= FAINTEST:
            return case
        if best is None or weakest > min(strength(c, s) for c, s in zip(best.causes, best.strengths, strict=True)):
            best = case
    assert best is not None
    return best


def strength(cause: Cause, measured: dict[str, float]) -> float:
    """What a cause is binned by: the gap before where recalibration closes it, else what a refit leaves."""
    return measured["times_before" if cause.moves else "times_noise"]


def _draw(rng: np.random.Generator, index: int, kind: str, ids: tuple[str, ...]) -> Case:
    kinds = [LISTED.get(i) or UNLISTED[i] for i in ids]
    names = SECTIONS if any(i in SECTION_ONLY for i in ids) else tuple(MECHANISMS)
    name = str(rng.choice(names))
    mechanism = MECHANISMS[name](rng)
    width, gain = probe(mechanism)
    reach = mechanism.reach
    camera = any(k.needs_camera for k in kinds) or rng.random() < 0.82
    law = (float(rng.uniform(-0.12, 0.12)), float(rng.uniform(-0.25, 0.15)))
    view = views.draw(rng, name not in SECTIONS, reach * gain) if camera else None
    delay = ranges.CAMERA_DELAY.draw(rng) if camera else float(rng.uniform(0.025, 0.06))
    plant = Plant(mechanism, view, law, width, gain, round(delay, 4))

    columns = {k.needs_column for k in kinds if k.needs_column}
    if camera and rng.random() < 0.25:
        columns |= {"translation_mm", "rotation_deg"} if rng.random() < 0.5 else {"translation_mm"}
    if rng.random() < 0.15:
        columns.add("wrist_deg")
    if rng.random() < 0.12:
        columns.add("load_mNm")
    if "configuration.axis_coupling" in ids and not columns & {"translation_mm", "rotation_deg", "wrist_deg"}:
        columns.add(str(rng.choice(["translation_mm", "wrist_deg"])) if camera else "wrist_deg")

    causes = [
        k(0.0, "start" if k.may_start and rng.random() < 0.25 else "test", int(rng.integers(1 << 30))) for k in kinds
    ]
    early = any(c.since == "start" for c in causes)
    frame_rate = float(rng.choice(FRAME_RATES)) if camera else float(rng.choice([50.0, 100.0]))
    labels = ["calibration", *(f"test-{i + 1}" for i in range(int(rng.choice([1, 2, 2, 3])))), "unseen"]
    parts, motions, now = [], {}, float(rng.uniform(0.0, 5.0))
    for label in labels:
        if label == "calibration":
            q, motions[label] = motion.calibration(rng, reach, width, float(rng.uniform(60, 120))), "calibration"
        else:
            motions[label] = str(
                rng.choice([m for m in motion.MOTIONS if m not in motions.values()] or list(motion.MOTIONS))
            )
            q = motion.MOTIONS[motions[label]](rng, reach, width, float(rng.uniform(35, 60)))
        still = label == "calibration" and not early
        sides = {column: _side(rng, column, q.size, still) for column in sorted(columns)}
        # scene times: from half a second on, each frame a little off the beat
        duration = (q.size - 1) * motion.STEP
        beat = np.arange(0.3, duration - 0.3, 1 / frame_rate)
        frames = now + beat + rng.normal(scale=0.0002, size=beat.size).clip(-0.001, 0.001)
        parts.append(Part(label, now, q, sides, frames))
        now += duration + GAP
    line = lay(parts, reach, width, gain, name == "backbone")
    resolution = _resolution(rng, mechanism.unit, name)
    noise = ranges.MARKER_NOISE.draw(rng) if camera else ranges.ANGLE_NOISE.draw(rng)
    return Case(
        f"case-{index:03d}", kind, name, index, plant, parts, line, causes, noise,
        ranges.NOISE_MEMORY.draw(rng), float(rng.choice(LOG_RATES)), resolution, frame_rate, bool(rng.random() < 0.5),
        float(rng.choice([0.0, 0.005, 0.03])), motions,
    )  # fmt: skip


def _side(rng: np.random.Generator, column: str, size: int, still: bool) -> np.ndarray:
    if still:
        return np.zeros(size)
    seconds = (size - 1) * motion.STEP
    if column != "load_mNm":
        stroke = {"translation_mm": 5.0, "rotation_deg": 10.0, "wrist_deg": 40.0}[column]
        return motion.side_motion(rng, seconds, stroke)[:size]
    level = rng.choice([0.0, 10.0, 20.0, 35.0, 50.0], size=int(seconds / 4) + 2)
    level[0] = 0.0
    times = np.cumsum(rng.uniform(4.0, 12.0, level.size))
    return np.asarray(
        level[np.searchsorted(times, np.arange(size) * motion.STEP).clip(max=level.size - 1)], dtype=float
    )


def _resolution(rng: np.random.Generator, unit: str, name: str) -> float:
    if unit == "mm":
        return float(rng.choice([0.0005, 0.001, 0.002, 0.005]))
    return 0.088 if name == "linkage" else float(rng.choice([0.005, 0.02, 0.088]))


def measure(case: Case, causes: Sequence[Cause], healthy: Seen, base: float) -> dict[str, float]:
    """How strong causes are: what a refit leaves beyond the healthy mechanism's own rest, and the gap before."""
    seen = run(case.plant, case.line, causes)
    rest = refit.left(case.plant, case.line, causes, seen)
    late = []
    for part, name in enumerate(case.line.names):
        if name.startswith("test"):
            scene = case.line.t[case.line.frame & (case.line.part == part)]
            late.append(stamps(case.plant, case.line, causes, part) - scene - case.plant.delay)
    gap = refit.before(case.line, seen, healthy, np.concatenate(late))
    return {
        "times_noise": float(np.sqrt(max(rest**2 - base**2, 0.0)) / case.noise),
        "times_before": max(gap, rest) / case.noise,
    }


def _set(case: Case, rng: np.random.Generator) -> Case:
    """Each cause's size so that it is as strong as drawn, by secants of log size against log strength."""
    healthy = run(case.plant, case.line, [])
    if not case.causes:
        return case
    base = refit.left(case.plant, case.line, [], healthy)
    set_to, measured = [], []
    for cause in case.causes:
        lo, hi = TARGET if len(case.causes) == 1 else TARGET_OF_MANY
        goal = float(np.exp(rng.uniform(np.log(lo), np.log(hi))))
        size = min(float(np.sqrt(cause.limits.lo * cause.limits.hi)), cause.limits.hi)
        best: tuple[float, Cause, dict[str, float]] | None = None
        for _ in range(4):
            trial = replace(cause, size=size)
            found = measure(case, [trial], healthy, base)
            now = strength(cause, found)
            off = abs(np.log(max(now, 0.05) / goal))
            if best is None or off < best[0]:
                best = (float(off), trial, found)
            if off < 0.35 or (now < goal and size >= cause.limits.hi):
                break
            size = float(np.clip(size * goal / max(now, 0.05), cause.limits.lo / 20, cause.limits.hi))
        assert best is not None
        set_to.append(best[1])
        measured.append(best[2])
    return replace(case, causes=set_to, strengths=measured)
