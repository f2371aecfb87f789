"""An effect's amplitude that is another elsewhere is found where it is, and one that is not is called steady."""

from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from tautline.diagnosis import resembles, wander
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit, Hypothesis, Scope
from tautline.diagnosis.hypotheses import Wander
from tautline.diagnosis.segment import prepare
from tautline.effects import BY_ID, of_simulator
from tautline.plain import plain
from tests.host.test_diagnose import recordings, true_model

NOISE = 0.05
LIMITS = [1e3, 1e3, 1e3]
LAG, WIDER = "transmission.lag", "transmission.rate_dependent_backlash"


def fitted(fitter: Fitter, name: str) -> Fit:
    kind = BY_ID[name]
    start = {p.name: fitter.scale(p) for p in kind.amplitudes} | {p.name: p.shape[0] for p in kind.shapes}
    return fitter.fit(Hypothesis().plus(kind, Scope.TESTS), start, fitter.nominal().state)


@pytest.fixture(scope="module")
def lagging() -> Fitter:
    made = recordings({"lag": 0.08})
    fitter = Fitter(true_model(), prepare(true_model(), made[0], made[1:]))
    fitter.floor = NOISE
    return fitter


@pytest.fixture(scope="module")
def lag(lagging: Fitter) -> Fit:
    return fitted(lagging, LAG)


def wanders(fitter: Fitter, fit: Fit) -> Wander:
    (found,) = wander.of_fit(fitter, fit, fitter.linearised(fit), LIMITS)
    return found


def by_chance(found: Wander) -> float:
    """Probability that noise alone has factors as large."""
    squares = found.gradient @ np.linalg.solve(found.matrix, found.gradient)
    return float(chi2.sf(squares, len(found.gradient)))


def test_a_right_effect_is_the_same_everywhere(lagging: Fitter, lag: Fit) -> None:
    """To what the noise tells of it."""
    found = wanders(lagging, lag)
    _, low, high = found.between
    assert by_chance(found) > 1e-3
    assert low == pytest.approx(1.0, abs=0.02) and high == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("name", [WIDER, "transmission.creep"])
def test_one_that_only_imitates_the_cause_is_another_elsewhere(lagging: Fitter, name: str) -> None:
    """A width by speed does what a lag does at one speed, a creep what it does for a while."""
    found = wanders(lagging, fitted(lagging, name))
    assert by_chance(found) < 1e-6 and found.between[0] == "speed"


@pytest.mark.parametrize("share", [0.3, -0.4])
def test_an_amplitude_is_another_by_as_much_as_it_was_made(lagging: Fitter, lag: Fit, share: float) -> None:
    """Over the session's time: from 1 - share at its beginning to 1 + share at its end."""
    rows = lagging.linearised(lag)
    begins, ends = (f(float(s.arrival_s[i] + s.offset_s) for s in lagging.segments) for f, i in ((min, 0), (max, -1)))
    segments = []
    for segment, row in zip(lagging.segments, rows, strict=True):
        time = 2.0 * (segment.arrival_s + segment.offset_s - begins) / (ends - begins) - 1.0
        added = lag.state.values["lag"] * row.columns[:, :, -2] * (share * time[segment.scored])[:, None]
        observed = segment.observed.copy()
        observed[segment.scored] += added
        segments.append(replace(segment, observed=observed))
    other = Fitter(lagging.model, segments)
    other.floor = NOISE
    found = wanders(other, Fit(lag.hypothesis, lag.state, other.residuals(lag.state, lag.hypothesis)))
    axis, low, high = found.between
    # The lag is in the tests alone, the later part of the session; what is the same all over it is the lag's own size.
    at = found.ends["time"]
    factors = np.linalg.solve(found.matrix, found.gradient)
    assert axis == "time" and np.sign(high - low) == np.sign(share)
    later = np.concatenate([s.arrival_s[s.scored] + s.offset_s for s in segments[1:]])
    weight = np.concatenate([np.sum(row.columns[:, :, -2] ** 2, axis=1) for row in rows[1:]])
    ranked = np.argsort(later)
    told = later[ranked][np.searchsorted(np.cumsum(weight[ranked]), [0.1 * weight.sum(), 0.9 * weight.sum()])]
    made = share * 2.0 * float(np.ptp(told)) / (ends - begins)
    sigma = float(np.sqrt(np.diff(at, axis=0) @ np.linalg.inv(found.matrix) @ np.diff(at, axis=0).T)[0, 0])
    assert float(np.diff(at @ factors)[0]) == pytest.approx(made, abs=max(4.0 * sigma, 0.05 * abs(made)))


def test_a_small_effect_beside_a_large_one_is_measured_by_both(lagging: Fitter, lag: Fit) -> None:
    """What the large one leaves because it is not exact is a large share of the small one."""
    small = BY_ID["configuration.axis_coupling"].only(["c_per_translation", "c_per_rotation"])
    amplitudes = {p.name: fraction * lagging.scale(p) for p, fraction in zip(small.amplitudes, (0.3, 0.3), strict=True)}
    both = Fit(
        lag.hypothesis.plus(small, Scope.TESTS),
        replace(lag.state, values={**lag.state.values, **amplitudes}),
        lag.residuals,
    )
    rows = lagging.linearised(both)
    sizes = [both.state.values[s.key] * (s.parameter.name != "lag_second") for s in both.hypothesis.slots]
    whole = sum(float(np.sum((row.columns[:, :, -len(sizes) :] @ np.array(sizes)) ** 2)) for row in rows)
    places = wander.axes_values([wander._course(*each) for each in zip(lagging.segments, rows, strict=True)])
    coupling = [row.columns[:, :, -2:] @ np.array(sizes[-2:]) for row in rows]
    assert wander._power(coupling) < 0.5 * whole
    functions, _ = wander.varying_columns(places, coupling, whole)
    assert np.sum([np.sum(each**2, axis=(0, 1)) for each in functions], axis=0) == pytest.approx(whole)
    alone, beside = (wander.of_fit(lagging, fit, lagging.linearised(fit), LIMITS) for fit in (lag, both))
    assert [of.id for of in beside] == [LAG, small.id]
    assert np.ptp(beside[1].ends["time"][:, 3:]) > np.ptp(alone[0].ends["time"][:, 3:])


def test_a_curve_over_the_place_is_not_asked_for_its_place(lagging: Fitter) -> None:
    name = "transmission.backlash"
    kind = BY_ID[name]
    fit = lagging.fit(
        Hypothesis().plus(kind, Scope.TESTS), dict.fromkeys((p.name for p in kind.amplitudes), 0.01), lagging.start()
    )
    assert "place" not in wanders(lagging, fit).ends and "place" in wanders(lagging, fitted(lagging, LAG)).ends


def test_what_adds_nothing_tells_nothing(lagging: Fitter, lag: Fit) -> None:
    values = {**lag.state.values, "lag": 0.0}
    absent = replace(lag, state=replace(lag.state, values=values))
    assert wander.of_fit(lagging, absent, lagging.linearised(absent), LIMITS) == ()
    assert wander.of_fit(lagging, lagging.nominal(), lagging.rows(lagging.start(), lagging.no_effect), LIMITS) == ()


def test_memory_makes_numbers_tell_less() -> None:
    """Of noise of the first order (1 + rho) / (1 - rho) numbers tell as much as one that is independent."""
    rng = np.random.default_rng(2)
    white = rng.normal(size=(60_000, 1))
    remembered = np.zeros_like(white)
    for i in range(1, len(white)):
        remembered[i] = 0.8 * remembered[i - 1] + 0.6 * white[i]
    assert wander._power_per_independent([white]) == pytest.approx(1.0, rel=0.1)
    assert wander._power_per_independent([remembered[:30_000], remembered[30_000:]]) == pytest.approx(9.0, rel=0.15)


def test_it_is_told_in_the_effects_own_unit(lag: Fit) -> None:
    size = lag.state.values["lag"]
    assert resembles._amplitudes_in_words(lag, "speed", 0.03 / size, 0.08 / size) == "30 ms when slow, 80 ms when fast"


def test_of_a_simulators_parameter_the_change_is_told(lag: Fit) -> None:
    kind = of_simulator("servo.kp")
    fit: Any = SimpleNamespace(
        hypothesis=SimpleNamespace(kinds=(kind,)),
        state=SimpleNamespace(values={kind.id: -1.0}, model=lag.state.model),
    )
    assert resembles._amplitudes_in_words(fit, "speed", 0.5, 1.5) == "changed by -0.5 when slow, -1.5 when fast"


def test_it_is_kept_without_loss(lagging: Fitter, lag: Fit) -> None:
    found = wanders(lagging, lag)
    again = Wander.from_json(plain(asdict(found)))
    assert again.id == found.id and np.array_equal(again.matrix, found.matrix)
    assert again.ends.keys() == found.ends.keys() and again.between == found.between


def test_a_recording_of_which_nothing_counts_has_no_part_in_it() -> None:
    """Other axes move throughout: no frame shows the image's one curve."""
    t = np.arange(0.0, 20.0, 0.05)
    seen = wander.Course(np.sin(t), t, t, 0.0 * t, t >= 0.0)
    values = wander.axes_values([seen, replace(seen, scored=t < 0.0)])
    assert [len(of) for of in values["place"]] == [len(t), 0]
    assert np.ptp(values["time"][0]) == pytest.approx(2.0)


@pytest.mark.parametrize("share", [1.0, 0.1, 0.02])
def test_what_varies_is_measured_over_the_signal_alone(share: float) -> None:
    """An obstacle's: its polynomials are orthonormal over the part of the range in which it is met."""
    p = np.linspace(-1.0, 1.0, 4000)
    signal = np.where(p > 1.0 - 2.0 * share, 1.0 + p, 0.0)[:, None]
    (columns,), _ = wander.varying_columns({"place": [p]}, [signal], float(np.sum(signal**2)))
    gram = np.einsum("nkm,nkl->ml", columns, columns) / np.sum(signal**2)
    np.testing.assert_allclose(gram, np.eye(3), atol=1e-9)
