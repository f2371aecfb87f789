"""How right and wrong hypotheses behave: set by hand and learnt on blind cases of several generators
(tools/learning)."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt
import tomli_w

Array = npt.NDArray[np.float64]

FILE = "hyperparameters.toml"


@dataclass(frozen=True)
class Hyperparameters:
    """All positive; learnt as logarithms. docs/diagnosis.md has a reason for each."""

    misfit_tells: float  # independent observations in a block of misfit
    noise_tells: float  # and in one of noise, or of scatter that forgets
    block_freedom: float  # degrees of freedom of a block's own variance: how unlike blocks are
    unexplained: float  # share of the power that a right effect may well leave
    unexplained_by_law: float  # that of one with the same equations everywhere, rigid motion and time
    unexplained_by_wrong: float  # share from which on the best wrong one may well leave any
    mimics: float  # probability that a wrong one leaves no more than a right one
    share_spread: float  # of the logarithm of a share beyond these
    calibration_excess: float  # of the floor's power: what a calibration leaves above it where nothing is wrong
    odds_none: float  # prior, to one effect
    odds_unknown: float
    odds_further: float  # of a further effect to none
    odds_brought: float  # that an effect which may bring a part of the nominal model with it does
    odds_each: float  # that an effect is another in each recording, to one that stays
    parameter_price: float  # of the Bayesian information criterion's
    floor_known: float  # of the noise power's logarithm: how well a case's is known
    floor_steady: float  # and how unlike blocks are
    wanders: float  # share by which the amplitude of one of geometry or time is another elsewhere, in the mean
    wanders_material: float  # that of one of friction or a tendon's material, a simulator's own or a user's own
    disturbed: float  # share of blocks in which something happens that no model has, such as the moment of a shift

    def logarithms(self) -> Array:
        return np.log(list(asdict(self).values()))

    @classmethod
    def of_logarithms(cls, values: Array) -> Hyperparameters:
        """Out of natural logarithms in the fields' order; shares and probabilities are kept at 0.99 or below."""
        by_name = {f.name: math.exp(v) for f, v in zip(fields(cls), values, strict=True)}
        return cls(**{name: min(value, 0.99) if name in _SHARES else value for name, value in by_name.items()})


_SHARES = frozenset(
    ("unexplained", "unexplained_by_law", "unexplained_by_wrong", "mimics", "odds_brought", "odds_each", "disturbed")
)


@dataclass(frozen=True)
class Learnt:
    center: Hyperparameters
    covers: float  # share of the effects' probability that a set must hold so that it has the right one in 95 %
    elsewhere: tuple[float, float] = (
        0.0,
        0.0,
    )  # 5 and 95 % of gap.normalised_excess on unseen motions
    later: tuple[float, float] = (0.0, 0.0)  # the same where something goes with time: another motion is later

    def to_toml(self, cases: Mapping[str, int]) -> str:
        """As TOML text. cases: how many of each generator it was learnt on."""
        center = {name: float(f"{value:.4g}") for name, value in asdict(self.center).items()}
        learnt_on = {"cases": dict(cases), "covers": float(f"{self.covers:.4g}")}
        ends = {
            name: [float(f"{end:.3g}") for end in of]
            for name, of in (("elsewhere", self.elsewhere), ("later", self.later))
        }
        return tomli_w.dumps({**learnt_on, **ends, "center": center})

    @classmethod
    def of_toml(cls, document: Mapping[str, object]) -> Learnt:
        center = document["center"]
        assert isinstance(center, dict) and isinstance(document["covers"], float)
        elsewhere, later = _ends(document["elsewhere"]), _ends(document["later"])
        return cls(Hyperparameters(**center), document["covers"], elsewhere, later)


def _ends(of: object) -> tuple[float, float]:
    """Both ends of an interval that is a list of two in TOML."""
    assert isinstance(of, list)
    low, high = of
    return float(low), float(high)


NAMES = tuple(field.name for field in fields(Hyperparameters))


@cache
def learnt() -> Learnt:
    """What comes with the package, read once."""
    return Learnt.of_toml(tomllib.loads(resources.files(__package__).joinpath(FILE).read_text("utf-8")))
