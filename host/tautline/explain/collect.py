"""Every topic, collected from where it is defined."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import chain

from tautline import _native
from tautline.effects.kind import Parameter
from tautline.errors import TautError
from tautline.explain.faults import AFTER, LOOK
from tautline.explain.glossary import TERMS
from tautline.explain.reasons import REASONS
from tautline.explain.topic import KINDS, Topic


@cache
def topics() -> Mapping[str, Topic]:
    """All topics by code, in the order of KINDS; collected once."""
    listed = list(chain(_effects(), REASONS, _faults(), _refusals(), _keys(), _files(), _formats(), TERMS))
    listed.sort(key=lambda topic: list(KINDS).index(topic.kind))
    return {topic.code: topic for topic in listed}


def find(name: str) -> Topic:
    """The topic of a name, in upper or lower case: a code, an alias, or the last part of a code if no other code ends
    so. Any name that begins with "simulator." has one and the same topic. TautError, which names the nearest codes,
    where there is none."""
    known = topics()
    wanted = name.strip().strip("[]").casefold()
    if wanted.startswith("simulator."):
        return of_effect(wanted)
    by_code = [topic for topic in known.values() if topic.code.casefold() == wanted]
    by_alias = [topic for topic in known.values() if wanted in _names(topic)]
    if by_code or by_alias:
        return (by_code or by_alias)[0]
    ends = [topic for topic in known.values() if topic.code.casefold().endswith(f".{wanted}")]
    if len(ends) == 1:
        return ends[0]
    names = {each: topic.code for topic in known.values() for each in _names(topic)}
    near = [topic.code for topic in ends] or [names[each] for each in difflib.get_close_matches(wanted, names, 3, 0.6)]
    near += [code for code in known if wanted and wanted in code.casefold() and code not in near]
    hint = f": is it {' or '.join(dict.fromkeys(near[:4]))}?" if near else ""
    raise TautError(f"nothing is called '{name}'{hint or ':'} 'taut explain' lists all that there is")


def of_effect(name: str) -> Topic:
    """The topic of an effect, by its id; all parameters of a simulator share one topic. KeyError for an unknown id."""
    return topics()["simulator" if name.startswith("simulator.") else name]


def link(code: str) -> str:
    """The command that explains a code; "" where there is no topic of that code."""
    return f"taut explain {code}" if code in topics() else ""


def _names(topic: Topic) -> set[str]:
    """A topic's code and aliases, in lower case."""
    return {topic.code.casefold(), *(alias.casefold() for alias in topic.aliases)}


def _effects() -> Iterator[Topic]:
    """Yields one topic for all parameters of a simulator, then one for every effect of the library."""
    from tautline.effects import LIBRARY, SIMULATOR, of_simulator

    own, meanings = of_simulator("NAME"), _meanings()
    yield Topic(
        SIMULATOR,
        "effect",
        f"{own.says[:1].upper()}{own.says[1:]}: {own.id} of a diagnosis with --simulator, NAME being a parameter of it "
        "such as elbow.damping or servo.kp.",
        tell=own.tell,
        mend=own.mend,
    )
    for kind in LIBRARY:
        event = (
            f"Mend the cause, {kind.event.cause}: no table and no model takes its {kind.event.what} away."
            if kind.event
            else ""
        )
        held = (
            "The board's tables can carry it."
            if kind.on_board
            else "The board's tables cannot carry it; a corrected model does."
        )
        rows = tuple((parameter.name, _in_words(parameter, meanings)) for parameter in kind.parameters)
        yield Topic(
            kind.id,
            "effect",
            f"{kind.says[:1].upper()}{kind.says[1:]}.",
            tell=kind.tell,
            mend=" ".join(part for part in (kind.mend, event, held) if part),
            rows=rows,
        )


def _meanings() -> dict[str, str]:
    """What each parameter of the effects in C means, by the parameter's name; the effect's id, which stands before
    that, is left out."""
    every = (*_native.effect_parameters, *_native.projection_parameters)
    return {name: meaning.partition(": ")[2] for name, _, _, meaning in every}


def _in_words(parameter: Parameter, meanings: Mapping[str, str]) -> str:
    """What a parameter means, its unit and which change of it is noticed. For a parameter that is one of two values,
    only what they mean. meanings: as of `_meanings`."""
    means = meanings.get(parameter.name, "")
    if parameter.searched and len(parameter.shape) > 1:
        return means or " or ".join(f"{value:g}" for value in parameter.shape)
    told = parameter.unit.replace("unit", "unit of q") or "a share"
    share = " of the motor's range" if parameter.unit.startswith("unit") else ""
    return "; ".join(part for part in (means, told, f"a change of {parameter.scale:g}{share} is noticed") if part)


def _faults() -> Iterator[Topic]:
    """Yields a topic for every fault of a board."""
    from tautline.device import wire

    for name, (number, text) in wire.wire.FAULTS.items():
        if not number:
            continue
        says, _, mend = text.partition(": ")
        says, measured = _without_measure(says)
        mended = f"{mend[:1].upper()}{mend[1:]}. {AFTER}" if mend else AFTER
        what = f"{says[:1].upper()}{says[1:]}.{measured}"
        yield Topic(name, "fault", what, tell=LOOK.get(name, ""), mend=mended)


def _without_measure(says: str) -> tuple[str, str]:
    """Splits a fault's text: returns it without the brackets in which a message has the measured value, and a sentence
    on the unit of that value, "" where the text has no brackets."""
    found = re.search(r" \((?:by |at )?([^)]+)\)", says)
    if found is None:
        return says, ""
    return says.replace(found[0], ""), f" The number in its message: {found[1]}."


def _refusals() -> Iterator[Topic]:
    """Yields a topic for every reason why a board refuses something."""
    from tautline.device import wire

    for name, (_, text) in wire.wire.REASONS.items():
        says, _, mend = text.partition(": ")
        yield Topic(
            f"refused.{name}",
            "refusal",
            f"{says[:1].upper()}{says[1:]}.",
            mend=f"{mend[:1].upper()}{mend[1:]}." if mend else "",
        )


def _keys() -> Iterator[Topic]:
    """Yields a topic for every section of rig.toml and shapes.toml, and one for each of its keys."""
    from tautline.rig import SECTIONS
    from tautline.shapes import SHAPE

    for section in (*SECTIONS.values(), SHAPE):
        file = section.file
        rows = tuple((f"{file}.{section.name}.{key.name}", key.says) for key in section.keys)
        yield Topic(f"{file}.{section.name}", file, section.says, rows=rows, aliases=(section.name,))
        for key in section.keys:
            needed = "It has to be there." if key.needed else "It may be left out."
            example = str(key.example).replace("'", '"') if key.kind != "text" else f'"{key.example}"'
            yield Topic(
                f"{file}.{section.name}.{key.name}",
                file,
                f"{key.says[:1].upper()}{key.says[1:]}. Expected: {key.expected}. {needed}",
                tell=f"A wrong one shows itself: {key.wrong}." if key.wrong else "",
                rows=((f"[{section.name}]", f"{key.name} = {example}"),),
                see=(f"{file}.{section.name}",),
                aliases=(f"{section.name}.{key.name}",),
            )


def _formats() -> Iterator[Topic]:
    """Yields a topic for every format of `taut export`."""
    from tautline.io.exporting.formats import EXTRA, FORMATS

    for form in FORMATS:
        needs = ", ".join(package for _, package in form.needs)
        install = f"It needs {needs}: pip install 'tautline-robotics[{EXTRA}]'." if needs else ""
        rows = (
            ("takes", " or ".join(form.takes)),
            ("--out", f"a file, NAME{form.suffix}" if form.suffix else "a folder"),
            *((("--axis", f"{form.axis} unless another is named"),) if form.axis else ()),
            ("lost", form.loses),
        )
        says = f"{form.says[:1].upper()}{form.says[1:]}."
        yield Topic(f"export.{form.name}", "format", says, mend=install, rows=rows, aliases=(form.name,))


def _files() -> Iterator[Topic]:
    """Yields a topic for every CSV file of a recording, with its columns."""
    from tautline.layouts import LAYOUTS

    for layout in LAYOUTS:
        rows = tuple(
            (
                column.name.format(unit="mm|deg") if "{" in column.name else column.name,
                f"{column.says}{' (needed)' if column.needed else ''}",
            )
            for column in layout.columns
        )
        names = tuple(f"{layout.file}:{name}" for unit in ("mm", "deg") for name in layout.names(unit))
        yield Topic(layout.file, "file", layout.says, rows=rows, aliases=names)
