"""Every Python block of the documentation runs, in the order of its page, and its assertions hold."""

from __future__ import annotations

import ast
import builtins
import re
import shutil
from pathlib import Path

import pytest
from tests.docs.names import unknown_names

from visuohaptic.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])

#: A fenced block, at any indentation; the tag ``notest`` after the language leaves it out.
BLOCK = re.compile(
    r"^(?P<indent> *)```python(?P<tag>[^\n]*)\n(?P<code>.*?)^(?P=indent)```", re.MULTILINE | re.DOTALL
)


def blocks(text: str, *, run: bool = True) -> list[tuple[int, str]]:
    """Line number and code of each block that has to run, or of each that is only read."""
    found = []
    for match in BLOCK.finditer(text):
        if ("notest" in match["tag"].split()) is not run:
            indent = len(match["indent"])
            code = "".join(line[indent:] for line in match["code"].splitlines(keepends=True))
            found.append((text.count("\n", 0, match.start()) + 2, code))
    return found


@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page.read_text())], ids=lambda page: page.name
)
@pytest.mark.usefixtures("fewer_explorations")
def test_blocks_of_a_page_run_in_order(page, tmp_path, monkeypatch, request):
    monkeypatch.chdir(tmp_path)
    if page.name == "README.md":  # its commands come before its block
        first, *others = re.findall(r"`visuohaptic ((?:example|calibrate) [^`]+)`", page.read_text())
        assert first == "example foam --out try"  # what it writes was written by the example of its help
        shutil.copytree(request.getfixturevalue("world").run("example foam")[0] / "try", tmp_path / "try")
        for line in others:
            assert main(line.split()) == 0
    if "write_example(" in page.read_text():
        request.getfixturevalue("example_foam")
    names = {"__name__": f"docs_{page.stem}"}
    for line, code in blocks(page.read_text()):
        # Empty lines in front make a failure point at the line of the page.
        exec(compile("\n" * (line - 1) + code, str(page), "exec"), names)


def test_each_of_the_five_jobs_takes_at_most_eight_lines():
    text = (ROOT / "docs" / "five_jobs.md").read_text()
    jobs = [match["code"] for match in BLOCK.finditer(text) if match["tag"].strip() == "job"]
    assert len(jobs) == 5
    for code in jobs:
        assert len([line for line in code.splitlines() if line.strip()]) <= 8, code
        # Who skips the boxes has their files, not their names; these are of one's own robot and objects.
        nodes = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)]
        own = {"np", "vh", "probe", "stiffness_N_per_m", "width_m"}
        made = {node.id for node in nodes if isinstance(node.ctx, ast.Store)} | own | set(dir(builtins))
        assert {node.id for node in nodes} <= made, code


@pytest.mark.parametrize(
    "page", [page for page in PAGES if blocks(page.read_text(), run=False)], ids=lambda page: page.name
)
def test_blocks_that_are_not_run_name_what_exists(page):
    for line, code in blocks(page.read_text(), run=False):
        assert unknown_names(code) == [], f"{page.name}, line {line}"


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("from visuohaptic.viewer import LifePage", "cannot import name 'LifePage'"),
        ("for f in frames:\n    p = sensor.measure(f)", "sensor of sensor.measure is not defined"),
        ("from visuohaptic.sensing.foam import FoamSensor\ns = FoamSensor.load('a')\ns.measure(1)",
         "s.measure: FoamSensor has no measure"),
        ("from visuohaptic.sensing.foam import FoamSensor\nFoamSensor.open('a')", "FoamSensor.open does not exist"),
        ("from visuohaptic.io import open_camera\nwith open_camera('0') as c:\n    c.newest()",
         "c.newest: LiveSource has no newest"),
        ("from visuohaptic.io import open_source\nopen_source('a', gray=True)",
         "open_source has no argument gray"),
    ],
)  # fmt: skip
def test_a_name_that_does_not_exist_is_found(code, problem):
    (found,) = unknown_names(code)
    assert problem in found


def test_the_search_finds_blocks_and_leaves_out_those_that_are_not_to_run():
    text = (
        "a\n```python\nx = 1\n```\n```python notest\ny\n```\n"
        "1. b\n   ```python\n   z = 2\n   ```\n```text\nno\n```\n"
    )
    assert blocks(text) == [(3, "x = 1\n"), (10, "z = 2\n")]
    assert blocks(text, run=False) == [(6, "y\n")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_of_a_page_exist(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}, which is not there"


def test_no_page_loads_anything_from_elsewhere():
    for page in PAGES:
        assert not re.search(r"!\[[^\]]*\]\(https?://", page.read_text()), f"{page.name} loads a picture"
