"""python -m tools.constants.worker < ORDER: calibrates with other numbers, a line of JSON a session.

A process of its own for each draw, since a module's numbers are read when it is imported. ORDER: {"factors": {key:
factor}, "learnt": factor of all that is learnt, "sessions": [...], "out": a folder}.
"""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from tools.constants.vary import install
from tools.honesty.runner import taut, warm


def main() -> None:
    order = json.load(sys.stdin)
    install(order["factors"])
    _learnt(order["learnt"])
    warm()
    for session in order["sessions"]:
        out = Path(order["out"]) / session["name"]
        status, said, err = taut("calibrate", *session["recordings"], "--rig", session["rig"], "--out", out, "--json")
        row: dict[str, Any] = {
            "session": session["name"],
            "verdict": f"exit {status}",
            "reasons": [],
            "said": err[-300:],
        }
        if status in (0, 3):
            quality = json.loads(said)["quality"]
            row |= {"verdict": quality["verdict"], "reasons": [r["code"] for r in quality["reasons"]], "said": ""}
        else:
            row |= {"verdict": f"exit {status}", "said": err[-300:]}
        print(json.dumps(row), flush=True)


def _learnt(factor: float) -> None:
    from tautline.diagnosis import hyperparameters

    def times(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: times(each) for key, each in value.items()}
        if isinstance(value, list):
            return [times(each) for each in value]
        return value * factor if isinstance(value, float) else value

    hyperparameters.tomllib = SimpleNamespace(loads=lambda text: times(tomllib.loads(text)))  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
