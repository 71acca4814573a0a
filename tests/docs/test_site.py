"""Facts that the documentation repeats agree with the code."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import yaml

from visuohaptic._version import __version__
from visuohaptic.core import Reason

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "visuohaptic"


def test_every_reason_has_its_remedy():
    page = (ROOT / "docs" / "howto" / "measure.md").read_text()
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == {str(reason) for reason in Reason}


def test_every_extra_is_explained():
    extras = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    page = (ROOT / "docs" / "getting_started.md").read_text()
    assert extras - {"all"} == set(re.findall(r"^\| `([\w-]+)` \| [a-zA-Z]", page, re.MULTILINE)) - {
        "t",
        "true",
    } - {
        "measured",
        "sigma",
        "event",
    }


def test_the_citation_has_the_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert str(citation["version"]) == __version__
    assert citation["license"] == "Apache-2.0"


def test_generated_pages_are_up_to_date():
    """The pages of the API and the tables of the architecture say what the source says."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "docs" / "generated.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"run python docs/generated.py: {done.stdout}{done.stderr}"


def test_the_menu_names_pages_that_exist():
    menu = re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    assert menu
    missing = [page for page in menu if not (ROOT / "docs" / page).is_file()]
    # The pages of notebooks are made from them.
    assert [page for page in missing if not (ROOT / "docs" / page).with_suffix(".ipynb").is_file()] == []


def test_contributing_names_files_and_functions_that_exist():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    named = re.findall(r"`((?:tests|benchmarks|docs|[a-z_]+)/[\w/.]*)`", text)
    assert len(named) > 12
    for path in named:
        if "NAME" not in path and "chapter_N" not in path:
            assert (ROOT / path).exists() or (SOURCE / path).exists(), path
    sources = "\n".join(path.read_text() for path in SOURCE.rglob("*.py"))
    found = re.findall(r"\b(?:def|class) (\w+)|\b([a-z]+(?:_[a-z]+)+):|\.([a-z]+(?:_[a-z]+)+)\b", sources)
    existing = {name for names in found for name in names}
    for name in re.findall(r"`([a-z]+(?:_[a-z]+)+)(?:\(\w*\))?`", text):
        assert name in existing, name


def _links(text: str) -> list[str]:
    """Targets in the text of a page, without what is code."""
    prose = re.sub(r"^(\s*)(```|~~~).*?^\s*\2\s*$|`[^`\n]*`", "", text, flags=re.MULTILINE | re.DOTALL)
    found = re.findall(r"\]\(\s*<?([^)\s>]+)", prose) + re.findall(
        r"^\[[^\]^]+\]:\s*(\S+)", prose, re.MULTILINE
    )
    return [one for one in found if not re.match(r"[a-z+.-]+:", one)]


def _anchors(text: str) -> set[str]:
    """Names of the headings of a page, as its table of contents makes them."""
    titles = re.findall(
        r"^#+ +(.+?)\s*#*$", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL), re.MULTILINE
    )
    seen: set[str] = set()
    for title in titles:
        slug = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).replace("`", "").replace("*", "")
        slug = re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", slug).strip().lower())
        count = sum(re.fullmatch(rf"{re.escape(slug)}(_\d+)?", one) is not None for one in seen)
        seen.add(f"{slug}_{count}" if count else slug)
    return seen


def test_every_relative_link_leads_to_a_page_of_the_site():
    """The site is built from ``docs`` alone: what a page links must lie there, with the heading it names."""
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        from hooks import notebook_page, on_page_markdown
    finally:
        sys.path.pop(0)
    docs = ROOT / "docs"
    pages = {path.with_suffix(".md"): notebook_page(path) for path in docs.glob("notebooks/*.ipynb")}
    for path in docs.rglob("*.md"):
        text = path.read_text(encoding="utf-8")
        pages[path] = text if "<!-- commands -->" in text else on_page_markdown(text)
    wrong = []
    for page, text in pages.items():
        for target in _links(text):
            name, _, anchor = target.partition("#")
            path = (page.parent / name).resolve() if name else page
            inside = path.is_relative_to(docs) and (path in pages or path.is_file())
            # Headings of the API and of verbs are made when the site is built.
            made = path.parent.name == "api" or path.name == "cli.md"
            if not inside or (anchor and not made and anchor not in _anchors(pages.get(path, ""))):
                wrong.append(f"{page.relative_to(ROOT)}: {target}")
    assert not wrong


def test_every_relative_link_of_the_repository_leads_to_a_file():
    for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        missing = [one for one in _links(text) if not (ROOT / one.partition("#")[0]).exists()]
        assert not missing, name
