"""A copy of the C sources in which mutants are built, one after the other, and the C tests run."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tools.mutation import hosted
from tools.mutation.coverage import Reached, asked
from tools.mutation.sites import ROOMS, Mutant

BUILT = ("CMakeLists.txt", "common", "firmware", "tests/c", "tools/bench", "tools/examples")
# Warnings stay warnings: a mutant that only warns would be killed by no test. No debugging symbols: the same
# instructions are the same bytes.
FLAGS = "-O2 -w"
SANITIZED = ("-DTAUTLINE_SANITIZE=ON", "-DCMAKE_C_FLAGS=-O1 -w", "-DCMAKE_BUILD_TYPE=", "-DCMAKE_C_COMPILER=clang")
# The rooms are shared libraries: a mutant compiles one file and links one of them, and no test.
SHARED = ("BUILD_SHARED_LIBS", "CMAKE_LINK_DEPENDS_NO_SHARED", "CMAKE_ENABLE_EXPORTS")
LONGEST = 20.0  # times what a test needs, and
LEAST_S = 5.0  # so long in any case: a mutant that loops is killed by time
BUILD_S = 300.0
LIBRARIES = ("tautline_common", "tautline_estimator", "tautline_app")


@dataclass(frozen=True)
class Outcome:
    """`how`: killed, time, survived; not counted: `build`, the compiler refused it, and `same`, the same code."""

    how: str
    test: str  # that killed it, or ""
    passes: tuple[str, ...] = ()  # the tests that do not tell a survivor from the program


def digest(root: Path, test: str) -> str:
    """Of what a test's outcome depends on: the sources, the test and the headers of tests; of the sources for ""."""
    total = hashlib.sha256(" ".join((FLAGS, *SANITIZED)).encode())
    files = (root / "tests/c").iterdir() if test else ()
    read = sorted(path for path in files if path.suffix == ".h" or path.name.startswith(f"{test}."))
    if test in hosted.OF:  # and with the helpers of its folder
        read = sorted(
            path
            for path in (root / hosted.FOLDER).glob("*.py")
            if path.name == test or not path.name.startswith("test_")
        )
    for path in [*(path for room in ROOMS for path in sorted((root / room).rglob("*.[ch]"))), *read]:
        total.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return total.hexdigest()[:16]


def programs(root: Path) -> list[str]:
    return sorted({path.name.split(".")[0] for path in (root / "tests/c").glob("test_*.c*")})


class Trial:
    """`folder` keeps its copy and build from one run to the next. Errors: the tests fail as they are."""

    def __init__(self, root: Path, folder: Path, covers: dict[str, Reached]) -> None:
        self.root, self.source, self.build, self.covers = root, folder / "source", folder / "build", covers
        self.sanitized = folder / "sanitized"
        self._copy()
        self.names = programs(root)
        flags = [f"-DCMAKE_C_FLAGS={FLAGS}", "-DCMAKE_BUILD_TYPE=", "-DCMAKE_C_COMPILER=gcc"]
        flags += [f"-D{name}=ON" for name in SHARED]
        self._run(["cmake", "-S", str(self.source), "-B", str(self.build), "-G", "Ninja", *flags])
        self._run(["cmake", "-S", str(self.source), "-B", str(self.sanitized), "-G", "Ninja", *SANITIZED])
        self._run(self._ninja())
        self.objects = self._compiled()
        self.took = {name: self._timed(name) for name in self.names} | dict.fromkeys(hosted.OF, hosted.TOOK_S)
        self.sound: set[str] = set()  # the host's tests that pass here as the sources are, and the sanitized ones
        self.changed: str | None = None

    def _copy(self) -> None:
        """What differs, so that only this is built again."""
        asked = ["git", "ls-files", "--cached", "--others", "--exclude-standard", *BUILT]
        listed = subprocess.run(asked, cwd=self.root, check=True, capture_output=True, text=True).stdout.splitlines()
        if self.source.exists():
            for path in [path for path in self.source.rglob("*") if path.is_file()]:
                if path.relative_to(self.source).as_posix() not in listed:
                    path.unlink()
        for name in listed:
            origin, copy = self.root / name, self.source / name
            if origin.is_file() and not (copy.is_file() and copy.read_bytes() == origin.read_bytes()):
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(origin, copy)

    def _ninja(self, targets: Sequence[str] = (), build: Path | None = None) -> list[str]:
        return ["ninja", "-C", str(build or self.build), "-j1", *(targets or self.names)]

    def _builds(self, targets: Sequence[str], build: Path | None = None) -> bool:
        done = subprocess.run(self._ninja(targets, build), capture_output=True, timeout=BUILD_S, check=False)
        return done.returncode == 0

    def _run(self, command: list[str]) -> None:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise SystemExit(f"mutation: {' '.join(command)}:\n{done.stdout}{done.stderr}")

    def _is_same(self) -> bool:
        """Whether the rooms are what they were: of a header's mutant most tests need not be compiled to kill it."""
        now = self._compiled()
        tests = self.build / "tests"
        return all(now[path] == was for path, was in self.objects.items() if tests not in path.parents)

    def _compiled(self) -> dict[Path, bytes]:
        """Of every object file, so that what no test links is not taken for the same."""
        return {path: hashlib.sha256(path.read_bytes()).digest() for path in self.build.rglob("*.o")}

    def _passes(self, name: str, limit_s: float | None, build: Path | None = None) -> bool:
        command, environment = [str((build or self.build) / "tests" / "c" / name)], None
        if name in hosted.OF:
            command, environment = hosted.command(self.root, name), hosted.environment(self.build)
        quiet = subprocess.DEVNULL
        done = subprocess.run(command, stdout=quiet, stderr=quiet, timeout=limit_s, check=False, env=environment)
        return done.returncode == 0

    def _limit_s(self, name: str) -> float:
        return hosted.LONGEST_S if name in hosted.OF else LEAST_S + LONGEST * self.took[name]

    def _see_that_it_is_sound(self, name: str) -> None:
        """That one of the host's tests fails may be the mutant's doing only if it passes without."""
        if name in hosted.OF and name not in self.sound:
            self._restore()
            self._run(self._ninja())
            if not self._passes(name, None):
                raise SystemExit(f"mutation: {name} fails as the sources are: see './run test host'")
            self.sound.add(name)

    def _breaks_rules(self, mutant: Mutant) -> str:
        """The first C test that does not pass with the sanitizers, as CI runs it: the mutant reads or writes beside an
        array, say. Empty: none."""
        for name in [each for each in asked(mutant, self.covers, self.took) if each not in hosted.OF]:
            if not self._builds([name], self.sanitized):
                continue
            try:
                passes = self._passes(name, self._limit_s(name), self.sanitized)
            except subprocess.TimeoutExpired:
                continue
            if not passes:
                if name not in self.sound:
                    self._restore()
                    self._run(self._ninja([name], self.sanitized))
                    if not self._passes(name, None, self.sanitized):
                        raise SystemExit(f"mutation: {name} fails with the sanitizers: see './run test c'")
                    self.sound.add(name)
                return name
        return ""

    def _timed(self, name: str) -> float:
        began = time.monotonic()
        if not self._passes(name, None):
            raise SystemExit(f"mutation: {name} fails as the sources are: see './run test c'")
        return time.monotonic() - began

    def _restore(self) -> None:
        if self.changed is not None:
            shutil.copyfile(self.root / self.changed, self.source / self.changed)

    def _write(self, mutant: Mutant) -> None:
        self._restore()
        (self.source / mutant.file).write_bytes(mutant.applied((self.root / mutant.file).read_bytes()))
        self.changed = mutant.file

    def of(self, mutant: Mutant, passes: frozenset[str] = frozenset()) -> Outcome:
        """What the tests say of it; of those in `passes` it is known that they do not see it."""
        self._write(mutant)
        if not self._builds(LIBRARIES):
            return Outcome("build", "")
        if self._is_same() and self._builds(()) and self._compiled() == self.objects:
            return Outcome("same", "")
        for name in asked(mutant, self.covers, self.took):
            if name not in hosted.OF and name not in passes and not self._builds([name]):
                return Outcome("build", "")
            try:
                if name not in passes and not self._passes(name, self._limit_s(name)):
                    self._see_that_it_is_sound(name)
                    return Outcome("killed", name)
            except subprocess.TimeoutExpired:
                return Outcome("time", name)
        if breaks := self._breaks_rules(mutant):
            return Outcome("killed", breaks)
        return Outcome("survived", "", tuple(self.covers))
