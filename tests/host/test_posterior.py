"""A posterior is the normal distribution that it says: against draws, closed forms and itself."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import LinAlgError
from scipy.stats import multivariate_normal

from tautline.core.posterior import Posterior
from tautline.errors import TautError

RNG = np.random.default_rng(3)
X = RNG.normal(size=(40, 3))
Y = X @ np.array([1.0, -2.0, 0.5]) + RNG.normal(0.0, 0.3, 40)
PRIOR = np.array([1.0, 4.0, 2.0])  # variances
NAMES = ("a", "b", "c")


def linear(x=X, y=Y, prior=PRIOR) -> Posterior:
    """Of y = x theta + noise of 0.3, where Laplace's approximation is exact."""
    hessian = x.T @ x / 0.09 + np.diag(1.0 / prior)
    mode = np.linalg.solve(hessian, x.T @ y / 0.09)
    joint = multivariate_normal(x @ mode, 0.09).logpdf(y) if len(y) == 1 else float(
        multivariate_normal(x @ mode, 0.09 * np.eye(len(y))).logpdf(y)
    )  # fmt: skip
    joint += float(multivariate_normal(np.zeros(len(mode)), np.diag(prior)).logpdf(mode))
    return Posterior.laplace(NAMES[: len(mode)], mode, hessian, joint)


def test_the_evidence_is_the_datas_own_density():
    whole = multivariate_normal(np.zeros(40), X @ np.diag(PRIOR) @ X.T + 0.09 * np.eye(40))
    assert linear().log_evidence == pytest.approx(whole.logpdf(Y), abs=1e-8)
    assert Posterior(("a",), np.zeros(1), np.eye(1)).log_evidence != 0.0
    with pytest.raises(LinAlgError):
        Posterior.laplace(("a",), np.zeros(1), -np.eye(1), 0.0)


def test_given_is_what_a_fit_with_that_value_finds():
    found, known = linear(), 0.7
    fixed = found.given({"b": known})
    without = linear(X[:, [0, 2]], Y - known * X[:, 1], PRIOR[[0, 2]])
    assert fixed.names == ("a", "c")
    np.testing.assert_allclose(fixed.mean, without.mean, atol=1e-10)
    np.testing.assert_allclose(fixed.covariance, without.covariance, atol=1e-12)
    both = without.log_evidence + multivariate_normal(0.0, PRIOR[1]).logpdf(known)
    assert fixed.log_evidence == pytest.approx(both, abs=1e-8)


def test_marginal_and_spread_are_those_of_draws():
    found = linear()
    drawn = RNG.multivariate_normal(found.mean, found.covariance, 200_000)
    some = found.marginal(("c", "a"))
    np.testing.assert_allclose(some.mean, drawn[:, [2, 0]].mean(axis=0), atol=5e-3)
    np.testing.assert_allclose(some.sigma, drawn[:, [2, 0]].std(axis=0), rtol=0.02)
    slopes = RNG.normal(size=(4, 2, 3))
    np.testing.assert_allclose(found.spread(slopes), np.einsum("uvi,ni->nuv", slopes, drawn).std(axis=0), rtol=0.02)


def test_it_is_a_value_and_is_kept_without_loss(tmp_path: Path):
    found = linear()
    found.save(tmp_path / "posterior.json")
    assert Posterior.load(tmp_path / "posterior.json") == found != replace(found, log_evidence=0.0)
    unknown = Posterior(("a",), np.zeros(1), np.eye(1))
    unknown.save(tmp_path / "posterior.json")
    assert Posterior.load(tmp_path / "posterior.json") == unknown
    huge = json.dumps(
        {"format": "posterior/1", "names": ["a"], "mean": [10**400], "covariance": [[1]], "log_evidence": 0}
    )
    short = '{"format": "posterior/1", "names": ["a"], "mean": [1, 2]}'
    for text in ("", "{}", '{"format": "model/1"}', short, huge, "[" * 100_000):
        (tmp_path / "posterior.json").write_text(text)
        with pytest.raises(TautError, match="no posterior"):
            Posterior.load(tmp_path / "posterior.json")
    with pytest.raises(TautError):
        Posterior.load(tmp_path / "nowhere.json")


def test_names_that_are_not_there_are_told():
    for wrong in (lambda: linear().marginal(["d"]), lambda: linear().given({"d": 1.0})):
        with pytest.raises(ValueError, match="d: no such parameter, there are a, b, c"):
            wrong()
    with pytest.raises(ValueError, match="different names"):
        Posterior(("a", "a"), np.zeros(2), np.eye(2))
