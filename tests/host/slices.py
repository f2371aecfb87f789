"""What of a family of cases is tried each time, and what in long runs alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def some(cases: Iterable[Any], count: int) -> list[Any]:
    """All of them, those beyond the first `count` in long runs alone; a tuple is the values of several parameters."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=[pytest.mark.long] * (i >= count))
        for i, case in enumerate(cases)
    ]
