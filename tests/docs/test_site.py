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
