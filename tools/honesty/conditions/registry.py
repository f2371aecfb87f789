from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from tools.honesty.setup import Setup, accept

Maker = Callable[[np.random.Generator], Setup]
BENIGN = "benign"


@dataclass(frozen=True)
class Condition:
    name: str
    family: str
    codes: tuple[str, ...]  # reasons that are right; empty for benign ones
    must_not_pass: bool
    make: Maker
    needs: str | None = None  # a module that not everybody has

    @property
    def possible(self) -> bool:
        return self.needs is None or find_spec(self.needs) is not None


CONDITIONS: dict[str, Condition] = {}


def condition(
    family: str, *codes: str, must_not_pass: bool = False, needs: str | None = None
) -> Callable[[Maker], Maker]:
    """Registers a maker under its own name."""

    def register(make: Maker) -> Maker:
        name = make.__name__.removeprefix("_").replace("_", "-")
        if name in CONDITIONS:
            raise ValueError(f"two conditions are called {name}")
        CONDITIONS[name] = Condition(name, family, codes, must_not_pass, make, needs)
        return make

    return register


def build(name: str, seed: int) -> Setup:
    """The same set-up for the same name and seed, on every machine and whatever else is registered."""
    known = CONDITIONS[name]
    setup = known.make(np.random.default_rng([zlib.crc32(name.encode()), seed]))
    accept(setup, *known.codes)
    setup.benign = known.family == BENIGN
    setup.must_not_pass = known.must_not_pass
    return setup
