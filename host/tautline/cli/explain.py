"""taut explain [CODE]"""

from __future__ import annotations

import textwrap
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tautline.cli._common import emit, json_option
from tautline.cli._outputs import Output

if TYPE_CHECKING:
    from tautline.explain import Topic

_WIDTH = 100  # format: characters of a line


@click.command("explain")
@click.argument("code", required=False)
@click.option("--html", "folder", type=Output(), help="Write all pages there, with their pictures.")
@json_option
def command(code: str | None, folder: Path | None, as_json: bool) -> None:
    """What a message means: an effect (transmission.creep), a reason of a verdict (clock.offset), a fault (STALL), a
    key of rig.toml (actuator.range), a file (motor.csv) or a term (f_remain).

    Without CODE: the list of all. With effect, reason, fault, refusal, rig, shapes, file, format or term: of those.

    It is in the package: no network is needed.
    """
    from tautline.explain import KINDS, find, topics

    if folder is not None:
        from tautline.cli._topic_pages import write_all

        index = write_all(folder)
        emit({"index": index, "pages": len(topics())}, as_json, f"{len(topics())} pages: open {index}")
        return
    if code is not None and code.casefold() not in KINDS:
        topic = find(code)
        emit(asdict(topic), as_json, _topic_in_words(topic))
        return
    lines, listed = [], []
    for kind, title in KINDS.items():
        if code is not None and code.casefold() != kind:
            continue
        of_kind = [topic for topic in topics().values() if topic.kind == kind]
        listed += [topic.code for topic in of_kind]
        lines += ["", click.style(title, bold=True)]
        lines += [f"  {topic.code:<40} {_shortened(topic.what)}" for topic in of_kind]
    emit({"topics": listed}, as_json, "\n".join(lines[1:]))


def _shortened(text: str) -> str:
    """The beginning of a text, cut between words to at most 78 characters, so that it fits a line of the list."""
    return textwrap.shorten(text, 78, placeholder=" ...")


def _topic_in_words(topic: Topic) -> str:
    """A topic as text for a terminal: its code, what it is, how to tell it, what to do, a table of its rows, and
    related topics; parts that the topic lacks are left out."""
    lines = [click.style(topic.code, bold=True), *textwrap.wrap(topic.what, _WIDTH)]
    for title, text in (("How to tell it", topic.tell), ("What to do", topic.mend)):
        if text:
            lines += ["", click.style(title, bold=True), *textwrap.wrap(text, _WIDTH)]
    if topic.rows:
        wide = min(max(len(name) for name, _ in topic.rows), 34)
        lines.append("")
        for name, says in topic.rows:
            lines += textwrap.wrap(f"{name:<{wide}}  {says}", _WIDTH, subsequent_indent=" " * (wide + 2))
    if topic.see:
        lines += ["", f"See also: {', '.join(topic.see)} (taut explain ...)"]
    return "\n".join(lines)
