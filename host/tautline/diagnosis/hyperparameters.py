"""The hyperparameters of a verdict: how right and wrong hypotheses behave, set by hand and learnt on blind cases of
several generators (tools/learning.py). docs/diagnosis.md has the reason for each."""

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
_LARGEST_SHARE = 0.99  # limit: of a share or probability that is learnt by its logarithm


@dataclass(frozen=True)
class Hyperparameters:
    """The numbers that a verdict depends on. All are positive, and they are learnt as logarithms."""

    noise_tells: float  # independent numbers in a block of noise; a block's misfit counts as one number beside them
    block_freedom: float  # degrees of freedom of a block's misfit: how much blocks' misfits differ
    unexplained: float  # share of the gap's power that a right effect may well leave
    unexplained_by_law: float  # share that an effect with one exact equation (rigid motion, time) may well leave
    unexplained_by_wrong: float  # share at least that the best wrong effect leaves; any larger one is as likely
    mimics: float  # probability, for each parameter of a wrong effect, that it leaves no more than a right one
    share_spread: float  # standard deviation of the logarithm of a share beyond the shares above
    calibration_excess: float  # share of the noise power that a sound calibration leaves above it
    odds_none: float  # prior odds of no effect to one
    odds_unknown: float  # prior odds of an unknown cause to one effect
    odds_further: float  # prior odds of a further effect to none
    odds_brought: float  # probability that an effect which may change a part of the nominal model does
    odds_each: float  # prior odds of an effect with amplitudes of its own in each recording, to one that stays
    parameter_price: float  # multiple of the Bayesian information criterion's price of a parameter
    floor_known: float  # standard deviation of the logarithm of the noise's power between cases
    floor_steady: float  # standard deviation of the logarithm of the noise's power between the blocks of a case
    wanders: float  # mean share by which the amplitude of a right effect of geometry or time varies
    wanders_material: float  # mean share for effects of friction or material, a simulator's parameters, users' effects
    disturbed: float  # share of blocks in which something happens that no model has, such as the moment of a shift

    def mimicked(self, parameters: Array | float) -> Array:
        """Probability that a wrong effect with so many parameters (any shape) leaves no more than a right one: 1 - (1 -
        mimics)^parameters, as each parameter, at least one, is a chance to follow the cause."""
        return np.asarray(1.0 - (1.0 - self.mimics) ** np.maximum(parameters, 1))

    def logarithms(self) -> Array:
        """(hyperparameters,) Natural logarithms in the fields' order."""
        return np.log(list(asdict(self).values()))

    @classmethod
    def of_logarithms(cls, values: Array) -> Hyperparameters:
        """The inverse of `logarithms`, except that shares and probabilities (_SHARES) are limited to _LARGEST_SHARE."""
        by_name = {f.name: math.exp(v) for f, v in zip(fields(cls), values, strict=True)}
        kept = {name: min(value, _LARGEST_SHARE) if name in _SHARES else value for name, value in by_name.items()}
        return cls(**kept)


_SHARES = frozenset(
    ("unexplained", "unexplained_by_law", "unexplained_by_wrong", "mimics", "odds_brought", "odds_each", "disturbed")
)


@dataclass(frozen=True)
class Learnt:
    """All that is learnt on blind cases; the content of FILE."""

    center: Hyperparameters  # the likeliest ones
    covers: float  # share of all effects' probability that a set must hold to have the right one in 95 % of cases
    elsewhere: tuple[float, float] = (0.0, 0.0)  # 5 and 95 % quantiles of gap.normalised_excess on unseen motions
    later: tuple[float, float] = (0.0, 0.0)  # the same where a named effect grows with time: an unseen motion is later

    def to_toml(self, cases: Mapping[str, int]) -> str:
        """The content of FILE as TOML text, numbers rounded to four digits (the quantiles to three). cases: of how many
        cases of each generator it was learnt."""
        center = {name: float(f"{value:.4g}") for name, value in asdict(self.center).items()}
        learnt_on = {"cases": dict(cases), "covers": float(f"{self.covers:.4g}")}
        ends = {
            name: [float(f"{end:.3g}") for end in interval]
            for name, interval in (("elsewhere", self.elsewhere), ("later", self.later))
        }
        return tomli_w.dumps({**learnt_on, **ends, "center": center})

    @classmethod
    def of_toml(cls, document: Mapping[str, object]) -> Learnt:
        """Reads a parsed TOML document as `to_toml` writes it; its `cases` are not kept."""
        center = document["center"]
        assert isinstance(center, dict) and isinstance(document["covers"], float)
        elsewhere, later = _interval_of(document["elsewhere"]), _interval_of(document["later"])
        return cls(Hyperparameters(**center), document["covers"], elsewhere, later)


def _interval_of(interval: object) -> tuple[float, float]:
    """(Low, high) end of an interval that TOML has as a list of two numbers."""
    assert isinstance(interval, list)
    low, high = interval
    return float(low), float(high)


NAMES = tuple(field.name for field in fields(Hyperparameters))


@cache
def learnt() -> Learnt:
    """The content of the package's FILE, which is read once."""
    return Learnt.of_toml(tomllib.loads(resources.files(__package__).joinpath(FILE).read_text("utf-8")))
