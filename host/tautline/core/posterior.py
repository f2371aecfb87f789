"""What is known of a model's parameters: a normal distribution about the best ones, and how likely the data are."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from tautline.errors import TautError, of_system
from tautline.folders import write_file
from tautline.value import Value

Array = npt.NDArray[np.float64]

FORMAT = "posterior/1"


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Value):
    """Parameters by name, each in its own unit; log_evidence is that of all of the data, NaN where it is not known."""

    names: tuple[str, ...]
    mean: Array  # (n,)
    covariance: Array  # (n, n)
    log_evidence: float = np.nan

    def __post_init__(self) -> None:
        """Raises ValueError unless there are as many means, variances and different names."""
        n = len(self.names)
        if self.mean.shape != (n,) or self.covariance.shape != (n, n) or len(set(self.names)) != n:
            raise ValueError(f"a posterior of {n} parameters needs as many different names, means and variances")

    @classmethod
    def laplace(cls, names: Sequence[str], mode: Array, hessian: Array, log_joint: float) -> Self:
        """The normal approximation at the mode (n,) of the parameters: covariance H^-1, log evidence log_joint + n/2
        log(2 pi) - 1/2 log det H. log_joint: log(likelihood times prior) at the mode; H, `hessian` (n, n): its second
        derivatives, negated. LinAlgError where H is not positive definite."""
        factor = cho_factor(hessian)
        half_log_det = float(np.sum(np.log(np.diag(factor[0]))))
        evidence = log_joint + 0.5 * len(mode) * float(np.log(2.0 * np.pi)) - half_log_det
        return cls(tuple(names), mode, np.asarray(cho_solve(factor, np.eye(len(mode)))), evidence)

    @property
    def sigma(self) -> Array:
        """(n,) One standard deviation of each parameter."""
        return np.sqrt(np.diag(self.covariance))

    def marginal(self, names: Sequence[str]) -> Self:
        """The posterior of these parameters alone, in the order of `names`, the others integrated out. ValueError for
        an unknown name."""
        at = self._indices(names)
        return type(self)(tuple(names), self.mean[at], self.covariance[np.ix_(at, at)], self.log_evidence)

    def given(self, values: Mapping[str, float]) -> Self:
        """The posterior of the other parameters if these have known values, by name: the normal distribution's
        conditional one. Its log_evidence is the log of the joint density of the data and these values. ValueError for
        an unknown name."""
        known = self._indices(list(values))
        rest = np.setdiff1d(np.arange(len(self.names)), known)
        off = np.array(list(values.values())) - self.mean[known]
        within = self.covariance[np.ix_(known, known)]
        factor = cho_factor(within)
        across = self.covariance[np.ix_(rest, known)]
        # -2 log of the known values' normal density, but for 2 pi: squares over variance, and log det.
        squares = float(off @ cho_solve(factor, off)) + 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
        return type(self)(
            tuple(self.names[i] for i in rest),
            self.mean[rest] + across @ cho_solve(factor, off),
            self.covariance[np.ix_(rest, rest)] - across @ cho_solve(factor, across.T),
            self.log_evidence - 0.5 * squares - 0.5 * len(known) * float(np.log(2.0 * np.pi)),
        )

    def spread(self, slopes: Array) -> Array:
        """(...) One standard deviation of quantities with derivatives `slopes` (..., n) by the parameters, to first
        order: sqrt(g^T C g), C being the covariance."""
        return np.asarray(np.sqrt(np.einsum("...i,ij,...j->...", slopes, self.covariance, slopes)))

    def save(self, path: Path) -> None:
        """Writes the posterior as a JSON file, without loss. TautError where it cannot be written."""
        told = self.log_evidence if np.isfinite(self.log_evidence) else None
        arrays = {"mean": self.mean.tolist(), "covariance": self.covariance.tolist()}
        document = {"format": FORMAT, "names": list(self.names), **arrays, "log_evidence": told}
        write_file(path, json.dumps(document))

    @classmethod
    def load(cls, path: Path) -> Self:
        """Reads what `save` wrote. TautError where there is no such file, or it holds something else."""
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            if document["format"] != FORMAT:
                raise ValueError(document["format"])
            told = document["log_evidence"]
            mean, covariance = (np.array(document[name], dtype=float) for name in ("mean", "covariance"))
            return cls(tuple(document["names"]), mean, covariance, np.nan if told is None else float(told))
        except OSError as error:
            raise TautError(of_system(error)) from error
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise TautError(f"{path}: no posterior, or a damaged one: write it again") from error

    def _indices(self, names: Sequence[str]) -> npt.NDArray[np.intp]:
        """The places of these parameters in the posterior, (len(names),). ValueError for a name that it does not
        have."""
        if unknown := [name for name in names if name not in self.names]:
            raise ValueError(f"{', '.join(unknown)}: no such parameter, there are {', '.join(self.names)}")
        return np.array([self.names.index(name) for name in names], dtype=np.intp)
