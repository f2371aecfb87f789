"""What blind cases come from. Each generator has its own equations, and names those of the library's effects it makes;
what is learnt on some is tried on one that was left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec

from tautline.errors import TautError
from tools.blindtest import cases, draws, own, setup
from tools.blindtest.cases import Case
from tools.blindtest.physical import draws as physical
from tools.blindtest.physical import make as mechanical
from tools.blindtest.physical.mechanism import PACKAGE, TOPOLOGIES


@dataclass(frozen=True)
class Generator:
    name: str
    known: tuple[str, ...]  # effects of the library that it makes
    unknown: tuple[str, ...]  # effects outside of it
    make: Callable[[int, str, tuple[str, ...]], Case]  # seed, kind, effects (none: drawn)
    needs: str | None = None  # a package beyond tautline's own
    apart: bool = False  # made only where it is asked for by its name

    @property
    def installed(self) -> bool:
        return self.needs is None or find_spec(self.needs) is not None


SECOND = "second"
GENERATORS: Mapping[str, Generator] = {
    generator.name: generator
    for generator in (
        Generator(SECOND, tuple(draws.KNOWN), tuple(draws.UNKNOWN), cases.make),
        Generator(own.NAME, own.KNOWN, (), own.make),
        Generator(setup.NAME, setup.KNOWN, (), setup.make, apart=True),
        *(
            Generator(t.name, mechanical.known(t), tuple(physical.UNKNOWN), partial(mechanical.make, t), PACKAGE)
            for t in TOPOLOGIES
        ),
    )
}
MUJOCO, ALL = "mujoco", "all"  # names of several
CHOICES = (*GENERATORS, MUJOCO, ALL)


def chosen(wanted: Sequence[str], left_out: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Generators to take, and those that would be but whose package is missing. `wanted` and `left_out` are of CHOICES;
    nothing wanted: the second instrument, or all where something is left out. Raises TautError where none remains."""
    names = _several(wanted) if wanted else _several([ALL]) if left_out else [SECOND]
    names = [name for name in names if name not in _several(left_out)]
    there = tuple(name for name in names if GENERATORS[name].installed)
    missing = tuple(name for name in names if not GENERATORS[name].installed)
    if not there:
        raise TautError(
            f"no generator is left to make cases: {', '.join(missing)} need the package '{PACKAGE}': run ./run setup"
            if missing
            else "no generator is left to make cases: leave fewer out"
        )
    return there, missing


def _several(names: Sequence[str]) -> list[str]:
    makers = [
        generator
        for generator in GENERATORS
        if generator in names
        or (ALL in names and not GENERATORS[generator].apart)
        or (MUJOCO in names and generator.startswith(f"{MUJOCO}."))
    ]
    return makers
