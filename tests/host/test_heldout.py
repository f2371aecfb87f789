"""What is left of a block is what a fit without that block leaves of it."""

from dataclasses import replace

import numpy as np
import pytest

from tautline.diagnosis import gap, heldout
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Hypothesis, Scope
from tautline.diagnosis.segment import prepare
from tautline.effects import BY_ID
from tests.host.test_diagnose import recordings, rms, true_model


@pytest.fixture(scope="module")
def fitter():
    made = recordings({"lag": 0.08})
    found = Fitter(true_model(), prepare(true_model(), made[0], made[1:2]))
    found.floor = 0.05
    return found


@pytest.mark.parametrize(("effect", "at"), [("transmission.lag", {"lag": 0.08}), ("configuration.axis_coupling", {})])
def test_it_is_what_a_refit_leaves(fitter, effect, at, monkeypatch):
    monkeypatch.setattr(heldout, "STAYS", 0.0)
    kind = BY_ID[effect]
    start = {p.name: at.get(p.name, 1e-3 if p in kind.amplitudes else 0.0) for p in (*kind.amplitudes, *kind.shapes)}
    fit = fitter.fit(Hypothesis().plus(kind, True), start, fitter.nominal().state)
    labels = [gap.blocks(s) for s in fitter.segments]
    left = heldout.residuals_and_surprise(fitter, fit.hypothesis, fitter.linearised(fit), labels, [1e3, 1e3])[0]
    calibration = fitter.segments[0]
    for number in (1, 3):  # the last alone shows one end of the range
        without = calibration.scored.copy()
        without[calibration.scored] = labels[0] != number
        partial = Fitter(fitter.model, [calibration.part(without), fitter.segments[1]])
        partial.floor = fitter.floor
        again = partial.descend(fit.hypothesis, fit.state, 8)
        at_block = replace(calibration, scored=calibration.scored & ~without)
        values = again.state.at(at_block, fit.hypothesis)
        _, predicted = at_block.predict(again.state.model, values, 0.0)
        refitted = (at_block.observed - predicted)[at_block.scored]
        assert rms(left[0][labels[0] == number]) == pytest.approx(rms(refitted), rel=0.1)
        assert rms(left[0][labels[0] == number]) > rms(fit.residuals[0][labels[0] == number])


def test_an_outlier_pulls_no_block(fitter):
    fit = fitter.nominal()
    labels = [gap.blocks(s) for s in fitter.segments]
    plain = heldout.residuals_and_surprise(fitter, fit.hypothesis, fitter.linearised(fit), labels, [1.0, 1.0])[0]
    lost = fitter.segments[1].observed.copy()
    lost[np.flatnonzero(fitter.segments[1].scored)[40]] += 200.0
    broken = Fitter(fitter.model, [fitter.segments[0], replace(fitter.segments[1], observed=lost)])
    broken.floor = fitter.floor
    again = heldout.residuals_and_surprise(broken, fit.hypothesis, broken.linearised(fit), labels, [1.0, 1.0])[0]
    other = labels[1] != labels[1][40]
    assert rms(again[1][other] - plain[1][other]) < 0.1 * rms(plain[1][other])


@pytest.mark.parametrize(("second", "least", "most"), [(0.08, 0.0, 0.3), (0.2, 3.0, np.inf)])
def test_a_recording_surprises_the_fit_of_the_others_where_its_effect_is_another(second, least, most):
    """One lag for both tests: where it is one, and where it is two."""
    made, other = recordings({"lag": 0.08}), recordings({"lag": second})
    fitter = Fitter(true_model(), prepare(true_model(), made[0], [made[1], other[2]]))
    fitter.floor = 0.05
    kind = BY_ID["transmission.lag"]
    start = {p.name: 0.08 if p in kind.amplitudes else p.shape[0] for p in kind.parameters}
    fit = fitter.fit(Hypothesis(tests=2).plus(kind, Scope.TESTS), start, fitter.nominal().state)
    labels = [gap.blocks(s) for s in fitter.segments]
    limits = [1e3, 1e3, 1e3]
    rows = fitter.linearised(fit)
    _, surprise = heldout.residuals_and_surprise(fitter, fit.hypothesis, rows, labels, limits)
    of_tests = [float(np.mean(values)) / fitter.floor**2 for values in surprise[1:]]
    assert least <= max(of_tests) < most
    # What is left of all, less what a fit of the others alone leaves of these: no more than the former.
    whole = sum(float(np.sum(row.residual**2)) for row in rows)
    assert all(2.0 * float(np.sum(values)) < whole for values in surprise)
