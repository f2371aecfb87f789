"""The documentation as a site with a search: README, docs/ and the other pages as they are, and a page for each topic
that `taut explain` knows.

    python -m tools.site --out build/site
"""

from __future__ import annotations

import argparse
import html
import re
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import unquote, urlsplit

from tautline.cli import _topic_pages
from tautline.effects import BY_ID
from tautline.explain.collect import topics
from tautline.explain.topic import KINDS, Topic
from tautline.reports import figures

ROOT = Path(__file__).parents[1]
TOPICS = "messages"  # the folder of their pages
# The sections of the site's list of pages.
PAGES = {
    "Begin": ("README.md", "docs/own-recordings.md", "docs/marker.md", "docs/rig.md", "docs/transcript.md"),
    "Measure": ("docs/calibration.md", "docs/live-page.md", "docs/tracking.md", "docs/drivers.md", "docs/ros.md"),
    "Explain": ("docs/diagnosis.md", "docs/fleet.md", "docs/blindtest.md", "docs/results.md"),
    "In and out": ("docs/import.md", "docs/export.md", "docs/files.md", "examples/README.md"),
    "Reference": (
        "docs/commands.md", "docs/protocol.md", "docs/update.md", "docs/safety.md", "docs/proofs.md", "docs/mutants.md",
        "docs/emulator.md", "docs/porting.md",
        "firmware/estimator/README.md",
    ),
    "The project": ("DESIGN.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md"),
}  # fmt: skip
_LINK = re.compile(r"(!?\[[^\]]*\]\()([^)\s]+)(\))")
_FENCE = re.compile(r"^(```\w+) .+$", re.MULTILINE)  # a block of code, and what tests are told of it
_WRITTEN_AS = {"effect": "Its parameters", "file": "Its columns"}


def stage(folder: Path, pictures: bool = True) -> list[object]:
    """The site's sources in a folder: every page, what pages lead to, every topic. Gives the list of pages.

    FileNotFoundError where a page leads to a file that is not there.
    """
    pages = {page for group in PAGES.values() for page in group}
    for page in sorted(pages):
        text = _FENCE.sub(r"\1", (ROOT / page).read_text("utf-8"))
        _write(folder / page, _LINK.sub(lambda found, page=page: _carried(found, page, pages, folder), text))
    known = topics()
    for topic in known.values():
        kind = BY_ID.get(topic.code)
        drawn = pictures and kind is not None and not kind.event
        _write(folder / TOPICS / _name(topic), _page(topic, drawn))
        if drawn:
            figures.save(_topic_pages.drawn(kind), folder / TOPICS / Path(topic.file).with_suffix(".svg"))
    return [
        *({title: list(group)} for title, group in PAGES.items()),
        {
            "What messages mean": [
                {title: [{topic.code: f"{TOPICS}/{_name(topic)}"} for topic in known.values() if topic.kind == kind]}
                for kind, title in KINDS.items()
            ]
        },
    ]


def build(out: Path, pictures: bool = True) -> None:
    """Writes the site. SystemExit where a link or an anchor leads nowhere."""
    from mkdocs.commands.build import build as made
    from mkdocs.config import load_config

    with TemporaryDirectory() as scratch:
        sources = Path(scratch) / "pages"
        nav = stage(sources, pictures)
        config = Path(scratch) / "mkdocs.yml"
        config.write_text("site_name: tautline\n")
        made(
            load_config(
                str(config),
                docs_dir=str(sources),
                site_dir=str(out.absolute()),
                nav=nav,
                strict=True,
                use_directory_urls=False,  # without a server all of it can be read but the search
                theme={
                    "name": "material",
                    "font": False,  # nothing is fetched from elsewhere
                    "features": ["navigation.indexes", "navigation.top", "search.suggest", "search.highlight"],
                    "palette": [
                        {"media": "(prefers-color-scheme: light)", "scheme": "default", "primary": "blue grey"},
                        {"media": "(prefers-color-scheme: dark)", "scheme": "slate", "primary": "blue grey"},
                    ],
                },
                plugins=["search"],
                markdown_extensions=["tables", "fenced_code", "pymdownx.superfences", {"toc": {"permalink": True}}],
                validation={"anchors": "warn", "absolute_links": "warn", "unrecognized_links": "warn"},
            )
        )


def _carried(found: re.Match[str], page: str, pages: set[str], folder: Path) -> str:
    """A link as the site has it: what it leads to in this repository comes with it."""
    where = urlsplit(found[2])
    if where.scheme or not where.path:
        return found[0]
    there = (ROOT / page).parent / unquote(where.path)
    name = there.resolve().relative_to(ROOT).as_posix()
    if there.is_dir():  # the list of pages stands beside every page
        return found[0].removeprefix("!").split("](")[0].removeprefix("[")
    if name not in pages:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(there, folder / name)
    return found[0]


def _page(topic: Topic, drawn: bool) -> str:
    known = topics()
    lines = [f"# {topic.code}", f"*{KINDS[topic.kind]}*", _plain(topic.what)]
    if drawn:
        lines.append(f"![What {topic.code} does]({Path(topic.file).with_suffix('.svg')})")
    for title, text in (("How to tell it", topic.tell), ("What to do", topic.mend)):
        if text:
            lines += [f"## {title}", _plain(text)]
    if topic.rows:
        rows = [
            f"<tr><td><code>{html.escape(name)}</code></td><td>{html.escape(says)}</td></tr>"
            for name, says in topic.rows
        ]
        lines += [f"## {_WRITTEN_AS.get(topic.kind, 'Written as')}", "<table>" + "\n".join(rows) + "</table>"]
    if topic.see:
        lines.append("See also: " + ", ".join(f"[{code}]({_name(known[code])})" for code in topic.see))
    lines.append(f"In a terminal: `taut explain {topic.code}`")
    return "\n\n".join(lines) + "\n"


def _name(topic: Topic) -> str:
    return str(Path(topic.file).with_suffix(".md"))


def _plain(text: str) -> str:
    """A sentence whose signs mean nothing to Markdown."""
    return re.sub(r"([\\`*_{}\[\]#|!])", r"\\\1", html.escape(text, quote=False))


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "site")
    given = parser.parse_args()
    build(given.out)
    print(given.out / "index.html")


if __name__ == "__main__":
    main()
