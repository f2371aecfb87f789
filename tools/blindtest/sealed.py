"""A campaign's folder: what a diagnosis may see, what it must not, and the hashes that hold both to what they were.

OUT/campaign.json      the plan; of every case a commitment, SHA-256 over salt, label and further motion
OUT/cases/NAME/        rig.toml, calibration/, test-1/, test-2/: all that a diagnosis sees
OUT/sealed/NAME/       label.json with its salt, further/: opened when every diagnosis is written
OUT/diagnoses/NAME/    what was said, files.json with the SHA-256 of each file
OUT/diagnoses.json     the SHA-256 of every files.json, written before the first label is opened
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tautline.errors import TautError
from tautline.folders import write_file

Files = Mapping[str, bytes]  # relative path -> content

CASES, SEALED, DIAGNOSES = "cases", "sealed", "diagnoses"
PLAN, CLOSED, LIST = "campaign.json", "diagnoses.json", "files.json"
LABEL = "label.json"
FURTHER = "further"


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def canonical(value: Any) -> bytes:
    """One text for one value."""
    return (json.dumps(value, sort_keys=True, indent=1, allow_nan=False) + "\n").encode()


def commitment(sealed: Files) -> str:
    """To a label and the further motion; the salt inside the label keeps it from being guessed."""
    return digest(canonical({name: digest(content) for name, content in sealed.items()}))


def read(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def write(folder: Path, files: Files) -> None:
    """The whole folder, or nothing; what was there is replaced."""
    temporary = folder.with_name(f".{folder.name}.new")
    shutil.rmtree(temporary, ignore_errors=True)
    for name, content in files.items():
        path = temporary / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)


class Campaign:
    """The folder of one campaign."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def plan(self) -> dict[str, Any] | None:
        """None before every case is made."""
        path = self.root / PLAN
        return json.loads(path.read_text()) if path.exists() else None

    def commit(self, plan: Mapping[str, Any]) -> None:
        write_file(self.root / PLAN, canonical(plan).decode())

    def made(self, name: str) -> bool:
        return (self.root / CASES / name).is_dir() and (self.root / SEALED / name).is_dir()

    def write_case(self, name: str, visible: Files, sealed: Files) -> None:
        write(self.root / SEALED / name, sealed)
        write(self.root / CASES / name, visible)

    def case(self, name: str) -> dict[str, bytes]:
        return read(self.root / CASES / name)

    def sealed_commitment(self, name: str) -> str:
        return commitment(read(self.root / SEALED / name))

    def write_diagnosis(self, name: str, files: Files) -> None:
        listed = canonical({path: digest(content) for path, content in files.items()})
        write(self.root / DIAGNOSES / name, {**files, LIST: listed})

    def diagnosed(self, name: str) -> bool:
        return (self.root / DIAGNOSES / name / LIST).exists()

    def close(self, names: list[str]) -> None:
        """No diagnosis may change from here on: the labels may be opened."""
        path = self.root / CLOSED
        if not path.exists():
            lists = {name: digest((self.root / DIAGNOSES / name / LIST).read_bytes()) for name in names}
            write_file(path, canonical(lists).decode())

    def closed(self) -> list[str] | None:
        """The cases whose diagnoses were closed, in the plan's order; None before."""
        path = self.root / CLOSED
        return list(json.loads(path.read_text())) if path.exists() else None

    def diagnosis(self, name: str) -> dict[str, bytes]:
        """What was said of a case, as it was when the diagnoses were closed. Raises TautError where it was changed."""
        closed = self.root / CLOSED
        if not closed.exists():
            raise TautError(f"{closed}: is not there: the diagnoses are not closed yet")
        files = read(self.root / DIAGNOSES / name)
        listed = files.pop(LIST, b"")
        digests = canonical({path: digest(content) for path, content in files.items()})
        if digest(listed) != json.loads(closed.read_text()).get(name) or digests != listed:
            raise TautError(f"{self.root / DIAGNOSES / name}: was changed after it was written: nothing can be scored")
        return files

    def open(self, name: str, committed: str) -> dict[str, bytes]:
        """Label and further motion. Raises TautError before the diagnoses are closed, or where they do not fit their
        commitment."""
        if not (self.root / CLOSED).exists():
            raise TautError(f"{self.root / SEALED / name}: stays sealed until every diagnosis is written")
        files = read(self.root / SEALED / name)
        if commitment(files) != committed:
            raise TautError(f"{self.root / SEALED / name}: was changed after it was sealed: nothing can be scored")
        return files
