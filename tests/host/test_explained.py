"""The pictures of docs/calibration.md and docs/diagnosis.md are those of a fresh run, and the pages say the same."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image
from test_gallery import parts

from tools.pictures import EXPLAINED

DOCS = Path(__file__).parents[2] / "docs"


def shown(page: str) -> tuple[str, str]:
    """What a page says of its picture, and what the picture's file says of itself."""
    found = re.search(rf"!\[([^]]+)\]\(pictures/{Path(page).stem}\.png\)", (DOCS / page).read_text())
    assert found is not None, "the page does not show it"
    with Image.open(DOCS / "pictures" / f"{Path(page).stem}.png") as picture:
        return found[1], picture.info["Description"]


@pytest.mark.parametrize("page", EXPLAINED)
def test_a_pages_picture_is_that_of_a_fresh_run(page: str) -> None:
    said, in_file = shown(page)
    assert said == in_file
    made, says = EXPLAINED[page]()
    assert parts(said, says) == []
    assert len(made.axes) >= 3 and all(axes.has_data() for axes in made.axes)
