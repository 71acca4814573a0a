"""Every notebook runs completely, draws, and is stored without output."""

from __future__ import annotations

import json
import re
from pathlib import Path

import matplotlib as mpl
import pytest

pytest.importorskip("trimesh")
pytest.importorskip("av")

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def cells(path: Path, kind: str) -> list[str]:
    return [
        "".join(cell["source"]) for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == kind
    ]


def test_there_are_six_and_the_menu_has_them():
    assert len(NOTEBOOKS) == 6
    menu = (ROOT / "mkdocs.yml").read_text()
    assert all(f"notebooks/{path.stem}.md" in menu for path in NOTEBOOKS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.usefixtures("fewer_explorations")
def test_a_notebook_runs_and_draws(path, tmp_path, monkeypatch, request):
    monkeypatch.chdir(tmp_path)
    if any("write_example(" in code for code in cells(path, "code")):
        request.getfixturevalue("example_foam")
    mpl.use("Agg")
    from matplotlib import pyplot

    pyplot.close("all")
    names = {"__name__": "notebook"}
    codes = cells(path, "code")
    for number, code in enumerate(codes, 1):
        exec(compile(code, f"{path.name}, code cell {number}", "exec"), names)
    drawn = len(pyplot.get_fignums()) + sum("vh.force_over_time" in c or "error_budget({" in c for c in codes)
    pyplot.close("all")
    assert drawn >= 2
    assert any("assert " in code for code in codes), "what it must say"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_outputs_and_links_to_what_exists(path):
    notebook = json.loads(path.read_text())
    assert notebook["nbformat"] == 4
    assert all(not cell.get("outputs") and cell.get("execution_count") is None for cell in notebook["cells"])
    text = "\n".join(cells(path, "markdown"))
    assert text.startswith("# ")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (path.parent / target).exists(), target
