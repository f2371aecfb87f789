"""Runs the installed command's entry point in this process."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest

from tautline.cli import main


@dataclass(frozen=True)
class Finished:
    code: int
    out: str
    err: str


class Taut:
    """Calls `taut` with arguments. An error that nobody foresaw is raised instead of being printed in one line."""

    def __init__(self, patch: pytest.MonkeyPatch, capture: pytest.CaptureFixture[str]) -> None:
        self.patch, self.capture = patch, capture
        patch.setenv("TAUT_TRACEBACK", "1")

    def __call__(self, *words: str | Path | float) -> Finished:
        self.patch.setattr("sys.argv", ["taut", *map(str, words)])
        self.capture.readouterr()
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        seen = self.capture.readouterr()
        return Finished(code, seen.out, seen.err)

    def refuses(self, *words: str | Path | float) -> str:
        """The one line of an error."""
        done = self(*words)
        told = json.loads(done.out)["error"] if "--json" in words else ""
        assert done.code == 1 and (told or done.out == ""), done
        lines = [line for line in done.err.splitlines() if not line.startswith("taut: warning: ")]
        assert len(lines) == 1 and lines[0].startswith("taut: "), done.err
        assert not told or lines[0] == f"taut: {told}"
        return lines[0]
