"""The variance of a Gaussian process of a motion's states: nothing where it was seen, the prior's elsewhere."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline.diagnosis import flexible
from tautline.discrepancy import Discrepancy, states
from tautline.recording import Motor


@settings(max_examples=30, deadline=None)
@given(apart=st.floats(0.0, 3.0), white=st.floats(0.01, 1.0), sigma=st.floats(0.1, 5.0))
def test_beside_a_single_reading_it_is_known_by_their_correlation(apart, white, sigma):
    """Of two normal values with correlation rho = exp(-d^2 / 2), one seen with noise: 1 - rho^2 / (1 + white)."""
    one = Discrepancy(sigma, np.zeros((1, 2)), np.array([0.5, 2.0]), white)
    expected = sigma * np.sqrt(1.0 - np.exp(-(apart**2)) / (1.0 + white))
    assert one.sigma_at(np.array([[0.5 * apart, 0.0]]))[0] == pytest.approx(expected, rel=1e-6)
    assert one.sigma_at(np.array([[0.0, 100.0]]))[0] == pytest.approx(sigma)


def test_it_is_remembered_as_text():
    inputs = np.random.default_rng(1).normal(size=(20, 3))
    one = Discrepancy(0.7, inputs, np.ones(3), 0.1)
    again = Discrepancy.from_json(json.loads(json.dumps(one.to_json())))
    np.testing.assert_array_equal(one.sigma_at(inputs + 0.3), again.sigma_at(inputs + 0.3))


def test_its_lengths_are_those_of_what_was_seen():
    """A draw with lengths of 0.2 and 3 of inputs between -1 and 1, and one that does not vary."""
    rng = np.random.default_rng(2)
    inputs = np.column_stack([rng.uniform(-1.0, 1.0, (400, 2)), np.full(400, 0.3)])
    squared = ((inputs[:, None] - inputs) / np.array([0.2, 3.0, 1.0])) ** 2
    covariance = np.exp(-0.5 * squared.sum(axis=2)) + 1e-8 * np.eye(400)
    seen = np.linalg.cholesky(covariance) @ rng.normal(size=400) + 0.05 * rng.normal(size=400)
    found = flexible.discrepancy(inputs, seen[:, None], 0.05, 2.0)
    assert found.sigma == 2.0
    np.testing.assert_allclose(np.log(found.lengths[:2] / np.array([0.2, 3.0])), 0.0, atol=0.6)
    assert found.sigma_at(np.array([[0.0, 0.0, 0.3]]))[0] < 0.3
    assert found.sigma_at(np.array([[4.0, 0.0, 0.3]]))[0] > 1.9


def test_a_states_load_is_how_far_the_joint_is_from_its_command():
    t_s = np.arange(0.0, 2.0, 0.01)
    command, simulated = Motor(t_s, 10.0 * t_s), Motor(t_s, 10.0 * t_s - 3.0)
    place, speed, load = states(simulated, command, np.array([0.5, 1.0]), 20.0).T
    np.testing.assert_allclose(place, [0.1, 0.35])
    np.testing.assert_allclose(speed, 0.5)
    np.testing.assert_allclose(load, 0.15)
