"""Takes out one guard of tools/guards.py after the other and sees its test fail: what no test misses was never guarded.

    python tools/mutants.py --unity DIR [--cc gcc] [--only WORDS] [--all]

Without --all those of the portable C, a part of ctest. With it those of the real board's image and of the host, too, in
a copy of the sources (a few minutes): run it by './run test guards', in the Python environment.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from tools.guards import GUARDS, RP2040, Guard  # noqa: E402

SOURCES = (ROOT / "firmware" / "app" / "src", ROOT / "firmware" / "estimator" / "src", ROOT / "common" / "src")
INCLUDES = tuple(folder.parent / "include" for folder in SOURCES)
TESTS = ROOT / "tests" / "c"
FLAGS = ["-std=c11", "-O1", "-DTL_APP_QUEUE=65536U", "-DUNITY_SUPPORT_64", "-DUNITY_INCLUDE_DOUBLE"]
LONGEST_S = 600
ONLY = "TAUTLINE_ONLY_TEST"  # environment: of a test's program that one alone
ONE_TEST = f"""
#include <stdlib.h>
#include <string.h>
#include "unity.h"
#undef RUN_TEST
#define RUN_TEST(test) \\
    do {{ \\
        if (strcmp(#test, getenv("{ONLY}")) == 0) UnityDefaultTestRun(test, #test, __LINE__); \\
    }} while (0)
"""
# Modules of the copy win over the installed ones.
FINDER = """
import importlib.abc, importlib.util, pathlib, sys
class Copy(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] != "tautline":
            return None
        at = pathlib.Path({host!r}, *name.split("."))
        inside = at / "__init__.py"
        if inside.is_file():
            return importlib.util.spec_from_file_location(name, inside, submodule_search_locations=[str(at)])
        at = at.with_suffix(".py")
        return importlib.util.spec_from_file_location(name, at) if at.is_file() else None
sys.meta_path.insert(0, Copy())
"""


def without(guard: Guard, root: Path = ROOT) -> dict[str, str]:
    """The text of each file that changes, as it is without the guard."""
    texts: dict[str, str] = {}
    for file, before, after in guard.changes:
        text = texts.get(file, (root / file).read_text("utf-8"))
        if text.count(before) != 1:
            raise SystemExit(f"mutants: '{before}' is {text.count(before)} times in {file}: mend tools/guards.py")
        texts[file] = text.replace(before, after)
    return texts


class Portable:
    """The C tests with all that they need, compiled once; a mutant compiles what it changes, and what includes that."""

    def __init__(
        self, folder: Path, cc: str, unity: Path, monocypher: Path, tests: set[Path], workers: ThreadPoolExecutor
    ) -> None:
        self.folder, self.cc, self.unity, self.monocypher = folder, cc, unity, monocypher
        self.sources = [file for place in SOURCES for file in sorted(place.glob("*.c")) if file.name != "tl_usb.c"]
        self.sources += [unity / "unity.c", monocypher / "monocypher.c"]
        (folder / "one_test.h").write_text(ONE_TEST, "utf-8")
        every = [*self.sources, *sorted(tests)]
        self.objects = dict(zip(every, workers.map(lambda source: self._compile(source, folder), every), strict=True))

    def _includes(self, before: list[Path]) -> list[str]:
        return [f"-I{path}" for path in (*before, *INCLUDES, *SOURCES, TESTS, self.unity, self.monocypher)]

    def _compile(self, source: Path, into: Path, first: tuple[Path, ...] = ()) -> Path:
        """The object; beside it the list of what was included."""
        made = into / f"{source.stem}.o"
        command = [self.cc, *FLAGS, *self._includes([*first]), "-MMD", "-c", str(source), "-o", str(made)]
        command += ["-include", str(self.folder / "one_test.h")] if source.parent == TESTS else []
        subprocess.run(command, check=True)
        return made

    def _includes_one(self, source: Path, headers: list[str]) -> bool:
        """Whether one of these headers went into the object."""
        included = {Path(word).resolve() for word in self.objects[source].with_suffix(".d").read_text("utf-8").split()}
        return any(ROOT / header in included for header in headers)

    def misses(self, test: str, texts: dict[str, str]) -> bool:
        """Whether the test fails with these texts in place of their files."""
        file, _, name = test.partition("::")
        source = ROOT / file
        with tempfile.TemporaryDirectory(dir=self.folder) as made:
            folder = Path(made)
            changed: dict[Path, Path] = {}
            headers = [key for key in texts if key.endswith(".h")]
            for key, text in texts.items():
                target = folder / ("tautline/" if key in headers else "") / Path(key).name
                target.parent.mkdir(exist_ok=True)
                target.write_text(text, "utf-8")
                if key not in headers:
                    changed[ROOT / key] = target
            if name == "":  # must not compile
                command = [
                    self.cc,
                    "-std=c11",
                    "-fsyntax-only",
                    "-DDUPLICATE=1",
                    *self._includes([folder]),
                    str(source),
                ]
                return subprocess.run(command, capture_output=True, check=False).returncode == 0
            objects = {key: self.objects[key] for key in (*self.sources, source)}
            for key in objects:
                if key in changed or self._includes_one(key, headers):
                    objects[key] = self._compile(changed.get(key, key), folder, (folder,))
            program = folder / "mutant"
            subprocess.run([self.cc, *map(str, objects.values()), "-lm", "-o", str(program)], check=True)
            done = subprocess.run(
                [str(program)],
                capture_output=True,
                text=True,
                timeout=LONGEST_S,
                check=False,
                env=os.environ | {ONLY: name},
            )
            return done.returncode < 0 or f":{name}:FAIL" in done.stdout


class Copy:
    """A copy of the sources, in which the image and the desktop board are built and the other tests run."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "copy"
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
        for name in listed.splitlines():
            if (ROOT / name).is_file():
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self.root / name)
        (self.root / "tools/emulator/node_modules").symlink_to(ROOT / "tools/emulator/node_modules")
        finder = folder / "finder"
        finder.mkdir()
        (finder / "sitecustomize.py").write_text(FINDER.format(host=str(self.root / "host")), "utf-8")
        shutil.copytree(ROOT / "build/keys", self.root / "build/keys", dirs_exist_ok=True)  # to sign updates with
        self.environment = os.environ | {"PYTHONPATH": str(finder), "PYTHONDONTWRITEBYTECODE": "1"}

    def _run(self, *command: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            command, cwd=self.root, env=self.environment, capture_output=True, text=True, timeout=LONGEST_S, check=False
        )
        if check and done.returncode != 0:
            raise SystemExit(f"mutants: {' '.join(command)}:\n{done.stdout}{done.stderr}")
        return done

    def _build(self, test: str, board: str) -> None:
        if test.startswith(("tools/", "tests/firmware")) or board == "emulated":
            self._run("cmake", "-S", RP2040, "-B", "build/rp2040", "-G", "Ninja")
            self._run("cmake", "--build", "build/rp2040", "--target", "flash", "bootrom", "layout")
        elif test.startswith("tests/board"):
            self._run("cmake", "--preset", "gcc")
            self._run("cmake", "--build", "--preset", "gcc", "--target", "tautline-board")

    def fails(self, test: str, board: str) -> bool:
        file, _, name = test.partition("::")
        self._build(test, board)
        if file.endswith(".js"):
            done = self._run("node", "--test", f"--test-name-pattern=^{name}", file, check=False)
            if "# tests 0" in done.stdout:
                raise SystemExit(f"mutants: no test begins '{name}' in {file}")
            return done.returncode != 0
        options = ["--board", board] if file.startswith("tests/board") else []
        done = self._run(
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-q",
            "-m",
            "not long",
            "-p",
            "no:cacheprovider",
            *options,
            test,
            check=False,
        )
        if done.returncode not in (0, 1):
            raise SystemExit(f"mutants: {test} did not run:\n{done.stdout}{done.stderr}")
        return done.returncode == 1

    def misses(self, guard: Guard) -> bool:
        """Whether its test fails without the guard."""
        texts = without(guard, self.root)
        before = {name: (self.root / name).read_text("utf-8") for name in texts}
        try:
            for name, text in texts.items():
                (self.root / name).write_text(text, "utf-8")
            return self.fails(guard.test, guard.board)
        finally:
            for name, text in before.items():
                (self.root / name).write_text(text, "utf-8")


def is_portable(guard: Guard) -> bool:
    return guard.test.startswith("tests/c/")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--unity", type=Path, required=True, help="folder of unity.c")
    fetched = Path(os.environ.get("TAUTLINE_DEPS", ROOT / ".deps")) / "monocypher"
    usual = Path(os.environ.get("TAUTLINE_MONOCYPHER_DIR", fetched))
    parser.add_argument("--monocypher", type=Path, default=usual, help="folder of monocypher.c")
    parser.add_argument("--cc", default="cc")
    parser.add_argument("--only", default="", help="guards whose name contains this")
    parser.add_argument("--all", action="store_true", help="those of the image and of the host, too")
    options = parser.parse_args()
    chosen = [each for each in GUARDS if options.only in each.name and (options.all or is_portable(each))]
    wrong = 0
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(os.cpu_count()) as workers:
        here, others = ([each for each in chosen if is_portable(each) == is_here] for is_here in (True, False))
        whole = list(dict.fromkeys(each.test for each in here))
        tests = {ROOT / file for file, _, name in (test.partition("::") for test in whole) if name}
        portable = Portable(Path(name), options.cc, options.unity, options.monocypher, tests, workers)
        broken = workers.map(lambda test: portable.misses(test, {}), whole)
        failed = [test for test, misses in zip(whole, broken, strict=True) if misses]
        copy = Copy(Path(name)) if others else None
        if copy:
            boards = dict.fromkeys((each.test, each.board) for each in others)
            failed += [test for test, board in boards if copy.fails(test, board)]
        for test in failed:
            wrong += 1
            print(f"{test} fails with every guard in place", flush=True)
        seen = zip(here, workers.map(lambda guard: portable.misses(guard.test, without(guard)), here), strict=True)
        for guard, missed in chain(seen, ((guard, copy.misses(guard)) for guard in others if copy)):
            wrong += not missed
            print(f"{'seen' if missed else 'NOT SEEN':8s} without: {guard.name}", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
