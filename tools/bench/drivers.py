"""./run bench drivers: how steadily each driver asks its motors by the wall clock, on its emulator.

The emulator answers from a thread of the same process, as fast as it can: what is measured is the driver, the link and
this machine's scheduler, not a bus on which bits take time.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from tautline.cli._common import json_option, progress_bar
from tautline.drivers import addresses
from tautline.drivers.hosted import HostedLink
from tautline.plain import plain

_EMULATORS = Path(__file__).parents[2] / "tests" / "host"


def run(rate_hz: float, seconds: float, say: Callable[[float, str], None]) -> list[dict[str, Any]]:
    sys.path.insert(0, str(_EMULATORS))
    import motor_emulators as emulators

    kinds = {
        "dynamixel": emulators.DynamixelEmulator,
        "feetech": emulators.FeetechEmulator,
        "canopen": emulators.Cia402Emulator,
        "moteus": emulators.MoteusEmulator,
    }
    rows = []
    for k, (kind, make) in enumerate(kinds.items()):
        say(k / len(kinds), kind)
        emulator = make([emulators.Motor()])
        try:
            rows.append({"kind": kind, **_measured(kind, emulator, rate_hz, seconds)})
        finally:
            emulator.close()
    return rows


def _measured(kind: str, emulator: Any, rate_hz: float, seconds: float) -> dict[str, Any]:
    bus = f"virtual/{emulator.bus.channel}" if kind in ("canopen", "moteus") else emulator.bus.path
    address = addresses.parse(f"{kind}:{bus}:1?rate={rate_hz:g}&baud=1000000")
    link = HostedLink(addresses.open_drives(address), f"{kind}:bench:1", rate_hz)
    try:
        time.sleep(seconds)
        return link.bus()
    finally:
        link.close()


@click.command("drivers")
@click.option("--rate", "rate_hz", type=click.FloatRange(20.0, 1000.0), default=100.0, show_default=True, help="Hz.")
@click.option("--seconds", type=click.FloatRange(0.5, 600.0), default=10.0, show_default=True, help="Of each.")
@json_option
def command(rate_hz: float, seconds: float, as_json: bool) -> None:
    """Jitter and round trip of each driver by the wall clock, on its emulator."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as state, progress_bar("drivers") as progress:
        os.environ["XDG_STATE_HOME"] = state
        rows = run(rate_hz, seconds, progress)
    if as_json:
        click.echo(json.dumps(plain({"load": load, "drivers": rows}), allow_nan=False))
        return
    table = Table(
        title=f"{rate_hz:g} Hz by the wall clock, {seconds:g} s each; load {load:.1f} on {os.cpu_count()} cores"
    )
    for name in ("", "jitter, ms rms", "round trip, ms", "at most, ms", "cycles late", "missed"):
        table.add_column(name, justify="right" if name else "left")
    for row in rows:
        table.add_row(
            row["kind"], f"{1e3 * row['jitter_s']:.2f}", f"{1e3 * row['round_trip_s']:.2f}",
            f"{1e3 * row['round_trip_most_s']:.1f}", f"{row['late']} of {row['cycles']}", str(row["missed"]),
        )  # fmt: skip
    Console(width=None if sys.stdout.isatty() else 120).print(table)
