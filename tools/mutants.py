"""Takes out one guard after the other and sees tests/c/test_random.c fail: what no test misses was never guarded.

    python tools/mutants.py --unity DIR [--cc gcc]

A guard is named by the line that makes it; a line that is there no longer, or twice, is an error. Part of ctest.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = (ROOT / "firmware" / "app" / "src", ROOT / "firmware" / "estimator" / "src", ROOT / "common" / "src")
INCLUDES = tuple(folder.parent / "include" for folder in SOURCES)
TEST = ROOT / "tests" / "c" / "test_random.c"
FLAGS = ["-std=c11", "-O1", "-DTL_APP_QUEUE=65536U", "-DUNITY_SUPPORT_64", "-DUNITY_INCLUDE_DOUBLE"]
ASK, GUARD, REST, APP = (
    f"firmware/app/src/{name}.c" for name in ("tl_axis_ask", "tl_axis_guard", "tl_axis_rest", "tl_app")
)
HEADERS = "firmware/app/include/tautline/"


@dataclass(frozen=True)
class Mutant:
    """`changes`: (file, line as it is, line without the guard)."""

    guard: str
    changes: tuple[tuple[str, str, str], ...]


def _one(guard: str, file: str, before: str, after: str) -> Mutant:
    return Mutant(guard, ((file, before, after),))


MUTANTS = (
    _one("duty within its limit", HEADERS + "tl_servo.h", "if (sum > limit || sum < -limit) {", "if (sum > 65536) {"),
    _one("a fault switches off", REST, "    tl_axis_off(axis);\n    axis->guard.lapsed", "    axis->guard.lapsed"),
    _one("off is off", REST, "    tl_actuator_release(&axis->motor);\n", ""),
    _one("weak without a reference", ASK,
         "axis->referenced ? axis->limits.duty_q15 : low_duty(axis)", "axis->limits.duty_q15"),
    _one("weak homing", ASK, "request->duty_q15 > 0 ? request->duty_q15 : low_duty(axis)", "axis->limits.duty_q15"),
    Mutant("a weak check", ((GUARD, "#define CHECK_PUSH    2621", "#define CHECK_PUSH    32768"),
                            (GUARD, "most < axis->settings.low_duty_q15 ?", "true ?"))),
    _one("a reference to follow or calibrate", ASK, "reason == 0 && !axis->referenced ?", "false ?"),
    _one("a reference to move", ASK, "    if (!axis->referenced) {", "    if (false) {"),
    _one("a check before driving", ASK, "        if (axis->checked) {", "        if (true) {"),
    Mutant("a check that sees swapped wires",
           ((GUARD, "way < -CHECK_MOVED, TL_WIRE_FAULT_REVERSED", "false, TL_WIRE_FAULT_REVERSED"),
            (GUARD, "!trial->moved, TL_WIRE_FAULT_UNMOVED", "false, TL_WIRE_FAULT_UNMOVED"),
            (GUARD, "!trial->right_scale, TL_WIRE_FAULT_SCALE", "false, TL_WIRE_FAULT_SCALE"))),
    _one("an encoder that jumps", HEADERS + "tl_actuator.h", ">= 2U * TL_ACTUATOR_JUMP", ">= 0xFFFFFFFFU"),
    _one("a jump takes the reference", REST, "(BIT(ENCODER) | BIT(EDGES)", "(BIT(EDGES)"),
    _one("lost edges are asked for", APP, "        poll_encoders(app, now_us);\n", ""),
    _one("lost edges take the reference", REST, "(BIT(ENCODER) | BIT(EDGES)", "(BIT(ENCODER)"),
    _one("a pause is no jump", HEADERS + "tl_actuator.h", "(elapsed_us < 1000000U ? elapsed_us : 1000000U)", "0U"),
    _one("stall", GUARD, "fails(axis, stalls, TL_WIRE_FAULT_STALL", "fails(axis, false, TL_WIRE_FAULT_STALL"),
    _one("asking again does not hide a stall", ASK,
         "    axis->guard.still_ms = 0; //", "    axis->guard.still_ms = 0;\n    axis->guard.pushed_ms = 0; //"),
    _one("following error", GUARD, "!within(error, axis->limits.following_error_q8)", "false"),
    _one("oscillation", GUARD, "return guard->swing >= SWING_MOST;", "return false;"),
    _one("driver", GUARD, "guard->driver_ms >= DRIVER_MS", "false"),
    _one("supply", GUARD, "guard->supply_ms >= SUPPLY_MS", "false"),
    _one("current", GUARD, "most > 0 && guard->current_mean_q8 > most * 256", "false"),
    _one("a host that is silent", GUARD, "--axis->guard.patience == 0U", "false"),
    _one("limits within the settings", ASK, "!are_within(limits, &axis->settings)", "false"),
    _one("the range", REST, "    axis->plan.low = low;", "    low = -TL_AXIS_RANGE_MAX;\n    axis->plan.low = low;"),
    _one("the speed of a move", ASK, "axis->plan.move.speed = speed < most ? speed : most;",
         "axis->plan.move.speed = 4 * most + 0 * speed;"),
    _one("a path from where the motor is", ASK,
         "    tl_axis_settle(axis);\n    tl_actuator_reset(&axis->motor, axis->q);\n    tl_axis_admit(axis);\n"
         "    axis->guard.current_mean_q8", "    axis->guard.current_mean_q8"),
    _one("arrived is there", GUARD, "within(axis->q - target, axis->settings.arrive_q8)", "true"),
)  # fmt: skip


class Build:
    """The test with all that it needs, compiled once; a mutant compiles what it changes."""

    def __init__(self, folder: Path, cc: str, unity: Path) -> None:
        self.folder, self.cc, self.unity = folder, cc, unity
        self.sources = [file for place in SOURCES for file in sorted(place.glob("*.c")) if file.name != "tl_usb.c"]
        self.sources += [TEST, unity / "unity.c"]
        self.objects = {source: self._compile([source], folder, [])[0] for source in self.sources}

    def _compile(self, sources: list[Path], into: Path, before: list[Path]) -> list[Path]:
        includes = [
            f"-I{path}" for path in (*before, *INCLUDES, ROOT / "firmware/estimator/src", TEST.parent, self.unity)
        ]
        made = [into / f"{source.stem}.o" for source in sources]
        for source, out in zip(sources, made, strict=True):
            subprocess.run([self.cc, *FLAGS, *includes, "-c", str(source), "-o", str(out)], check=True)
        return made

    def fails(self, mutant: Mutant | None) -> bool:
        """Whether the test fails with this guard taken out."""
        objects = dict(self.objects)
        with tempfile.TemporaryDirectory(dir=self.folder) as name:
            folder = Path(name)
            texts: dict[str, str] = {}
            for file, before, after in mutant.changes if mutant else ():
                text = texts.get(file, (ROOT / file).read_text("utf-8"))
                if text.count(before) != 1:
                    raise SystemExit(
                        f"mutants: '{before}' is {text.count(before)} times in {file}: mend {Path(__file__).name}"
                    )
                texts[file] = text.replace(before, after)
            changed = []
            for file, text in texts.items():
                target = folder / ("tautline/" if file.endswith(".h") else "") / Path(file).name
                target.parent.mkdir(exist_ok=True)
                target.write_text(text, "utf-8")
                if not file.endswith(".h"):
                    changed.append((ROOT / file, target))
            if any(file.endswith(".h") for file in texts):
                again = [source for source in self.sources if source.parent == SOURCES[0] or source == TEST]
                objects |= dict(zip(again, self._compile(again, folder, [folder]), strict=True))
            for source, target in changed:
                objects[source] = self._compile([target], folder, [])[0]
            program = folder / "mutant"
            subprocess.run([self.cc, *map(str, objects.values()), "-lm", "-o", str(program)], check=True)
            return subprocess.run([str(program)], stdout=subprocess.DEVNULL, timeout=300, check=False).returncode != 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--unity", type=Path, required=True, help="folder of unity.c")
    parser.add_argument("--cc", default="cc")
    parser.add_argument("--only", default="", help="guards whose name contains this")
    options = parser.parse_args()
    survivors = 0
    with tempfile.TemporaryDirectory() as name:
        build = Build(Path(name), options.cc, options.unity)
        if build.fails(None):
            print("the test fails with every guard in place")
            return 1
        for mutant in MUTANTS:
            if options.only in mutant.guard:
                seen = build.fails(mutant)
                survivors += not seen
                print(f"{'seen' if seen else 'NOT SEEN':8s} without: {mutant.guard}", flush=True)
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
