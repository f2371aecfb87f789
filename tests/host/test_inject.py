"""Faults of simulated boards as `taut inject` causes them, without a board."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tautline.errors import TautError
from tautline.live import faults
from tautline.live.setup import Live
from tautline.simulated.instrument import reference_rig


class Blind:
    """A set-up whose board has no fault at all, whatever is injected. Keeps what it was asked, in order."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.plant = SimpleNamespace(now_s=0.0, link=self, advance_to=self._advance_to)
        self.axis, self.rig, self.resolution = 0, reference_rig(), 0.01
        self.board = SimpleNamespace(
            ask=lambda name, **_: self.asked.append(name),
            check_fault=lambda axis: None,
            check_reference=lambda axis: None,
        )

    def ask(self, request: str) -> dict[str, Any]:
        """The sim link's."""
        self.asked.append(request)
        return {"ills": [request.split()[-1]]}

    def powered(self) -> nullcontext[None]:
        return nullcontext()

    def wait(self, seconds: float) -> None:
        self.plant.now_s += seconds

    def _advance_to(self, t_s: float) -> None:
        self.plant.now_s = t_s


@pytest.mark.parametrize("name", [name for name, fault in faults.FAULTS.items() if fault.request])
def test_a_fault_that_nobody_notices_is_caused_once_and_said(name: str) -> None:
    live = Blind()
    with pytest.raises(TautError, match=f"nobody noticed '{name}'"):
        faults.show(cast(Live, live), name)
    fault = faults.FAULTS[name]
    assert fault.request is not None
    injected = fault.request.format(axis=0)
    assert live.asked == ([injected, "check"] if fault.at_check else ["move", injected])
