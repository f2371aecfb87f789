"""A diagnosis as a folder: diagnosis.json, report.html, the next motion, and both models."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tautline.diagnosis import motion, page
from tautline.diagnosis.diagnose import Diagnosis
from tautline.folders import replaced_folder, write_file
from tautline.plain import plain
from tautline.reports import pages
from tautline.trajectory import NEXT_FILE

DOCUMENT = "diagnosis.json"


def save(diagnosis: Diagnosis, out: Path) -> None:
    """Writes the diagnosis' files into the folder `out`: all of them or, on failure, none. TautError where it cannot be
    written."""
    with replaced_folder(out, DOCUMENT) as folder:
        for name, model in (("nominal", diagnosis.nominal), ("corrected", diagnosis.corrected)):
            model.save(folder / name)
            pages.write(model, folder / name, None, name)
        if diagnosis.next_motion is not None:
            table = motion.table(diagnosis.next_motion.motion, diagnosis.nominal.rig.actuator.unit)
            table.to_csv(folder / NEXT_FILE, index=False, float_format="%.6f")
        document: dict[str, Any] = plain(diagnosis.document)
        write_file(folder / DOCUMENT, json.dumps(document, indent=1, allow_nan=False) + "\n")
        page.write(diagnosis, folder, str(out))
