"""taut import SOURCE [--out RECORDING --motor NAME --tip NAME ...]"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import emit, json_option, progress_bar, read_rig, rig_option, warn
from tautline.cli._outputs import folder_option
from tautline.io.importing import (
    Listing,
    Roles,
    Source,
    import_episodes,
    named_roles,
    open_source,
    propose,
    proposed_command,
    scan,
)
from tautline.rig import UNITS

_LISTED = 60  # format: most channels, or recordings, in the text for a person


@click.command("import")
@click.argument("source_path", metavar="SOURCE", type=click.Path(path_type=Path))
@folder_option("--out", "Folder for the recording; for a data set of many episodes, of the recordings.", required=False)
@click.option(
    "--motor", metavar="NAME", help="The motor's position: topic.field[index] or a column; NAME:rad says its unit."
)
@click.option("--tip", metavar="NAME", multiple=True, help="The tip's angle or orientation; twice for u and v in px.")
@click.option("--command", "commanded", metavar="NAME", help="Where the motor was sent.")
@click.option("--load", metavar="NAME", help="The load on the motor.")
@click.option("--video", metavar="NAME", help="Pictures of the tip.")
@click.option("--joint", metavar="NAME", multiple=True, help="Another joint, which may couple in.")
@click.option("--time", "time_name", metavar="NAME", default="", help="A CSV's column of times; NAME:ms says its unit.")
@click.option("--unit", type=click.Choice(UNITS), help="The unit of q: mm of cable, or deg.")
@click.option("--episode", type=click.IntRange(0), help="One episode of a data set; default all, each a recording.")
@rig_option
@json_option
def command(
    source_path: Path, out: Path | None, motor: str | None, tip: tuple[str, ...], commanded: str | None,
    load: str | None, video: str | None, joint: tuple[str, ...], time_name: str, unit: str | None,
    episode: int | None, rig_path: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Recordings out of a ROS bag, an MCAP file, a LeRobot data set or a CSV.

    Without --motor and --tip (or --video) it lists what is there, proposes which is what, and prints the whole command.
    """
    rig = read_rig(rig_path) if rig_path is not None else None
    source = open_source(source_path, time_name)
    roles = Roles(motor or "", tip, command=commanded, load=load, video=video, joints=joint)
    if motor is None or not (tip or video):
        _print_proposal(source, roles, out, unit or (rig.actuator.unit if rig else None), episode, time_name, as_json)
        return
    with progress_bar("importing") as progress:
        written, skipped = import_episodes(
            source,
            out or Path("recording"),
            roles,
            progress,
            unit=unit,
            rig=rig,
            episode=episode,
        )
    for text in dict.fromkeys([*(each for made in written for each in made.warnings), *skipped]):
        warn(text)
    lines = [f"{each.folder}: {each.rows} rows of the motor, by the {each.clock} times" for each in written]
    if len(written) > _LISTED:
        lines = [*lines[:_LISTED], f"... {len(written) - _LISTED} more"]
    emit(
        {
            "source": source.path,
            "kind": source.kind,
            "written": [each.__dict__ for each in written],
            "skipped": skipped,
        },
        as_json,
        "\n".join(lines),
    )


def _print_proposal(
    source: Source, roles: Roles, out: Path | None, unit: str | None, episode: int | None, time_name: str, as_json: bool
) -> None:
    """Scans the source and prints, as the command's result, its channels, a proposal which channel has which role, and
    the whole command line that would import it so. roles: those that the user named already; unit: of q, None: not
    known; the other arguments are the command's options."""
    with progress_bar("reading") as progress:
        listing = scan(source, episode, progress)
    found = propose(listing, named_roles(roles, listing, source, unit))
    text = proposed_command(source, out, found, roles.joints, episode, time_name)
    for note in source.notes:
        warn(note)
    result = {
        "source": source.path,
        "kind": source.kind,
        "episodes": len(source.episodes()),
        "channels": [
            {
                "name": c.name,
                "label": c.fact.label,
                "type": c.fact.type,
                "unit": c.fact.unit or None,
                "count": c.count,
                "rate_hz": c.rate_hz,
                "low": c.low if c.count else None,
                "high": c.high if c.count else None,
            }
            for c in listing.channels.values()
        ],
        "videos": listing.videos,
        "proposal": {
            "motor": found.motor and found.motor.text,
            "tip": [each.text for each in found.tip],
            "command": found.command and found.command.text,
            "load": found.load and found.load.text,
            "video": found.video,
            "unit": found.unit,
        },
        "notes": found.notes,
        "command": text or None,
    }
    emit(result, as_json, _proposal_page(source, listing, found.notes, text))


def _proposal_page(source: Source, listing: Listing, notes: tuple[str, ...], text: str) -> str:
    """The text for a person of `_print_proposal`: a table of the channels whose values change and of the videos, the
    notes on the proposal, and the proposed command line `text`, or "" where nothing is proposed."""
    moving = [c for c in listing.channels.values() if c.moves]
    many = len(source.episodes())
    head = f"{source.path}: {source.kind}" + (f", {many} episodes, this is {listing.episode}" if many > 1 else "")
    rows = [("name", "", "unit", "rows", "Hz", "from", "to")]
    rows += [
        (c.name, c.fact.label, c.fact.unit, str(c.count), f"{c.rate_hz:.4g}", f"{c.low:.4g}", f"{c.high:.4g}")
        for c in moving[:_LISTED]
    ]
    rows += [(name, "video", "", "", "", "", "") for name in listing.videos]
    used = [k for k in range(7) if any(row[k] for row in rows[1:])]  # columns that are not empty
    widths = {k: max(len(row[k]) for row in rows) for k in used}
    lines = [head, ""]
    lines += [
        "  ".join(row[k].ljust(widths[k]) if k < 3 else row[k].rjust(widths[k]) for k in used).rstrip() for row in rows
    ]
    if len(moving) > _LISTED:
        lines.append(f"... {len(moving) - _LISTED} more that move: --json lists all")
    if still := len(listing.channels) - len(moving):
        lines.append(f"({still} more do not move: --json lists them)")
    lines += ["", *(f"- {note}" for note in notes), ""]
    return "\n".join([*lines, text or "nothing is proposed: name what is the motor and the tip with --motor and --tip"])
