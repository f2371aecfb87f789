"""The benchmark compares what it says it does, and the tracker keeps its place in it."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tools.bench import trackers


def test_the_tracker_is_the_quickest_and_most_exact_of_those_in_opencv() -> None:
    scores, _ = trackers.run(frames=8)
    ours, others = scores[0], [score for score in scores if score.name.startswith("OpenCV")]
    assert ours.noise_px < 0.03 and ours.error_px < 0.03 and ours.found == 1.0
    assert {score.name.split()[1].rstrip(",") for score in others} == {"SimpleBlobDetector", "ArUco"}
    for score in others:
        assert score.frames_per_s < ours.frames_per_s and score.error_px > ours.error_px
