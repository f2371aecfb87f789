"""A place on an instrument without a marker, by which a video is followed: shown once, kept beside the video."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
import tomli_w

from tautline.errors import TautError
from tautline.recording import COLOUR_FILE, REGION_FILE
from tautline.vision.camera import read_picture
from tautline.vision.flow import Picture
from tautline.vision.patch import PatchTracker

FORMAT = "region/1"


@dataclass(frozen=True)
class Region:
    """A place on an instrument without a marker, as a person showed it once in a picture: a square of side_px around
    `at`. The picture is kept beside the file region.toml."""

    at: tuple[float, float]  # u, v, px
    side_px: float
    picture: Picture  # BGR (height, width, 3)

    @classmethod
    def beside(cls, video: Path) -> Self | None:
        """Loads the region of the region.toml beside a video; None where there is none. TautError where it cannot be
        loaded, or a marker's colour is there, too."""
        path = video.parent / REGION_FILE
        if not path.is_file():
            return None
        if (video.parent / COLOUR_FILE).is_file():
            raise TautError(f"{path}: beside it is a {COLOUR_FILE}: is there a marker or not? Remove one of both")
        return cls.load(path)

    def tracker(self) -> PatchTracker:
        """Returns a tracker of this place. TautError where there is nothing to follow."""
        return PatchTracker(self.picture, self.at, self.side_px)

    def save(self, path: Path) -> None:
        """Writes region.toml to `path`, and the picture as a PNG of the same name beside it. TautError where the PNG
        cannot be written."""
        shown = path.with_suffix(".png")
        if not cv2.imwrite(str(shown), self.picture):
            raise TautError(f"{shown}: cannot be written: is there room, and may you write there?")
        document = {"format": FORMAT, "at_px": list(self.at), "side_px": self.side_px, "picture": shown.name}
        path.write_text(tomli_w.dumps(document), encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Self:
        """Reads region.toml at `path` and its picture beside it. TautError where either is missing or of another
        format."""
        remedy = "show the place again with 'taut marker VIDEO --region U,V'"
        try:
            document = tomllib.loads(path.read_text(encoding="utf-8"))
            u, v = (float(x) for x in document["at_px"])
            side, name = float(document["side_px"]), str(document["picture"])
        except (OSError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise TautError(f"{path}: cannot be read as a place to follow ({error}): {remedy}") from error
        if document.get("format") != FORMAT:
            raise TautError(f"{path}: format is {document.get('format')!r}, expected '{FORMAT}': {remedy}")
        picture = read_picture(path.parent / name)
        if picture is None:
            raise TautError(f"{path}: its picture {name} is not beside it: {remedy}")
        return cls((u, v), side, np.asarray(picture, dtype=np.uint8))
