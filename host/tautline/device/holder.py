"""Who holds a board: an open one leaves a note on this machine, and whoever finds it busy can say by whom."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path


def note(where: str) -> Path:
    """The path of the file that says which process holds this board."""
    folder = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    return folder / f"tautline-board-{hashlib.sha256(where.encode()).hexdigest()[:16]}.json"


def take(where: str) -> None:
    """Notes that this process holds the board; failing to write it only costs a name in a message."""
    with contextlib.suppress(OSError):
        note(where).write_text(json.dumps({"pid": os.getpid(), "program": _program()}), encoding="utf-8")


def leave(where: str) -> None:
    """Removes this process' own note."""
    if _read(where).get("pid") == os.getpid():
        with contextlib.suppress(OSError):
            note(where).unlink()


def busy(where: str) -> str:
    """One line: which process uses the board, if known, and what to do."""
    held = _read(where)
    pid, program = held.get("pid"), held.get("program")
    if isinstance(pid, int) and isinstance(program, str) and pid != os.getpid() and _lives(pid):
        return (
            f"{where}: '{program}' (process {pid}) uses the board, and one program at a time can: watch it there, "
            "wait until it ends, or stop it with Ctrl-C"
        )
    return f"{where}: another program uses the board, and one at a time can: end that one first"


def _program() -> str:
    """This program as its user called it: 'taut COMMAND', else the script's name."""
    name = Path(sys.argv[0]).name or "python"
    return f"taut {sys.argv[1]}" if name == "taut" and len(sys.argv) > 1 else name


def _read(where: str) -> dict[str, object]:
    """What the note says; {} where there is none, or it is damaged."""
    try:
        document = json.loads(note(where).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


def _lives(pid: int) -> bool:
    """Whether a process of this number exists."""
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return True
