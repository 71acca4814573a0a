"""Every Python block of the documentation runs, in the order of its page, and its assertions hold."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])

#: A fenced block, at any indentation; the tag ``notest`` after the language leaves it out.
BLOCK = re.compile(
    r"^(?P<indent> *)```python(?P<tag>[^\n]*)\n(?P<code>.*?)^(?P=indent)```", re.MULTILINE | re.DOTALL
)


def blocks(text: str) -> list[tuple[int, str]]:
    """Line number and code of each block that has to run."""
    found = []
    for match in BLOCK.finditer(text):
        if "notest" not in match["tag"].split():
            indent = len(match["indent"])
            code = "".join(line[indent:] for line in match["code"].splitlines(keepends=True))
            found.append((text.count("\n", 0, match.start()) + 2, code))
    return found


@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page.read_text())], ids=lambda page: page.name
)
def test_blocks_of_a_page_run_in_order(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": f"docs_{page.stem}"}
    for line, code in blocks(page.read_text()):
        # Empty lines in front make a failure point at the line of the page.
        exec(compile("\n" * (line - 1) + code, str(page), "exec"), names)


def test_the_search_finds_blocks_and_leaves_out_those_that_are_not_to_run():
    text = (
        "a\n```python\nx = 1\n```\n```python notest\ny\n```\n"
        "1. b\n   ```python\n   z = 2\n   ```\n```text\nno\n```\n"
    )
    assert blocks(text) == [(3, "x = 1\n"), (10, "z = 2\n")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_of_a_page_exist(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}, which is not there"


def test_no_page_loads_anything_from_elsewhere():
    for page in PAGES:
        assert not re.search(r"!\[[^\]]*\]\(https?://", page.read_text()), f"{page.name} loads a picture"
