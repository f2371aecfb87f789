"""What a release holds, made from a tag of a clone; and that what it is asked for is checked first."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import venv
from pathlib import Path

import pytest

import tautline

ROOT = Path(__file__).parents[2]
TAG = f"v{tautline.__version__}"


def release(clone: Path, *words: str) -> subprocess.CompletedProcess[str]:
    deps = os.environ.get("TAUTLINE_DEPS", str(ROOT / ".deps"))
    env = os.environ | {"TAUTLINE_DEPS": deps, "TAUTLINE_VENV": sys.prefix}
    command = [clone / "tools" / "release", *words]
    return subprocess.run(command, env=env, capture_output=True, text=True, check=False)


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """This repository's last commit, with the tag of its version."""
    folder = tmp_path / "clone"
    subprocess.run(["git", "clone", "--quiet", "--shared", "--no-tags", str(ROOT), str(folder)], check=True)
    subprocess.run(["git", "tag", TAG], cwd=folder, check=True)
    return folder


def test_the_version_is_one() -> None:
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited is not None and cited[1] == tautline.__version__


def test_a_release_needs_a_tag_of_its_version(clone: Path, tmp_path: Path) -> None:
    assert "what a release holds, made from a tag" in release(clone).stdout
    assert "no tag is called 'v9.9.9'" in release(clone, "v9.9.9").stderr
    subprocess.run(["git", "tag", "--delete", TAG], cwd=clone, check=True, capture_output=True)
    assert "this clone has none, 'git fetch --tags' brings them" in release(clone, "v9.9.9").stderr
    subprocess.run(["git", "tag", TAG], cwd=clone, check=True)
    subprocess.run(["git", "tag", "v9.9.9"], cwd=clone, check=True)
    assert f"tag it {TAG}" in release(clone, "v9.9.9").stderr
    assert "is there already" in release(clone, TAG, str(tmp_path)).stderr


@pytest.mark.long
def test_a_release_is_whole(clone: Path, tmp_path: Path) -> None:
    out = tmp_path / "release"
    done = release(clone, TAG, str(out))
    assert done.returncode == 0, done.stderr
    names = sorted(path.name for path in out.iterdir())
    version = tautline.__version__
    expected = {"70-tautline.rules", "SHA256SUMS", f"tautline-{version}-motor2040.uf2", f"tautline-{version}.cdx.json"}
    expected |= {f"tautline_robotics-{version}.tar.gz", f"tautline-{version}-motor2040.update"}
    wheels = [name for name in names if name.endswith(".whl")]
    assert len(wheels) == 1 and set(names) == expected | set(wheels)
    environment = tmp_path / "environment"
    venv.create(environment, with_pip=True)
    subprocess.run([environment / "bin/pip", "install", "--quiet", out / wheels[0]], check=True)
    told = subprocess.run([environment / "bin/taut", "--version"], check=True, capture_output=True, text=True).stdout
    assert version in told
    done = subprocess.run([environment / "bin/taut", "demo"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "tables flashed" in done.stderr, done.stderr  # with the board that the wheel holds
    assert (tmp_path / "tautline-demo" / "model" / "report.html").is_file()

    sums = dict(reversed(line.split("  ./")) for line in (out / "SHA256SUMS").read_text().splitlines())
    assert set(sums) == set(names) - {"SHA256SUMS"}
    assert all(hashlib.sha256((out / name).read_bytes()).hexdigest() == value for name, value in sums.items())

    document = json.loads((out / f"tautline-{version}.cdx.json").read_text())
    parts = {part["name"].lower() for part in document["components"]}
    assert {"numpy", "scipy", "opencv-python-headless", "tinyusb", "monocypher", "pico-sdk"} <= parts
    assert document["metadata"]["component"]["name"] == "tautline-robotics"
    assert str(tmp_path) not in json.dumps(document)
    assert (out / f"tautline-{version}-motor2040.uf2").read_bytes()[:4] == b"UF2\n"
