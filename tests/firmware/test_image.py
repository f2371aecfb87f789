"""The real board's image: built twice it is the same, and its UF2 holds it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from tools.uf2 import to_uf2

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "rp2040"


@pytest.fixture(scope="module")
def image() -> bytes:
    if not (BUILD / "tautline.bin").is_file():
        pytest.skip("the image is not built: run './run firmware'")
    return (BUILD / "tautline.bin").read_bytes()


def test_two_builds_are_byte_identical(image: bytes, tmp_path: Path) -> None:
    # Elsewhere, from a copy of the sources: no path and no time of the build is in the image.
    sources = tmp_path / "a-longer-path-than-the-first"
    for part in ("common", "firmware", "tools"):
        shutil.copytree(ROOT / part, sources / part, ignore=shutil.ignore_patterns("node_modules", "__pycache__"))
    build = tmp_path / "build"
    for command in (
        ["cmake", "-S", sources / "firmware/port/rp2040", "-B", build, "-G", "Ninja"],
        ["cmake", "--build", build, "--parallel", str(os.cpu_count() or 1), "--target", "tautline"],
    ):
        subprocess.run(command, check=True, capture_output=True, text=True)
    assert (build / "tautline.bin").read_bytes() == image
    assert (build / "tautline.uf2").read_bytes() == (BUILD / "tautline.uf2").read_bytes()


def test_the_uf2_holds_the_image(image: bytes) -> None:
    assert (BUILD / "tautline.uf2").read_bytes() == to_uf2(image)
