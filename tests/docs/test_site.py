"""Facts that the documentation repeats agree with the code."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

from visuohaptic import __version__
from visuohaptic.objects import Reason

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "visuohaptic"


def test_every_reason_has_its_remedy():
    page = (ROOT / "docs" / "howto" / "measure.md").read_text()
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == {str(reason) for reason in Reason}


def test_every_extra_is_explained():
    extras = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    page = (ROOT / "docs" / "getting_started.md").read_text()
    assert extras - {"all"} == set(re.findall(r"^\| `(\w+)` \| [a-zA-Z]", page, re.MULTILINE)) - {
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


PACKAGES = sorted(path.parent for path in SOURCE.glob("*/__init__.py") if path.parent.name != "cli")


def test_every_package_has_its_page_and_a_line_of_the_index():
    names = {package.name for package in PACKAGES}
    pages = {path.stem for path in (ROOT / "docs" / "api").glob("*.md")}
    assert names <= pages
    index = (ROOT / "docs" / "api" / "index.md").read_text()
    assert names <= set(re.findall(r"^\| \[`visuohaptic\.(\w+)`\]", index, re.MULTILINE))


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_no_page_of_a_package_is_empty(package):
    """The package exports names itself, or its page lists every public module."""
    page = (ROOT / "docs" / "api" / f"{package.name}.md").read_text()
    listed = set(re.findall(r"^::: visuohaptic\.([\w.]+)$", page, re.MULTILINE))
    assert listed
    if package.name in listed and "__all__" in (package / "__init__.py").read_text():
        return
    modules = {f"{package.name}.{path.stem}" for path in package.glob("[a-z]*.py")}
    unlisted = modules - listed
    assert not unlisted, f"docs/api/{package.name}.md lacks {sorted(unlisted)}"


def test_the_floors_are_those_of_the_contract():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = [set(layer.split(" | ")) for layer in settings["contracts"][0]["layers"]]
    page = (ROOT / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| (\d+) \| ([^|]+) \|", page, re.MULTILINE)
    assert [set(re.findall(r"`(\w+)`", names)) for _, names in rows] == layers[1:]  # above: __main__
    assert [int(floor) for floor, _ in rows] == list(range(len(rows)))[::-1]


def test_the_menu_names_pages_that_exist():
    menu = re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    assert menu
    assert [page for page in menu if not (ROOT / "docs" / page).is_file()] == []
