"""Which cases there are, and each drawn: mechanism, set-up, motions, causes and how strong they are."""

from typing import Any

import numpy as np

from tools.family_five.cases import early_rest, seen_early
from tools.family_four import cases as four
from tools.family_four.cases import Case, healthy_rest, measure, strength
from tools.family_four.plant import Plant, carried
from tools.family_six import mechanisms, motion, ranges
from tools.family_six.causes import LISTED, NOMINAL, UNLISTED, Cause
from tools.family_six.mechanism import Mechanism
from tools.family_three import camera
from tools.family_three import cases as third
from tools.family_three.cases import FAINTEST, SHARES
from tools.family_three.line import Line, Path, lay
from tools.family_two.motion import STEP

MECHANISMS: dict[str, type[Mechanism]] = {
    c.__name__.lower(): c
    for c in (
        mechanisms.Bellows, mechanisms.Sleeve, mechanisms.Leaves, mechanisms.Yoke, mechanisms.Wedge, mechanisms.Capstan,
    )
}  # fmt: skip
ATTEMPTS = 8
EARLY = 0.45  # of the causes that can have been there while calibrating; some turn out too weak for it
LATE_FROM = 5  # of the attempts: from then on causes come with the tests
SECONDS = {"calibration": (50.0, 85.0), "unseen": (20.0, 30.0)}  # others: 25 to 45


def plan(seed: int, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """Each case's kind and causes: the third family's shares and order of listed ids, this one's unlisted in turn."""
    wheel = third._wheel(np.random.default_rng([seed, 601]), list(UNLISTED))
    return [(kind, (next(wheel),) if kind == "unknown" else ids) for kind, ids in third.plan(seed, count)]


def draw(seed: int, index: int, kind: str, ids: tuple[str, ...]) -> Case:
    """A case whose causes are as strong as they were set to be; drawn anew where that cannot be, the best kept."""
    best: tuple[float, Case] | None = None
    for attempt in range(ATTEMPTS):
        case = _draw(np.random.default_rng([seed, 602, index, attempt]), index, kind, ids, attempt < LATE_FROM)
        base = healthy_rest(case)
        plain = base < four.HEALTHY * case.noise
        plain = plain and carried(case.plant, case.line, case.noise) < four.CARRIES * case.noise
        if not plain and attempt < ATTEMPTS - 1:
            continue
        case = four._set(case, np.random.default_rng([seed, 603, index, attempt]), base)
        pairs = zip(case.causes, case.strengths, strict=True)
        worth = min([FAINTEST, *(strength(c, s) for c, s in pairs)])
        worth -= 0.0 if plain and four._in_sight(case) else 100.0
        worth -= 0.0 if seen_early(case) else 1000.0
        if best is None or worth > best[0]:
            best = worth, case
        if worth >= FAINTEST:
            break
    assert best is not None
    return best[1]


def _draw(rng: np.random.Generator, index: int, kind: str, ids: tuple[str, ...], early: bool) -> Case:
    kinds: list[Any] = [LISTED.get(i) or UNLISTED[i] for i in ids]
    names = [n for n, c in MECHANISMS.items() if not (c.arm and any(k.sections for k in kinds))]
    name = str(rng.choice(names))
    m = MECHANISMS[name](rng)
    alike: Any = m  # it has what the fourth family's functions ask of a mechanism
    seen = any(k.needs_camera for k in kinds) or rng.random() > four.ANGLE_ALONE
    view = camera.draw(rng, m.arm, m.farthest()) if seen else None
    noise = (ranges.MARKER_NOISE if seen else ranges.ANGLE_NOISE).draw(rng)
    delay = round(ranges.CAMERA_DELAY.draw(rng) if seen else float(rng.uniform(0.005, 0.05)), 4)
    since = ["start" if early and k.may_start and rng.random() < EARLY else "test" for k in kinds]
    causes = tuple(k(0.0, s, int(rng.integers(1 << 30))) for k, s in zip(kinds, since, strict=True))
    frame_rate = float(rng.choice(four.FRAME_RATES if seen else four.SENSOR_RATES))
    line, motions = _motion(rng, m, four._columns(rng, kinds, seen), causes, frame_rate)
    per_deg = 1.0 if view is None else third._pixels(view, m.farthest())
    counts = 10 ** float(rng.uniform(3.7, 4.6))  # each way, or more where noise is so low that they would be seen
    counts = max(counts, m.farthest() * per_deg / np.sqrt(12) / (four.STEPS * noise))
    return Case(
        f"case-{index:03d}", kind, name, index, Plant(alike, view, delay), line, causes, motions, noise,
        memory=ranges.NOISE_MEMORY.draw(rng), heavy=bool(rng.random() < four.HEAVY),
        log_rate=float(rng.choice(four.LOG_RATES)), resolution=float(f"{m.reach / counts:.1g}"), frame_rate=frame_rate,
        one_clock=bool(rng.random() < 0.5), dropped=float(rng.choice([0.0, 0.005, 0.01, 0.03])),
    )  # fmt: skip


def _motion(
    rng: np.random.Generator, m: Mechanism, columns: list[str], causes: tuple[Cause, ...], frame_rate: float
) -> tuple[Line, dict[str, str]]:
    """Calibration, one to three tests and the unseen motion, each of another kind."""
    kinds = [str(k) for k in rng.permutation(list(motion.MOTIONS))]
    labels = [f"test-{i + 1}" for i in range(int(rng.choice([1, 2, 2, 3])))]
    motions = {"calibration": "calibration"} | dict(zip([*labels, "unseen"], kinds, strict=False))
    early = any(c.since == "start" for c in causes)
    parts: list[Path] = []
    for label, kind in motions.items():
        make = motion.calibration if label == "calibration" else motion.MOTIONS[kind]
        q = make(rng, m.reach, m.width, float(rng.uniform(*SECONDS.get(label, (25.0, 45.0)))))
        still = label == "calibration" and not early
        others = {c: np.zeros(q.size) if still else four._other(rng, c, q.size) for c in columns}
        beat = np.arange(0.25, (q.size - 1) * STEP - 0.2, 1 / frame_rate)
        parts.append((label, q, others, beat + rng.normal(scale=2e-4, size=beat.size).clip(-1e-3, 1e-3)))
    return lay(parts, m.reach, m.width, m.slope(), m.turn), motions


__all__ = [
    "FAINTEST", "LISTED", "MECHANISMS", "NOMINAL", "SHARES", "UNLISTED", "Case", "draw", "early_rest", "healthy_rest",
    "measure", "plan", "strength",
]  # fmt: skip
