"""The camera's view of a motion through known angles."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from tautline.geometry import project
from tautline.reports import figures
from tautline.rig import Rig
from tautline.rigging.places import Places


@mpl.rc_context(figures.STYLE)
def picture(rig: Rig, places: Places) -> Figure:
    """Draws the camera's image plane: where the marker was seen at each known angle, and the curve on which the rig
    predicts it, so that a wrong rig is seen. The rig has a camera."""
    assert rig.camera is not None
    low, high = places.image_px.min(axis=0), places.image_px.max(axis=0)
    # px: half the width and height of what is shown
    half = 0.6 * float(np.max(high - low)) * np.array([1.0, 0.5]) + 10.0
    (left, top), (right, bottom) = (low + high) / 2 - half, (low + high) / 2 + half
    made, axes = figures.figure(7.0, 4.4)
    ax = axes[0, 0]
    curve = project(rig, np.linspace(places.c_deg.min(), places.c_deg.max(), 200))
    ax.plot(*curve.T, color=figures.MODEL, linewidth=1.2, label="where rig.toml expects the marker")
    ax.plot(*places.image_px.T, "o", color=figures.UP, markersize=4, label="where it was seen")
    for c_deg, at in zip(places.c_deg, places.image_px, strict=True):
        ax.annotate(f"{c_deg:.0f}°", at, (0, 7), textcoords="offset points", fontsize=8, ha="center")
    ax.set(xlim=(left, right), ylim=(bottom, top), xlabel="u (px)", ylabel="v (px)")
    ax.set_aspect("equal")
    made.legend(loc="outside lower center", ncols=2)
    return made
