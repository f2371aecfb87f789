"""Which cases there are, and each drawn: mechanism, set-up, motions, causes and how strong they are."""

from typing import Any

import numpy as np

from tools.family_five import mechanisms, motion, ranges
from tools.family_five.causes import LISTED, NOMINAL, UNLISTED, Cause
from tools.family_five.mechanism import FloatArray, Mechanism
from tools.family_four import cases as four
from tools.family_four.cases import Case, healthy_rest, measure, strength
from tools.family_four.plant import Plant, carried, logged, rest, show
from tools.family_three import camera
from tools.family_three import cases as third
from tools.family_three.cases import FAINTEST, SHARES
from tools.family_three.line import Line, Path, lay
from tools.family_two.motion import STEP

MECHANISMS: dict[str, type[Mechanism]] = {
    c.__name__.lower(): c
    for c in (
        mechanisms.Magnet, mechanisms.Drawer, mechanisms.Meniscus, mechanisms.Tackle, mechanisms.Cardan,
        mechanisms.Coupling,
    )
}  # fmt: skip
ATTEMPTS = 8
EARLY = 0.45  # of the causes that can have been there while calibrating; some turn out too weak for it
LATE_FROM = 5  # of the attempts: from then on causes are there since the tests
SEEN_EARLY = 2.0  # times the noise: what a refit to the calibration leaves of a cause that is there from the start


def plan(seed: int, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """Each case's kind and causes: the third family's shares and order of listed ids, this one's unlisted in turn."""
    wheel = third._wheel(np.random.default_rng([seed, 501]), list(UNLISTED))
    return [(kind, (next(wheel),) if kind == "unknown" else ids) for kind, ids in third.plan(seed, count)]


def draw(seed: int, index: int, kind: str, ids: tuple[str, ...]) -> Case:
    """A case whose causes are as strong as they were set to be; drawn anew where that cannot be, the best kept."""
    tried: list[tuple[float, Case]] = []
    for attempt in range(ATTEMPTS):
        case = _draw(np.random.default_rng([seed, 502, index, attempt]), index, kind, ids, attempt < LATE_FROM)
        base = healthy_rest(case)
        plain = base < four.HEALTHY * case.noise
        plain = plain and carried(case.plant, case.line, case.noise) < four.CARRIES * case.noise
        if not plain and attempt < ATTEMPTS - 1:
            continue
        case = four._set(case, np.random.default_rng([seed, 503, index, attempt]), base)
        fault = 0.0 if plain and four._in_sight(case) else 100.0
        fault += 0.0 if seen_early(case) else 1000.0
        weakest = min((strength(c, s) for c, s in zip(case.causes, case.strengths, strict=True)), default=FAINTEST)
        tried.append((min(weakest, FAINTEST) - fault, case))
        if not fault and weakest >= FAINTEST:
            break
    return max(tried, key=lambda x: x[0])[1]


def seen_early(case: Case) -> bool:
    """Whether each cause that is there from the start shows in the calibration, whatever is fitted to it."""
    return all(early_rest(case, c) >= SEEN_EARLY * case.noise for c in case.causes if c.since == "start")


def early_rest(case: Case, cause: Any) -> float:
    """rms per coordinate that the refit to the calibration leaves of a cause."""
    shown = show(case.plant, case.line, (cause,), case.line.parts[:1])
    return rest(case.plant, case.line, shown, logged(case.line, (cause,)))


def _draw(rng: np.random.Generator, index: int, kind: str, ids: tuple[str, ...], early: bool) -> Case:
    kinds = [LISTED.get(i) or UNLISTED[i] for i in ids]
    sections, massless = any(k.sections for k in kinds), any(k.massless for k in kinds)
    names = [n for n, k in MECHANISMS.items() if not (sections and k.arm) and not (massless and k.massive)]
    name = str(rng.choice(names))
    m = MECHANISMS[name](rng)
    seen = any(k.needs_camera for k in kinds) or rng.random() > four.ANGLE_ALONE
    view = camera.draw(rng, m.arm, m.farthest()) if seen else None
    noise = (ranges.MARKER_NOISE if seen else ranges.ANGLE_NOISE).draw(rng)
    delay = round(ranges.CAMERA_DELAY.draw(rng) if seen else float(rng.uniform(0.005, 0.05)), 4)
    since = ["start" if early and k.may_start and rng.random() < EARLY else "test" for k in kinds]
    causes = tuple(k(0.0, s, int(rng.integers(1 << 30))) for k, s in zip(kinds, since, strict=True))
    frame_rate = float(rng.choice(four.FRAME_RATES if seen else four.SENSOR_RATES))
    line, motions = _motion(rng, m, four._columns(rng, list(kinds), seen), causes, frame_rate)
    per_deg = 1.0 if view is None else third._pixels(view, m.farthest())
    if m.sluggish:
        m.weak = min(ranges.STRIBECK.draw(rng), four.WEAKLY * noise / (0.5 * m.width_deg * per_deg))
        m.weak_speed = float(rng.uniform(0.1, 1.0)) * line.usual_speed
    counts = 10 ** float(rng.uniform(3.7, 4.6))  # each way, or more where noise is so low that they would be seen
    counts = max(counts, m.farthest() * per_deg / np.sqrt(12) / (four.STEPS * noise))
    alike: Any = m  # it has what the fourth family's functions ask of a mechanism
    return Case(
        f"case-{index:03d}", kind, name, index, Plant(alike, view, delay), line, causes, motions, noise,
        ranges.NOISE_MEMORY.draw(rng), bool(rng.random() < four.HEAVY), float(rng.choice(four.LOG_RATES)),
        float(f"{m.reach / counts:.1g}"), frame_rate, bool(rng.random() < 0.5),
        float(rng.choice([0.0, 0.005, 0.01, 0.03])),
    )  # fmt: skip


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
        q: FloatArray = make(rng, m.reach, m.width, float(rng.uniform(*lengths.get(label, (25.0, 45.0)))))
        still = label == "calibration" and not early
        others = {c: np.zeros(q.size) if still else four._other(rng, c, q.size) for c in columns}
        beat = np.arange(0.25, (q.size - 1) * STEP - 0.2, 1 / frame_rate)
        parts.append((label, q, others, beat + rng.normal(scale=2e-4, size=beat.size).clip(-1e-3, 1e-3)))
    return lay(parts, m.reach, m.width, m.slope(), m.turn), motions


__all__ = ["LISTED", "MECHANISMS", "NOMINAL", "SHARES", "UNLISTED", "Case", "draw", "measure", "plan", "strength"]
