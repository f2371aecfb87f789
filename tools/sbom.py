"""python -m tools.sbom ENVIRONMENT.json VERSION OUT.json: the SBOM of a release.

ENVIRONMENT.json is what cyclonedx-py says of an environment that holds the wheel alone. The C that wheel and image are
built with is added, the package itself becomes what the document describes, and the result is checked by its schema.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

DISTRIBUTION = "tautline-robotics"
DEPS = Path(os.environ.get("TAUTLINE_DEPS", ".deps"))


def main(environment: Path, version: str, out: Path) -> None:
    from cyclonedx.schema import SchemaVersion  # of the extra `release`
    from cyclonedx.validation.json import JsonStrictValidator

    document = json.loads(environment.read_text())
    ours = next(each for each in document["components"] if each["name"] == DISTRIBUTION)
    document["components"].remove(ours)
    for personal in ("externalReferences", "properties"):  # where it was installed from
        ours.pop(personal, None)
    document["metadata"]["component"] = ours | {"type": "application", "version": version}
    document["components"] += c_components()
    text = json.dumps(document, indent=1)
    wrong = JsonStrictValidator(SchemaVersion.from_version(document["specVersion"])).validate_str(text)
    if wrong is not None:
        sys.exit(f"{out}: the SBOM does not follow its schema: {wrong}")
    out.write_text(text + "\n")


def c_components() -> list[dict[str, Any]]:
    """TinyUSB and Monocypher, in the wheel's desktop board and in the image; the Pico SDK, in the image."""
    tinyusb = Path(os.environ.get("TAUTLINE_TINYUSB_DIR", DEPS / "root/usr/src/tinyusb")) / "src/tusb_option.h"
    monocypher = Path(os.environ.get("TAUTLINE_MONOCYPHER_DIR", DEPS / "monocypher")) / "monocypher.c"
    return [
        _component("tinyusb", "MIT", tinyusb, r"TUSB_VERSION_(?:MAJOR|MINOR|REVISION)\s+(\d+)"),
        _component("monocypher", "BSD-2-Clause OR CC0-1.0", monocypher, r"(?:Monocypher version |(?<=\d)\.)(\d+)"),
        _component("pico-sdk", "BSD-3-Clause", sdk_version(), r"PICO_SDK_VERSION_(?:MAJOR|MINOR|REVISION) (\d+)"),
    ]


def sdk_version() -> Path:
    """Where the Pico SDK says its version, once `./run setup firmware` was there."""
    local = DEPS / "root/usr/src/pico-sdk"
    sdk = Path(os.environ.get("PICO_SDK_PATH", local if local.is_dir() else "/usr/src/pico-sdk"))
    return sdk / "pico_sdk_version.cmake"


def _component(name: str, licence: str, file: Path, pattern: str) -> dict[str, Any]:
    version = ".".join(re.findall(pattern, file.read_text())[:3])
    if version.count(".") != 2:
        sys.exit(f"{file}: holds no version of {name}")
    return {"type": "library", "name": name, "version": version, "licenses": [{"license": {"id": licence}}]}


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]))
