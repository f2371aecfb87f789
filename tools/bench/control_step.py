"""One control step (inverse with take-up, forward play, c) in fixed point, as on the board, against float32."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

from tautline.errors import TautError

PROGRAM = Path(__file__).parents[2] / "build/gcc/tools/bench/control_step"


def run() -> list[tuple[str, float, str]]:
    """(name, value, unit) rows: the best of 15 runs of 65536 steps."""
    if not PROGRAM.exists():
        raise TautError("tools/bench/control_step is not built: run './run bench', or 'cmake --build --preset gcc'")
    timing = json.loads(subprocess.run([PROGRAM], check=True, capture_output=True, text=True).stdout)
    return [
        ("control step, fixed point", timing["fixed_ns"], "ns"),
        ("control step, float32", timing["float_ns"], "ns"),
        ("largest difference between the two", timing["apart_deg"], "deg"),
    ]


if __name__ == "__main__":
    for name, value, unit in run():
        print(f"{name:40} {value:10.4g} {unit}")
