"""Real tools: a run predicts every other run at its load, by the plays that a calibration found and by one."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

import tautline as tl
from tautline.model import Model
from tautline.recording import Recording
from tools import davinci
from tools.undone.hysteresis import one_play

_SETTLED_S = 5.0


def off(model: Model, recording: Recording) -> float:
    """deg rms, without the offset: it moves between runs."""
    assert recording.angle is not None
    scene = recording.angle.t_s - model.delay_of("angle")
    left = (tl.predict(model, recording.motor, scene).c_deg - recording.angle.c_deg)[
        recording.angle.seen & (scene > recording.motor.t_s[0] + _SETTLED_S)
    ]
    return float(np.std(left))


@click.command()
@click.argument("data", required=False, type=click.Path(path_type=Path, exists=True))
def main(data: Path | None) -> None:
    """The da Vinci tool: errors of several plays over one play's, on other rates at the same load."""
    folder = data or davinci.find()
    if folder is None:
        raise click.ClickException("no da Vinci data beside the repository: name their folder")
    tool = davinci.Tool(folder)
    ratios = []
    for load in davinci.LOADS:
        for rate in davinci.RATES:
            model = tool.model((rate, load))
            single = one_play(model, tool.run((rate, load)))
            others = [tool.run((other, load)) for other in davinci.RATES if other != rate]
            of_run = [off(model, run) / off(single, run) for run in others]
            ratios += of_run
            told = ", ".join(f"{ratio:.3f}" for ratio in of_run)
            print(f"load {load} rate {rate}: {len(model.elements.width)} plays, {told}", flush=True)
    worst, median = max(ratios), float(np.median(ratios))
    print(f"{len(ratios)} pairs: median {median:.3f} (goal 0.95), worst {worst:.3f} (goal 1.02)")


if __name__ == "__main__":
    main()
