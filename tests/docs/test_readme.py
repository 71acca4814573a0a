"""The README renders on a package index, with valid links."""

from __future__ import annotations

import importlib.util
import re
import sys
import tomllib
import types
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def test_it_begins_with_what_a_stranger_looks_for():
    """A moving picture, how to install, lines that give newtons, a plot, two commands, in this order."""
    marks = ["docs/images/push.webp", "docs/images/glass.webp", "pip install", "demo --quick", "visuohaptic start",
             "vh.FoamSensor.load", "docs/images/force.png", "make demo", "make test", "docs/trust.md"]  # fmt: skip
    places = [TEXT.index(mark) for mark in marks]
    assert places == sorted(places)
    (block,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    assert len([line for line in block.splitlines() if line.strip()]) == 5


def test_its_pictures_are_small():
    for target in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", TEXT):
        assert (ROOT / target).stat().st_size < 1_500_000


def test_it_renders_as_markdown_with_tables_code_and_pictures():
    from markdown_it import MarkdownIt

    page = MarkdownIt("commonmark", {"html": False}).enable("table").render(TEXT)
    assert page.count("<img") == 3
    assert "<table>" in page
    assert "<code" in page
    assert "<h1>visuohaptic</h1>" in page


def _hook_module() -> Any:
    path = ROOT / tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["metadata"]["hooks"]["custom"]["path"]  # fmt: skip
    spec = importlib.util.spec_from_file_location("pypi_readme", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_links_become_absolute_for_a_package_index():
    text = _hook_module().absolute(TEXT, "https://host.example/owner/repository")
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    assert targets
    assert all(target.startswith("https://host.example/owner/repository/") for target in targets)
    assert "(https://host.example/owner/repository/raw/main/docs/images/push.webp)" in text


def test_a_wheel_has_the_links_of_the_repository_that_is_named(monkeypatch: pytest.MonkeyPatch):
    plugin = types.ModuleType("hatchling.metadata.plugin.interface")
    plugin.MetadataHookInterface = object
    monkeypatch.setitem(sys.modules, "hatchling.metadata.plugin.interface", plugin)
    hook, found = _hook_module().get_metadata_hook()(), {}
    hook.update(found)
    assert found["readme"] == {"content-type": "text/markdown", "text": TEXT}
    monkeypatch.setenv("VISUOHAPTIC_REPOSITORY", "https://host.example/owner/repository")
    hook.update(found)
    assert "](https://host.example/owner/repository/blob/main/docs/trust.md)" in found["readme"]["text"]
    assert "](docs/" not in found["readme"]["text"]
