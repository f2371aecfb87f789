"""Which process holds a board: an open board has a note on this machine, so that whoever finds it in use can say by
whom."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path


def note(where: str) -> Path:
    """Returns the path of the note on the board at the address `where`, a JSON file {"pid": ..., "program": ...} on the
    process that holds it."""
    folder = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir())
    return folder / f"tautline-board-{hashlib.sha256(where.encode()).hexdigest()[:16]}.json"


def take(where: str) -> None:
    """Writes the note that this process holds the board. Errors are ignored: without the note only a message lacks a
    name."""
    with contextlib.suppress(OSError):
        note(where).write_text(json.dumps({"pid": os.getpid(), "program": _program_name()}), encoding="utf-8")


def leave(where: str) -> None:
    """Removes the note on a board if it is this process' own."""
    if _read_note(where).get("pid") == os.getpid():
        with contextlib.suppress(OSError):
            note(where).unlink()


def busy_in_words(where: str) -> str:
    """Returns the error's text for a board that is in use: by which process, if its note says so, and what to do."""
    held = _read_note(where)
    pid, program = held.get("pid"), held.get("program")
    if isinstance(pid, int) and isinstance(program, str) and pid != os.getpid() and _process_exists(pid):
        return (
            f"{where}: '{program}' (process {pid}) uses the board, and one program at a time can: watch it there, "
            "wait until it ends, or stop it with Ctrl-C"
        )
    return f"{where}: another program uses the board, and one at a time can: end that one first"


def _program_name() -> str:
    """Returns this program's name as its user called it: 'taut COMMAND', or the script's name."""
    name = Path(sys.argv[0]).name or "python"
    return f"taut {sys.argv[1]}" if name == "taut" and len(sys.argv) > 1 else name


def _read_note(where: str) -> dict[str, object]:
    """Reads the note on a board; {} where there is none, or it is damaged."""
    try:
        document = json.loads(note(where).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


def _process_exists(pid: int) -> bool:
    """Whether a process of this number exists."""
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return True
