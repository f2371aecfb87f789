"""The documentation's site: every link leads somewhere, every topic is found, nothing is fetched from elsewhere."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="needs the extra `test`")

from mkdocs.exceptions import Abort

from tautline import explain
from tools import site

LOADED = re.compile(r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"([^\"]+)|<link\b[^>]*\bhref=\"([^\"]+)")


def test_every_page_and_topic_is_in_it_and_can_be_found(tmp_path: Path) -> None:
    site.build(tmp_path, pictures=False)
    topics = explain.topics().values()
    assert {path.name for path in (tmp_path / site.TOPICS).iterdir()} == {topic.file for topic in topics}
    for page in {page for group in site.PAGES.values() for page in group}:
        name = re.sub(r"README\.md$", "index.md", page).removesuffix(".md")
        assert (tmp_path / f"{name}.html").is_file(), page
    found = {
        entry["location"]: entry for entry in json.loads((tmp_path / "search/search_index.json").read_text())["docs"]
    }
    for topic in topics:
        entry = found[f"{site.TOPICS}/{topic.file}"]
        assert entry["title"] == topic.code
    assert any("breathing" in entry["text"] for entry in found.values())
    index = (tmp_path / "index.html").read_text()
    assert "```" not in index and "<code" in index
    for page in tmp_path.rglob("*.html"):
        loaded = [a or b for a, b in LOADED.findall(page.read_text())]
        assert loaded and not [address for address in loaded if re.match(r"(https?:)?//", address)], page


def test_every_page_of_the_documentation_is_listed() -> None:
    listed = {page for group in site.PAGES.values() for page in group}
    assert {path.relative_to(site.ROOT).as_posix() for path in (site.ROOT / "docs").glob("*.md")} <= listed


@pytest.mark.parametrize("link", ["files.md#no-such-heading", "#no-such-heading"])
def test_a_link_that_leads_nowhere_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, link: str) -> None:
    monkeypatch.setattr(site, "PAGES", {"": ("page.md", "files.md")})
    monkeypatch.setattr(site, "ROOT", tmp_path)
    monkeypatch.setattr(site, "topics", dict)
    (tmp_path / "page.md").write_text(f"# A page\n[here]({link})\n")
    (tmp_path / "files.md").write_text("# Files\n")
    with pytest.raises(Abort):
        site.build(tmp_path / "site")


def test_a_link_to_a_file_that_is_not_there_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(site, "PAGES", {"": ("page.md",)})
    monkeypatch.setattr(site, "ROOT", tmp_path)
    (tmp_path / "page.md").write_text("[gone](gone.c)\n")
    with pytest.raises(FileNotFoundError):
        site.stage(tmp_path / "staged")


def test_what_a_sentence_holds_means_nothing_to_markdown() -> None:
    assert site._plain("<b> a_b *c* [d] 1|2 `e`") == r"&lt;b&gt; a\_b \*c\* \[d\] 1\|2 \`e\`"
