"""Commands lose nothing of what they read, write into links and pipes, and take no start that is no number."""

import os
import threading
from pathlib import Path

import numpy as np
import pytest

import tautline as tl
from tautline.cli._outputs import check_no_input
from tautline.errors import TautError
from tautline.folders import whole_file, write_file
from tautline.model import Model
from tautline.recording import Motor
from tautline.reports.evidence import is_settled
from tautline.rig import Actuator, Coarse, Rig


def model(width: np.ndarray | float = 2.0) -> Model:
    q = np.linspace(-40.0, 40.0, 401)
    b = np.broadcast_to(np.asarray(width, dtype=float), q.shape).copy()
    rig = Rig(Actuator("deg", (-40.0, 40.0), 0.01), Coarse(1.0, 0.0))
    return Model(rig, q, b, np.full_like(q, 0.01), q.copy(), measured=(-40.0, 40.0), delay_s=0.0, sensor="angle")


def test_a_file_is_written_into_what_its_link_leads_to(tmp_path):
    link = tmp_path / "link.csv"
    link.symlink_to(tmp_path / "target.csv")
    write_file(link, "1\n")
    assert link.is_symlink() and (tmp_path / "target.csv").read_text() == "1\n"
    with whole_file(link) as file:
        file.write_text("2\n")
    assert link.is_symlink() and (tmp_path / "target.csv").read_text() == "2\n"


def test_a_pipe_stays_one(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reader.start()
    write_file(pipe, "row\n")
    reader.join(10.0)
    assert read == ["row\n"] and pipe.is_fifo()
    with pytest.raises(TautError, match="pipe"), whole_file(pipe):
        pass
    assert pipe.is_fifo()


def test_standard_output_that_is_piped_is_written_into():
    read, write = os.pipe()
    write_file(Path(f"/dev/fd/{write}"), "row\n")
    os.close(write)
    with os.fdopen(read) as seen:
        assert seen.read() == "row\n"


def test_what_is_read_is_not_overwritten(tmp_path, taut):
    recording = tmp_path / "recording"
    recording.mkdir()
    (recording / "motor.csv").write_text("t_s,q_deg\n")
    (tmp_path / "link.csv").symlink_to(recording / "motor.csv")
    for out in (recording / "motor.csv", tmp_path / "link.csv"):
        with pytest.raises(TautError, match="would be overwritten"):
            check_no_input(out, recording)
    check_no_input(recording / "predicted.csv", recording)
    check_no_input(None, recording)
    trajectory = tmp_path / "path.csv"
    trajectory.write_text("t_s,c_deg\n0,0\n1,1\n")
    model().save(tmp_path / "model")
    for command in (
        ["compensate", str(tmp_path / "model"), "--trajectory", str(trajectory), "--csv", str(trajectory)],
        ["predict", str(tmp_path / "model"), str(recording), "--csv", str(recording / "motor.csv")],
        ["track", str(tmp_path / "model"), str(recording), "--csv", str(recording / "motor.csv")],
    ):
        assert "would be overwritten" in taut.refuses(*command)
    picture = ["track", str(tmp_path / "model"), str(recording), "--csv", str(tmp_path / "t.csv"), "--picture", "x.foo"]
    assert "a picture ends in .png, .svg, .pdf" in taut.refuses(*picture)
    assert trajectory.read_text() == "t_s,c_deg\n0,0\n1,1\n" and (recording / "motor.csv").read_text() == "t_s,q_deg\n"


@pytest.mark.parametrize("start", [float("nan"), float("inf")])
def test_the_tip_starts_at_a_number(start):
    t_s = np.linspace(0.0, 1.0, 50)
    with pytest.raises(TautError, match="starts at an angle that is no number"):
        tl.predict(model(), Motor(t_s, t_s), t_s, start_deg=start)
    with pytest.raises(TautError, match="starts at an angle that is no number"):
        tl.Compensator(model(), start_deg=start)


def test_a_report_scores_from_where_the_motor_had_driven_the_tip_both_ways():
    """B is narrow where nothing was measured: two tips that start there meet at once, and say nothing of one that
    starts inside."""
    q = np.linspace(-40.0, 40.0, 401)
    narrow = model(np.clip(0.15 * np.abs(q + 40.0), 0.0, 3.0))
    t_s = np.arange(0.0, 30.0, 0.01)
    way = np.interp(t_s, [0.0, 10.0, 20.0, 30.0], [-40.0, 20.0, -20.0, 30.0])
    counted = is_settled(narrow, Motor(t_s, way), t_s)
    assert not counted[t_s < 10.0].any() and counted[t_s > 12.0].all()
