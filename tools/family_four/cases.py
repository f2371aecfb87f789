"""Which cases there are, and each drawn: mechanism, set-up, motions, causes and how strong they are."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.family_four import mechanisms, motion, ranges
from tools.family_four.causes import LISTED, NOMINAL, UNLISTED, Cause
from tools.family_four.causes.drive import FULL_LOAD, STROKES
from tools.family_four.mechanism import BEYOND, Mechanism
from tools.family_four.plant import Line, Plant, carried, gap, logged, rest, show, tip
from tools.family_three import camera
from tools.family_three import cases as third
from tools.family_three.cases import ATTEMPTS, FAINTEST, SHARES, TARGET, TARGET_OF_MANY
from tools.family_three.line import Path, lay
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
MECHANISMS: dict[str, type[Mechanism]] = {
    c.__name__.lower(): c
    for c in (
        mechanisms.McKibben, mechanisms.Notched, mechanisms.Toggle, mechanisms.Pushrod, mechanisms.Cycloid,
        mechanisms.Belt,
    )
}  # fmt: skip
TRIALS = 5  # of a cause's size
NEAR = 0.3  # of the goal's logarithm: near enough
EARLY = 0.33  # of the causes that can have been there while calibrating
ANGLE_ALONE = 0.22  # of the cases that no cause's nature gives a camera
HEAVY = 0.2  # of the cases have heavy tails
HEALTHY = 0.3  # of the noise: what the refit may leave of healthy tests, or the case is drawn again
CARRIES = 0.42  # of the noise: what it may miss of an unseen motion, fitted to the noisy calibration (in all 1.085)
WEAKLY = 0.1  # of the noise: what a healthy dependence on speed may be
STEPS = 0.25  # of the noise: what the encoder's steps may be
LOG_RATES = (100.0, 100.0, 125.0, 200.0, 250.0, 400.0, 500.0, 1000.0)  # Hz
FRAME_RATES = (15.0, 20.0, 24.0, 25.0, 29.97, 30.0, 50.0, 59.94, 60.0)
SENSOR_RATES = (40.0, 60.0, 100.0)
MOVING_ANYWAY = {"translation_mm": 0.2, "rotation_deg": 0.1, "wrist_deg": 0.15, "load_mNm": 0.1}  # share of cases


@dataclass(frozen=True)
class Case:
    """What the writers of the second family's files read of a case."""

    name: str
    kind: str
    mechanism: str
    index: int
    plant: Plant
    line: Line
    causes: tuple[Cause, ...]
    motions: dict[str, str]
    noise: float  # px or deg, one standard deviation of one coordinate
    memory: float
    heavy: bool
    log_rate: float
    resolution: float
    frame_rate: float
    one_clock: bool
    dropped: float
    strengths: tuple[dict[str, float], ...] = ()  # of each cause: times_noise, times_before


def plan(seed: int, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """Each case's kind and causes: the third family's shares and order of listed ids, this one's unlisted in turn."""
    wheel = third._wheel(np.random.default_rng([seed, 401]), list(UNLISTED))
    return [(kind, (next(wheel),) if kind == "unknown" else ids) for kind, ids in third.plan(seed, count)]


def draw(seed: int, index: int, kind: str, ids: tuple[str, ...]) -> Case:
    """A case whose causes are as strong as they were set to be; drawn anew where that cannot be, the best kept."""
    tried: list[tuple[float, Case]] = []
    for attempt in range(ATTEMPTS):
        case = _draw(np.random.default_rng([seed, 402, index, attempt]), index, kind, ids)
        base = healthy_rest(case)
        plain = base < HEALTHY * case.noise and carried(case.plant, case.line, case.noise) < CARRIES * case.noise
        if not plain and attempt < ATTEMPTS - 1:
            continue
        case = _set(case, np.random.default_rng([seed, 403, index, attempt]), base)
        sound = plain and _in_sight(case)
        weakest = min((strength(c, s) for c, s in zip(case.causes, case.strengths, strict=True)), default=FAINTEST)
        tried.append((min(weakest, FAINTEST) - (0.0 if sound else 100.0), case))
        if sound and weakest >= FAINTEST:
            break
    return max(tried, key=lambda x: x[0])[1]


def strength(cause: Cause, measured: dict[str, float]) -> float:
    """What a cause is binned by."""
    return third.strength(cause, measured)


def _in_sight(case: Case) -> bool:
    """The marker stays in the picture, and the tip where the mechanism's tables hold."""
    m, view = case.plant.mechanism, case.plant.view
    if np.max(np.abs(tip(case.plant, case.line, case.causes))) > (BEYOND - 0.02) * m.limit:
        return False
    if view is None:
        return True
    seen = np.concatenate([s.values for s in show(case.plant, case.line, case.causes)])
    return bool(np.all((seen > 8.0) & (seen < np.array([view.width_px, view.height_px]) - 8.0)))


def _draw(rng: np.random.Generator, index: int, kind: str, ids: tuple[str, ...]) -> Case:
    kinds = [LISTED.get(i) or UNLISTED[i] for i in ids]
    sections, massless = any(k.sections for k in kinds), any(k.massless for k in kinds)
    names = [n for n, m in MECHANISMS.items() if not (sections and m.arm) and not (massless and m.massive)]
    name = str(rng.choice(names))
    m = MECHANISMS[name](rng)
    seen = any(k.needs_camera for k in kinds) or rng.random() > ANGLE_ALONE
    view = camera.draw(rng, m.arm, m.farthest()) if seen else None
    noise = (ranges.MARKER_NOISE if seen else ranges.ANGLE_NOISE).draw(rng)
    delay = round(ranges.CAMERA_DELAY.draw(rng) if seen else float(rng.uniform(0.005, 0.05)), 4)
    causes = tuple(
        k(0.0, "start" if k.may_start and rng.random() < EARLY else "test", int(rng.integers(1 << 30))) for k in kinds
    )
    frame_rate = float(rng.choice(FRAME_RATES if seen else SENSOR_RATES))
    line, motions = _motion(rng, m, _columns(rng, kinds, seen), causes, frame_rate)
    per_deg = 1.0 if view is None else third._pixels(view, m.farthest())
    if m.sluggish:
        m.weak = min(ranges.STRIBECK.draw(rng), WEAKLY * noise / (0.5 * m.width_deg * per_deg))
        m.weak_speed = float(rng.uniform(0.1, 1.0)) * line.usual_speed
    counts = 10 ** float(rng.uniform(3.7, 4.6))  # each way, or more where noise is so low that they would be seen
    counts = max(counts, m.farthest() * per_deg / np.sqrt(12) / (STEPS * noise))
    resolution = float(f"{m.reach / counts:.1g}")
    return Case(
        f"case-{index:03d}", kind, name, index, Plant(m, view, delay), line, causes, motions, noise,
        ranges.NOISE_MEMORY.draw(rng), bool(rng.random() < HEAVY), float(rng.choice(LOG_RATES)), resolution,
        frame_rate, bool(rng.random() < 0.5), float(rng.choice([0.0, 0.005, 0.01, 0.03])),
    )  # fmt: skip


def _columns(rng: np.random.Generator, kinds: list[type[Cause]], seen: bool) -> list[str]:
    """Other joints and a load: what a cause needs, and in some cases what moves without being one."""
    visible = [c for c in MOVING_ANYWAY if seen or c not in ("translation_mm", "rotation_deg")]
    out = {k.needs_column for k in kinds if k.needs_column}
    out |= {c for c in visible if rng.random() < MOVING_ANYWAY[c]}
    if any(k.id == "configuration.axis_coupling" for k in kinds) and not out & set(STROKES):
        out.add(str(rng.choice([c for c in visible if c in STROKES])))
    return sorted(out)


def _motion(
    rng: np.random.Generator, m: Mechanism, columns: list[str], causes: tuple[Cause, ...], frame_rate: float
) -> tuple[Line, dict[str, str]]:
    """Calibration, one to three tests and the unseen motion, each of another kind."""
    kinds = [str(k) for k in rng.permutation(list(motion.MOTIONS))]
    labels = [f"test-{i + 1}" for i in range(int(rng.choice([1, 2, 2, 3])))]
    motions = {"calibration": "calibration"} | dict(zip([*labels, "unseen"], kinds, strict=False))
    lengths = {"calibration": (45.0, 85.0), "unseen": (20.0, 30.0)}
    early = any(c.since == "start" for c in causes)
    parts: list[Path] = []
    for label, kind in motions.items():
        make = motion.calibration if label == "calibration" else motion.MOTIONS[kind]
        q = make(rng, m.reach, m.width, float(rng.uniform(*lengths.get(label, (25.0, 45.0)))))
        still = label == "calibration" and not early
        others = {c: np.zeros(q.size) if still else _other(rng, c, q.size) for c in columns}
        beat = np.arange(0.25, (q.size - 1) * STEP - 0.2, 1 / frame_rate)
        parts.append((label, q, others, beat + rng.normal(scale=2e-4, size=beat.size).clip(-1e-3, 1e-3)))
    return lay(parts, m.reach, m.width, m.slope(), m.turn), motions


def _other(rng: np.random.Generator, column: str, count: int) -> FloatArray:
    if column == "load_mNm":
        return motion.load(rng, count, FULL_LOAD)
    return motion.other_joint(rng, count, STROKES[column])


def measure(case: Case, causes: tuple[Cause, ...], base: float) -> dict[str, float]:
    """How strong causes are: what a refit leaves beyond the healthy mechanism's own rest, and the gap before it."""
    said = logged(case.line, causes)
    shown = show(case.plant, case.line, causes, [p for p in case.line.parts if p.tested])
    left = rest(case.plant, case.line, shown, said)
    before = gap(case.plant, case.line, shown, said)
    return {
        "times_noise": float(np.sqrt(max(left**2 - base**2, 0.0)) / case.noise),
        "times_before": max(before, left) / case.noise,
    }


def healthy_rest(case: Case) -> float:
    """What the refit leaves of the healthy mechanism's tests."""
    shown = show(case.plant, case.line, (), [p for p in case.line.parts if p.tested])
    return rest(case.plant, case.line, shown, case.line.q)


def _set(case: Case, rng: np.random.Generator, base: float) -> Case:
    least, most = TARGET if len(case.causes) == 1 else TARGET_OF_MANY
    goals = [float(rng.uniform(np.log(least), np.log(min(most, c.strongest)))) for c in case.causes]
    found = [_sized(case, c, goal, base) for c, goal in zip(case.causes, goals, strict=True)]
    return replace(case, causes=tuple(c for c, _ in found), strengths=tuple(s for _, s in found))


def _sized(case: Case, cause: Cause, goal: float, base: float) -> tuple[Cause, dict[str, float]]:
    """The size within its range whose strength (logarithms) comes nearest: between trials, or with slope 1 beyond."""
    least, most = float(np.log(cause.limits.lo / 20)), float(np.log(cause.limits.hi))
    at = 0.4 * float(np.log(cause.limits.lo)) + 0.6 * most
    tried: list[tuple[float, float, Any]] = []  # log size, how far from the goal, what was measured
    for _ in range(TRIALS):
        trial = replace(cause, size=float(np.exp(at)))
        measured = measure(case, (trial,), base)
        off = float(np.log(max(strength(trial, measured), 0.02))) - goal
        tried.append((at, off, (trial, measured)))
        if abs(off) < NEAR or (off < 0 and at >= most) or (off > 0 and at <= least):
            break
        under = max(((a, o) for a, o, _ in tried if o < 0), default=None)
        over = min(((a, o) for a, o, _ in tried if o > 0), default=None)
        if under and over and under[0] < over[0]:
            at = under[0] + (over[0] - under[0]) * float(np.clip(-under[1] / (over[1] - under[1]), 0.1, 0.9))
        else:
            at -= float(np.clip(off, -2.0, 2.0))
        at = float(np.clip(at, least, most))
    best: tuple[Cause, dict[str, float]] = min(tried, key=lambda x: abs(x[1]))[2]
    return best


__all__ = ["LISTED", "NOMINAL", "SHARES", "UNLISTED", "Case", "draw", "plan"]
