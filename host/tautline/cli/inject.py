"""taut inject [FAULT]"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tautline.cli._common import emit, json_option
from tautline.cli._live import LiveOptions, axis_option, opened_setup, simulate_option
from tautline.errors import TautError


@click.command("inject")
@click.argument("fault", metavar="[FAULT]", required=False)
@axis_option
@simulate_option
@click.option("--sim", type=int, metavar="PORT", help="Sim link of a simulated board that runs: inject it there.")
@click.option("--board", metavar="BOARD", help="Refused: nobody injects faults into a real board.")
@json_option
def command(
    fault: str | None, axis: int, simulate: str | None, sim: int | None, board: str | None, as_json: bool
) -> None:
    """Let a fault happen on a simulated board, and see what it does and what is said of it; without FAULT, list them.

    A desktop board of its own is started for it and moved. With --sim the fault happens to a board that runs already,
    to be seen in whatever uses it; FAULT 'well' takes it back.
    """
    from tautline.live import faults

    if board is not None:
        raise TautError("faults are injected into simulated boards alone: leave --board out, or name --sim PORT")
    if fault is None:
        rows = {name: each.what for name, each in faults.FAULTS.items()}
        emit({"faults": rows}, as_json, "\n".join(f"{name:10} {what}" for name, what in rows.items()))
        return
    if fault not in faults.FAULTS and not (fault == "well" and sim is not None):
        raise click.UsageError(f"no fault '{fault}': choose one of {', '.join(faults.FAULTS)}")
    if sim is not None:
        _inject_by_port(sim, axis, fault)
        emit({"fault": fault, "axis": axis, "sim": sim}, as_json, f"axis {axis}: {fault}")
        return
    options = LiveOptions(
        board=None, axis=axis, camera=None, colour=Path(), simulate=simulate or "reference", at=None
    )  # fmt: skip
    with opened_setup(options, rig_path=None) as live:
        seen = faults.show(live, fault)
        unit = live.rig.actuator.unit
    what = faults.FAULTS[fault].what
    result: dict[str, Any] = {"injected": fault, "what": what, "unit": unit, **vars(seen)}
    emit(
        result,
        as_json,
        f"{fault}: {what}\ntaut: {seen.says}\nat rest after {seen.rest_s:.3f} s and {seen.way:.3g} {unit}",
    )


def _inject_by_port(port: int, axis: int, fault: str) -> None:
    """Causes a fault on an axis of a simulated board that runs in another process; port: of that board's sim link. The
    fault "well" takes all faults of the axis back and plugs the board in again."""
    from tautline.live import faults
    from tautline.simulated.simlink import SimLink

    link = SimLink(port)
    try:
        if fault == "well":
            link.ask(f"inject {axis} well")
            link.ask("plug")
        else:
            faults.inject(link, axis, fault)
    finally:
        link.close()
