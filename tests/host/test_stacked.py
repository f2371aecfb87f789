"""What is worked out for all hypotheses at once, against the same written out block by block."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid
from scipy.special import logsumexp
from scipy.stats import invgamma, multivariate_normal, norm
from scipy.stats import t as student

from tautline.diagnosis.hypotheses import Beyond, CaseEvidence, Wander, Weighed
from tautline.diagnosis.stacked import CONFINED, SHARES, WANDERS, Stacked

FLOOR = 0.05
LAG, OFFSET, STICK = "transmission.lag", "transmission.offset", "transmission.stick_slip"


def case(seed: int, blocks: int, calibrated: float = 2.0) -> CaseEvidence:
    rng = np.random.default_rng(seed)
    none = np.zeros(blocks)

    def powers(most: float) -> np.ndarray:
        return FLOOR**2 * np.exp(rng.uniform(-1.0, most, blocks))

    beyond_stages = [Beyond(powers(most), rng.integers(2, 500, blocks).astype(float)) for most in (0.2, 9.0)]
    hypotheses = [
        Weighed((), powers(6.0), none, none, 0),
        Weighed((LAG,), powers(2.0), none, none, 2, beyond=beyond_stages[0]),
        Weighed((OFFSET,), powers(3.0), none, none, 1, beyond=beyond_stages[1]),
        Weighed((LAG, OFFSET), powers(1.0), none, none, 3, beyond=beyond_stages[0]),
    ]
    return CaseEvidence(FLOOR, powers(6.0), tuple(hypotheses), 18, calibrated * FLOOR**2)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 40), st.floats(0.05, 0.6), st.floats(0.02, 0.3), st.floats(0.001, 0.5))
def test_what_is_left_beyond_the_stages_is_noise_or_it_is_not(seed, blocks, known, steady, disturbed):
    """Noise of a power that is known to `known`; in a share of the blocks anything from the noise up."""
    evidence = case(seed, blocks)
    told = Stacked(evidence).confined_log_ratio(known, steady, disturbed)
    assert told[0] == 0.0
    off = np.linspace(-20.0, 3.0, 116) * known
    prior = np.array([-0.5 * (o / known) ** 2 if o > 0.0 else -abs(o) for o in off])
    for h, ratio in zip(evidence.hypotheses[1:], told[1:], strict=True):
        assert h.beyond is not None

        power, count = h.beyond.power, h.beyond.count
        spread = np.sqrt(2.0 / count + steady**2)
        x = np.log(power / FLOOR**2) - off[:, None]
        noise = student.logpdf(x, 8.0, scale=spread)
        below = student.logcdf(x, 8.0, scale=spread)  # the block's noise, on top of which something is
        any_size = below - np.log((np.maximum(x, 0.0) + spread) * np.log1p(12.0 / spread))

        def of_share(share: float, noise: np.ndarray = noise, any_size: np.ndarray = any_size) -> float:
            blocks = np.logaddexp(np.log1p(-share) + noise, np.log(share) + any_size)
            return float(logsumexp(prior + blocks.sum(axis=1)) - logsumexp(prior))

        right = of_share(disturbed)
        wrong = logsumexp([of_share(share) for share in np.arange(0.05, 1.0, 0.1)]) - np.log(10.0)
        expected = right - np.logaddexp(np.log(CONFINED) + right, np.log1p(-CONFINED) + wrong)
        assert ratio == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_far_too_much_is_left_in_very_many_blocks():
    """Within what a double holds."""
    evidence = case(1, 300)
    assert np.isfinite(Stacked(evidence).confined_log_ratio(1.0, 0.02, 0.99)).all()


TIMES = np.exp(np.linspace(-8.0, 20.0, 1500))  # of a misfit's mean power


def beyond(power: np.ndarray, noise: float, tells: float) -> tuple[np.ndarray, float]:
    """The number beyond noise of each block, and the log-density of the other ones: as much as is expected, or less."""
    others = np.minimum(power / FLOOR**2, noise)
    number = np.sqrt(tells * power / FLOOR**2 - (tells - 1.0) * others)
    return number, float(np.sum(-0.5 * (tells - 1.0) * (np.log(noise) + others / noise)))


def density(x: np.ndarray, noise: float, misfit: float, freedom: float) -> np.ndarray:
    """Of normal noise beside a number that is Student's t: normal, its variance inverse-gamma, integrated over that."""
    weight = invgamma(freedom / 2.0, scale=freedom / 2.0).pdf(TIMES)
    of_times = norm.pdf(x[:, None], scale=np.sqrt(noise + TIMES * misfit))
    return np.sqrt(2.0 * np.pi) * trapezoid(of_times * weight, TIMES, axis=1)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000), st.floats(3.0, 30.0), st.floats(1.0, 9.0), st.floats(0.01, 0.5))
def test_what_a_block_holds_beyond_noise_is_one_number(seed, tells, freedom, excess):
    evidence = case(seed, 4, calibrated=1.0)
    told = Stacked(evidence).log_likelihood_by_share(tells, freedom, excess)
    before = np.maximum(evidence.hypotheses[0].power / FLOOR**2 - 1.0, 0.0)
    for i, h in enumerate(evidence.hypotheses):
        x, expected = beyond(np.maximum(h.power, FLOOR**2), 1.0 + excess, tells)  # less is less noise
        for share, value in zip(SHARES[16::8], told[i, 16::8], strict=True):
            of_blocks = [
                density(x[b : b + 1], 1.0 + excess, tells * share * gap, freedom)[0] for b, gap in enumerate(before)
            ]
            assert value == pytest.approx(expected + np.sum(np.log(of_blocks)), abs=0.02 * len(x))


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000), st.integers(1, 30), st.floats(3.0, 30.0), st.floats(1.0, 9.0), st.floats(0.01, 0.5))
def test_a_gap_that_nothing_imitates_is_of_any_size_in_any_share_of_the_blocks(seed, blocks, tells, freedom, excess):
    evidence, noise = case(seed, blocks, calibrated=1.0), 1.0 + excess
    x, expected = beyond(np.maximum(evidence.hypotheses[0].power, FLOOR**2), noise, tells)
    quiet = density(x, noise, 0.0, freedom)
    disturbed = [density(x, noise, np.exp(log_size), freedom) for log_size in np.linspace(0.0, 12.0, 60)]
    mixed = [np.log((1.0 - s) * quiet + s * of).sum() for of in disturbed for s in np.arange(0.05, 1.0, 0.1)]
    expected += logsumexp(mixed) - np.log(len(mixed))
    told = Stacked(evidence).log_likelihood_of_any_gap(tells, freedom, excess)
    assert told == pytest.approx(expected, abs=0.05 + 0.02 * blocks)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.integers(2, 12), st.floats(0.01, 0.5), st.booleans())
def test_an_event_has_what_nothing_else_foretells(seed, blocks, excess, later):
    """Of its own blocks alone: an event that came after the calibration says nothing of that."""
    rng = np.random.default_rng(seed)
    plain = case(seed, blocks)
    seen = np.arange(blocks) >= 1 if later else np.ones(blocks, bool)

    def event(of: Weighed) -> Weighed:
        scatter, rival = (np.where(seen, -rng.uniform(0.1, 5.0, blocks), 0.0) for _ in range(2))
        return replace(of, ids=(*of.ids, STICK), scatter=scatter, rival=rival)

    events = [event(h) for h in plain.hypotheses[:2]]
    told = Stacked(replace(plain, hypotheses=(*plain.hypotheses, *events))).gain_by_event(excess)
    assert not told[:4].any()

    def left(h: Weighed, factor: np.ndarray) -> float:
        power = np.maximum(h.power, FLOOR**2) * np.exp(factor)
        return sum(np.log(max(p / FLOOR**2, 1.0 + excess)) for p in power[seen])

    without = [left(h, np.minimum(h.rival, 0.0)) for h in (*plain.hypotheses, *events)]
    expected = [min(without) - left(h, h.scatter) for h in events]
    assert told[4:] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 10), st.floats(3.0, 30.0), st.floats(1.0, 4.0), st.floats(0.05, 2.0))
def test_what_the_calibration_leaves_is_in_the_tests_the_same(pairs, tells, calibrated, excess):
    """One number in each block, white noise and beside it one that two blocks share: the determinant of their
    covariance is what a likelihood by blocks lacks."""
    none, noise = np.zeros(2 * pairs), 1.0 + excess
    quiet = Weighed((), np.full(2 * pairs, FLOOR**2), none, none, 0)
    stacked = Stacked(CaseEvidence(FLOOR, quiet.power, (quiet,), 18, calibrated * FLOOR**2))
    most = tells * (calibrated - 1.0)
    for beside in (0.0, 0.4 * most, most, 2.0 * most):
        seen = np.full(2 * pairs, noise + beside / tells) * FLOOR**2
        x, expected = beyond(seen, noise, tells)
        own = min(beside, most)
        covariance = noise * np.eye(2 * pairs) + own * np.kron(np.eye(pairs), np.ones((2, 2)))
        expected -= 0.5 * np.linalg.slogdet(covariance)[1] + 0.5 * np.sum(x**2) / (noise + own)
        told = stacked.log_likelihood(seen, 0.0, excess, stacked.own_misfit, tells, 3.0)
        assert told == pytest.approx(expected, rel=1e-9, abs=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 6), st.floats(0.0, 2.0))
def test_an_amplitude_wanders_by_normal_factors(seed, factors, share):
    """Of white noise of variance 1 and of factors whose prior variances sum to the square of what it wanders by."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(12, factors)) * np.exp(rng.uniform(-2.0, 3.0, factors))
    seen = share * columns @ rng.normal(size=factors) + rng.normal(size=12)
    evidence = case(seed, 3)
    wanders = (Wander(LAG, columns.T @ columns, columns.T @ seen, {}),)
    weighed = [replace(h, wanders=wanders) if h.ids == (LAG,) else h for h in evidence.hypotheses]
    stacked = Stacked(replace(evidence, hypotheses=tuple(weighed)))
    assert stacked.wandering.tolist() == [1]
    nothing = multivariate_normal.logpdf(seen, np.zeros(12), np.eye(12))
    for by, told in zip(WANDERS[::6], stacked.wander[0, ::6], strict=True):
        covariance = np.eye(12) + by**2 / factors * columns @ columns.T
        expected = multivariate_normal.logpdf(seen, np.zeros(12), covariance) - nothing
        assert told == pytest.approx(expected, rel=1e-6, abs=1e-6)
