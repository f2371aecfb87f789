"""taut marker, as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from tautline.cli.marker import command
from tautline.errors import TautError
from tautline.simulated.endoscope import Endoscope
from tautline.simulated.instrument import reference_rig
from tautline.vision.colour import MarkerColour
from tautline.vision.marker import MarkerTracker

SCOPE = Endoscope(reference_rig())


def taut(*arguments: object) -> Result:
    return CliRunner().invoke(command, [str(argument) for argument in arguments])


def failure(result: Result) -> str:
    assert result.exit_code != 0
    return str(result.exception) if isinstance(result.exception, TautError) else result.output


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), SCOPE.frame(20.0))
    return path


def test_a_picture_gives_a_colour_and_a_picture_of_it(picture: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "marker.toml"
    result = taut(picture, "--out", out)
    assert result.exit_code == 0 and "px wide" in result.output
    frame = SCOPE.frame(30.0)
    seen = MarkerTracker(MarkerColour.load(out)).track(frame)
    assert np.hypot(*(np.array([seen.u_px, seen.v_px]) - SCOPE.position(30.0)[0])) < 0.1
    shown = cv2.imread(str(out.with_suffix(".png")))
    assert shown.shape == (576, 1440, 3)


def test_the_place_can_be_said_and_json_tells_it(picture: Path, tmp_path: Path) -> None:
    u, v = SCOPE.position(20.0)[0]
    result = taut(picture, "--at", f"{u:.0f},{v:.0f}", "--out", tmp_path / "marker.toml", "--json")
    said = json.loads(result.stdout)
    assert np.hypot(said["at_px"][0] - u, said["at_px"][1] - v) < 0.1 and said["frames"] == 1


def test_a_video_is_looked_into(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "video.mkv"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (720, 576))
    for c in np.linspace(0, 10, 8):
        writer.write(SCOPE.frame(c))
    writer.release()
    result = taut(tmp_path / "video.mkv", "--out", tmp_path / "marker.toml")
    assert result.exit_code == 0 and "seen in 8 of the first 8 frames" in result.output


def test_what_goes_wrong_is_said_in_one_line(picture: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "marker.toml")
    assert "no such video file" in failure(taut(tmp_path / "none.png", *out))
    (tmp_path / "broken.png").write_bytes(picture.read_bytes()[:50])
    assert "broken.png" in failure(taut(tmp_path / "broken.png", *out))
    (tmp_path / "text.txt").write_text("no picture")
    assert "is it a video" in failure(taut(tmp_path / "text.txt", *out))
    assert "write U,V in px" in failure(taut(picture, "--at", "12", *out))
    assert "stands out at (600, 300)" in failure(taut(picture, "--at", "600,300", *out))
    assert "camera 97" in failure(taut("97", *out))
    assert not (tmp_path / "marker.toml").exists()


def test_the_picture_that_is_read_is_not_written_over(picture: Path, tmp_path: Path) -> None:
    before = picture.read_bytes()
    for words in ((), ("--region", "300,300")):
        for out in (picture, picture.with_suffix(".toml")):
            assert "would be overwritten" in failure(taut(picture, "--out", out, *words))
    assert picture.read_bytes() == before
