"""Which cases there are, and each drawn: mechanism, set-up, motions, causes and how strong they are."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tools.family.view import View
from tools.family_three import camera, motion, nominal, ranges
from tools.family_three.causes import LISTED, NOMINAL, UNLISTED, Cause
from tools.family_three.causes.drive import FULL_LOAD, STROKES
from tools.family_three.line import Line, Path, lay
from tools.family_three.mechanism import BEYOND, Mechanism
from tools.family_three.mechanisms import Fusee, Jaw, Piston, Worm, Wrist
from tools.family_three.plant import Plant, gap, logged, show, tip
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
MECHANISMS: dict[str, type[Mechanism]] = {c.__name__.lower(): c for c in (Piston, Worm, Wrist, Fusee, Jaw)}
SHARES = {"single": 150, "unknown": 40, "none": 40, "pair": 40, "triple": 15, "nominal": 15}  # of 300
SAME = (  # groups of which a case holds one: no recording tells them apart, or one hides the other
    ("acquisition.delay", "transmission.lag"),
    ("acquisition.delay", "acquisition.clock_rate"),
    ("acquisition.jitter", "acquisition.held_samples"),
    ("registration.static", "registration.shift", "camera.distortion", "kinematics.nonconstant_curvature"),
    ("transmission.drift", "transmission.slip", "transmission.offset", "transmission.backlash"),
    ("configuration.contact", "configuration.remaining", "camera.distortion", "kinematics.nonconstant_curvature"),
    ("transmission.stick_slip", "transmission.lag"),
    ("transmission.smooth_onset", "transmission.asymmetric_backlash", "transmission.stick_slip"),
)
TARGET = (2.3, 90.0)  # times the noise to which a single cause is set, log-uniform
TARGET_OF_MANY = (5.0, 90.0)
FAINTEST = 2.0  # times the noise below which a case is drawn again
ATTEMPTS = 6
HEALTHY = 0.4  # of the noise: what the refit may leave of the healthy mechanism, or the case is drawn again
TRIALS = 5  # of a cause's size
EARLY = 0.33  # of the causes that can have been there while calibrating
ANGLE_ALONE = 0.23  # of the cases that no cause's nature gives a camera
HEAVY = 0.2  # of the cases have heavy tails
HIDDEN_BY_NOISE = 0.25  # of the noise: what a weak dependence on speed may be
LOG_RATES = (50.0, 100.0, 125.0, 200.0, 250.0, 500.0, 1000.0)  # Hz
FRAME_RATES = (15.0, 20.0, 25.0, 30.0, 30.0, 50.0, 60.0)
SENSOR_RATES = (40.0, 50.0, 100.0)


@dataclass(frozen=True)
class Case:
    name: str
    kind: str
    mechanism: str
    index: int
    plant: Plant
    line: Line
    causes: tuple[Cause, ...]
    noise: float  # px or deg, one standard deviation of one coordinate
    memory: float
    heavy: bool
    log_rate: float
    resolution: float
    frame_rate: float
    one_clock: bool
    dropped: float
    motions: dict[str, str]
    strengths: tuple[dict[str, float], ...] = field(default=())  # of each cause: times_noise, times_before


def plan(seed: int, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """Each case's kind and causes: every id in turn, in an order that the seed shuffles."""
    rng = np.random.default_rng([seed, 301])
    exact = {k: count * v / 300 for k, v in SHARES.items()}
    counts = {k: int(v) for k, v in exact.items()}
    for kind in sorted(exact, key=lambda k: counts[k] - exact[k])[: count - sum(counts.values())]:
        counts[kind] += 1
    wheels = {
        "single": _wheel(rng, [i for i in LISTED if i not in NOMINAL]),
        "unknown": _wheel(rng, list(UNLISTED)),
        "nominal": _wheel(rng, list(NOMINAL)),
    }
    every = _wheel(rng, list(LISTED))
    out: list[tuple[str, tuple[str, ...]]] = []
    for kind, number in counts.items():
        for _ in range(number):
            if kind == "none":
                out.append((kind, ()))
            elif kind in wheels:
                out.append((kind, (next(wheels[kind]),)))
            else:
                out.append((kind, _together(every, 2 if kind == "pair" else 3)))
    return [out[i] for i in rng.permutation(len(out))]


def _wheel(rng: np.random.Generator, ids: list[str]) -> Iterator[str]:
    while True:
        yield from (ids[i] for i in rng.permutation(len(ids)))


def _together(wheel: Iterator[str], number: int) -> tuple[str, ...]:
    picked: list[str] = []
    while len(picked) < number:
        new = next(wheel)
        if new not in picked and not any(new in same and old in same for same in SAME for old in picked):
            picked.append(new)
    return tuple(picked)


def draw(seed: int, index: int, kind: str, ids: tuple[str, ...]) -> Case:
    """A case whose causes are as strong as they were set to be; drawn anew where that cannot be, the best kept."""
    best: tuple[float, Case] | None = None
    for attempt in range(ATTEMPTS):
        case = _draw(np.random.default_rng([seed, 302, index, attempt]), index, kind, ids)
        case = _set(case, np.random.default_rng([seed, 303, index, attempt]))
        pairs = zip(case.causes, case.strengths, strict=True)
        weakest = min((strength(c, s) for c, s in pairs), default=np.inf)
        sound = in_picture(case) and in_range(case) and healthy_rest(case) < HEALTHY * case.noise
        weakest = min(weakest, FAINTEST * 1.01) - (0.0 if sound else 100.0)
        if best is None or weakest > best[0]:
            best = (float(weakest), case)
        if weakest >= FAINTEST:
            break
    assert best is not None
    return best[1]


def strength(cause: Cause, measured: dict[str, float]) -> float:
    """What a cause is binned by: the gap before where recalibration closes it, else what a refit leaves."""
    return measured["times_before" if cause.moves else "times_noise"]


def in_picture(case: Case) -> bool:
    """The marker stays in the picture in every recording, with a margin."""
    view = case.plant.view
    if view is None:
        return True
    edge = np.array([view.width_px, view.height_px]) - 8.0
    return all(bool(np.all((s.values > 8.0) & (s.values < edge))) for s in show(case.plant, case.line, case.causes))


def in_range(case: Case) -> bool:
    """The tip stays where the mechanism's tables hold."""
    m = case.plant.mechanism
    return bool(np.max(np.abs(tip(case.plant, case.line, case.causes))) < (BEYOND - 0.02) * m.limit)


def _draw(rng: np.random.Generator, index: int, kind: str, ids: tuple[str, ...]) -> Case:
    kinds = [LISTED.get(i) or UNLISTED[i] for i in ids]
    names = [
        n for n, m in MECHANISMS.items()
        if not (any(k.sections for k in kinds) and m.arm) and not (any(k.massless for k in kinds) and m.massive)
    ]  # fmt: skip
    name = str(rng.choice(names))
    mechanism = MECHANISMS[name](rng)
    seen = any(k.needs_camera for k in kinds) or rng.random() > ANGLE_ALONE
    reach_deg = mechanism.farthest()
    view = camera.draw(rng, mechanism.arm, reach_deg) if seen else None
    noise = (ranges.MARKER_NOISE if seen else ranges.ANGLE_NOISE).draw(rng)
    delay = ranges.CAMERA_DELAY.draw(rng) if seen else float(rng.uniform(0.01, 0.06))
    if not mechanism.exact:
        per_deg = 1.0 if view is None else _pixels(view, reach_deg)
        hidden = HIDDEN_BY_NOISE * noise / (0.5 * mechanism.width_deg * per_deg)
        mechanism.weak = min(ranges.STRIBECK.draw(rng), hidden)
    causes = tuple(
        k(0.0, "start" if k.may_start and rng.random() < EARLY else "test", int(rng.integers(1 << 30))) for k in kinds
    )
    frame_rate = float(rng.choice(FRAME_RATES if seen else SENSOR_RATES))
    line, motions = _motion(rng, mechanism, _columns(rng, kinds, seen), causes, frame_rate)
    resolution = 10 ** float(rng.uniform(-4.6, -3.7)) * mechanism.reach  # 5000 to 40000 counts each way
    return Case(
        f"case-{index:03d}", kind, name, index, Plant(mechanism, view, round(delay, 4)), line, causes,
        noise, ranges.NOISE_MEMORY.draw(rng), bool(rng.random() < HEAVY), float(rng.choice(LOG_RATES)),
        float(f"{resolution:.1g}"), frame_rate, bool(rng.random() < 0.5), float(rng.choice([0.0, 0.01, 0.03])), motions,
    )  # fmt: skip


def _pixels(view: View, reach_deg: float) -> float:
    """px of one coordinate for a deg of the tip, rms over the reach."""
    c = np.linspace(-reach_deg, reach_deg, 41)
    seen = camera.picture(view, c, camera.Scene.still(c.size))
    return float(np.sqrt(np.mean(np.gradient(seen, c, axis=0) ** 2)))


def _columns(rng: np.random.Generator, kinds: list[type[Cause]], seen: bool) -> list[str]:
    """Other joints and a load: what a cause needs, and in some cases what moves without being one."""
    out = {k.needs_column for k in kinds if k.needs_column}
    for column, share in (("translation_mm", 0.2 * seen), ("rotation_deg", 0.1 * seen), ("wrist_deg", 0.12)):
        if rng.random() < share:
            out.add(column)
    if rng.random() < 0.1:
        out.add("load_mNm")
    if any(k.id == "configuration.axis_coupling" for k in kinds) and not out & set(STROKES):
        out.add(str(rng.choice(["translation_mm", "wrist_deg"])) if seen else "wrist_deg")
    return sorted(out)


def _motion(
    rng: np.random.Generator, mechanism: Mechanism, columns: list[str], causes: tuple[Cause, ...], frame_rate: float
) -> tuple[Line, dict[str, str]]:
    reach, width = mechanism.reach, mechanism.width
    early = any(c.since == "start" for c in causes)
    labels = ["calibration", *(f"test-{i + 1}" for i in range(int(rng.choice([1, 2, 2, 3])))), "unseen"]
    kinds = dict(zip(labels[1:], (str(k) for k in rng.permutation(list(motion.MOTIONS))), strict=False))
    parts: list[Path] = []
    for label in labels:
        if label == "calibration":
            q = motion.calibration(rng, reach, width, float(rng.uniform(40, 80)))
        else:
            seconds = rng.uniform(20, 30) if label == "unseen" else rng.uniform(25, 45)
            q = motion.MOTIONS[kinds[label]](rng, reach, width, float(seconds))
        still = label == "calibration" and not early
        others = {c: np.zeros(q.size) if still else _other(rng, c, q.size) for c in columns}
        beat = np.arange(0.25, (q.size - 1) * STEP - 0.2, 1 / frame_rate)
        parts.append((label, q, others, beat + rng.normal(scale=2e-4, size=beat.size).clip(-1e-3, 1e-3)))
    return lay(parts, reach, width, mechanism.slope(), mechanism.turn), {"calibration": "calibration"} | kinds


def _other(rng: np.random.Generator, column: str, count: int) -> FloatArray:
    if column == "load_mNm":
        return motion.load(rng, count, FULL_LOAD)
    return motion.other_joint(rng, count, STROKES[column])


def measure(case: Case, causes: tuple[Cause, ...], base: float) -> dict[str, float]:
    """How strong causes are: what a refit leaves beyond the healthy mechanism's own rest, and the gap before it."""
    tests = [p for p in case.line.parts if p.tested]
    shown = show(case.plant, case.line, causes, tests)
    said = logged(case.line, causes)
    rest = nominal.of(case.plant, case.line, said, shown).fit()[1]
    before = gap(case.plant, case.line, shown, said)
    return {
        "times_noise": float(np.sqrt(max(rest**2 - base**2, 0.0)) / case.noise),
        "times_before": max(before, rest) / case.noise,
    }


def healthy_rest(case: Case) -> float:
    """What the nominal model leaves of the healthy mechanism's tests."""
    shown = show(case.plant, case.line, (), [p for p in case.line.parts if p.tested])
    return nominal.of(case.plant, case.line, case.line.q, shown).fit()[1]


def _set(case: Case, rng: np.random.Generator) -> Case:
    """Each cause's size so that it is as strong as drawn: secants of log size, log strength, within its range."""
    if not case.causes:
        return case
    base = healthy_rest(case)
    sized, measured = [], []
    for cause in case.causes:
        lo, hi = TARGET if len(case.causes) == 1 else TARGET_OF_MANY
        goal = float(np.exp(rng.uniform(np.log(lo), np.log(hi))))
        least, most = float(np.log(cause.limits.lo / 20)), float(np.log(cause.limits.hi))
        tried: list[tuple[float, float, Cause, dict[str, float]]] = []
        at = float(0.5 * (np.log(cause.limits.lo) + most))
        for _ in range(TRIALS):
            trial = replace(cause, size=float(np.exp(at)))
            found = measure(case, (trial,), base)
            off = float(np.log(max(strength(cause, found), 0.02) / goal))
            tried.append((off, at, trial, found))
            if abs(off) < 0.3 or (off < 0 and at >= most):
                break
            slope = 1.0
            if len(tried) > 1 and abs(at - tried[-2][1]) > 1e-6:
                slope = float(np.clip((off - tried[-2][0]) / (at - tried[-2][1]), 0.4, 2.5))
            at = float(np.clip(at - off / slope, least, most))
        _, _, trial, found = min(tried, key=lambda x: abs(x[0]))
        sized.append(trial)
        measured.append(found)
    return replace(case, causes=tuple(sized), strengths=tuple(measured))
