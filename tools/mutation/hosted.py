"""The host's tests of the fixed-point code as judges of mutants: the native module calls the rooms' functions in shared
libraries that are loaded before its own.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tools.mutation.coverage import Reached

FOLDER = "tests/host"
# What each is held against float64 or the model for: a mutant elsewhere is not shown to it.
OF = {
    "test_fixed_history.py": ("tl_history",),
    "test_fixed_motion.py": ("tl_motion",),
    "test_fixed_tables.py": (
        "tl_table",
        "tl_sections",
        "tl_lookup",
        "tl_lookup_load",
        "tl_play",
        "tl_ratio",
        "tl_fixed",
    ),
    "test_fixed_compensator.py": ("tl_compensator", "tl_takeup", "tl_feed", "tl_lookup", "tl_play"),
    "test_fixed_elements.py": ("tl_several", "tl_elements", "tl_lookup", "tl_lookup_load", "tl_play", "tl_sections"),
    "test_undone.py": ("tl_undo", "tl_undoing", "tl_compensator"),
    "test_fixed_onset.py": ("tl_onset", "tl_hinge", "tl_confirm", "tl_real", "tl_history"),
}
TOOK_S = 60.0  # about, the longest on a busy core
LONGEST_S = 400.0


def covers(rooms: dict[str, str]) -> dict[str, Reached]:
    """Of each test: `rooms` has the file of each stem."""
    whole = [(1, sys.maxsize)]
    return {test: Reached({}, {rooms[stem]: whole for stem in stems if stem in rooms}) for test, stems in OF.items()}


def command(root: Path, test: str) -> list[str]:
    plain = ["-p", "tools.mutation.unshrunk", "--hypothesis-profile", "unshrunk", "-p", "no:cacheprovider"]
    return [sys.executable, "-m", "pytest", "-x", "-q", *plain, str(root / FOLDER / test)]


def environment(build: Path) -> dict[str, str]:
    libraries = (build / "common/libtautline_common.so", build / "firmware/estimator/libtautline_estimator.so")
    return os.environ | {"LD_PRELOAD": ":".join(map(str, libraries)), "OPENBLAS_NUM_THREADS": "1"}
