"""A missing extra is reported before anything is computed, with the command that installs it."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from visuohaptic.cli._extras import BY_ARGUMENT, BY_ENDING, OPTIONAL, needs
from visuohaptic.cli.main import VERBS, verb_parser
from visuohaptic.reproduce import EXPERIMENTS
from visuohaptic.reproduce import NEEDS as EXPERIMENT_NEEDS

pytestmark = pytest.mark.skipif(os.name != "posix", reason="an alarm of POSIX ends what computes")

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """Every example of every verb, in an empty folder of a process that has the core only."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "cli" / "bare_core.py")],
        cwd=tmp_path_factory.mktemp("bare"), env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


def test_every_verb_is_tried(runs):
    assert {run["verb"] for run in runs} == set(VERBS)


def test_no_verb_shows_an_import_that_failed(runs):
    for run in runs:
        assert "ModuleNotFoundError" not in run["error"], run
        assert "unexpected" not in run["error"], run
        assert run["code"] in {0, 2, 130}, run


def test_what_is_missing_is_said_before_anything_is_written(runs):
    """One line with the packages and an install line; a progress line would be work already."""
    written: list[str] = []
    wanted = [run for run in runs if run["declared"]]
    assert {"demo", "reproduce", "objects list", "view"} <= {run["verb"] for run in wanted}
    packages = {library.module: library.package for library in OPTIONAL}
    for run in runs:
        if run["declared"]:
            assert run["code"] == 2, run
            assert len(run["error"].splitlines()) == 1, run
            assert all(f"'{packages[module]}'" in run["error"] for module in run["declared"]), run
            found = re.search(r"run: pip install 'visuohaptic\[([a-z,]+)\]'$", run["error"].strip())
            assert found, run
            assert set(found[1].split(",")) <= EXTRAS
            assert run["written"] == written, run
        written = run["written"]


def test_arguments_need_modules_by_name_and_by_ending():
    module = SimpleNamespace(NEEDS=("zenoh",))
    none = SimpleNamespace(plot=None, view=False, out=Path("a.csv"), names=["x"], source="camera:0")
    assert needs(module, none) == {"zenoh"}
    some = SimpleNamespace(plot=Path("a.png"), view=True, out=Path("A.MCAP"), names=["x.mp4"])
    assert needs(module, some) == {"zenoh", "matplotlib", "viser", "mcap_ros2", "av"}
    assert needs(SimpleNamespace(), SimpleNamespace(source="run.mcap:/camera/image")) == {"mcap_ros2"}


def test_a_verb_adds_what_its_own_arguments_need():
    def modules(verb: str, *words: str) -> frozenset[str]:
        module = importlib.import_module(VERBS[verb][0])
        return needs(module, verb_parser(verb, module).parse_args(words))

    assert modules("reproduce", "3.4", "--out", "a") == {"matplotlib"}
    assert modules("reproduce", "3.4", "table-4.1", "--out", "a") == {"matplotlib", "mujoco"}
    assert modules("reproduce", "all", "--out", "a") >= {"matplotlib", "mujoco", "skimage", "sklearn"}
    assert modules("objects recognise", "--prior", "a.npz", "--image", "a.png") == frozenset()
    assert modules("objects recognise", "--cloud", "a.ply") == {"small_gicp", "pyarrow", "sqlalchemy"}


def test_the_demo_extra_brings_what_the_demo_needs():
    extras = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    (text,) = extras["demo"]
    brought = set(re.search(r"\[(.*)\]", text)[1].split(","))
    module = importlib.import_module(VERBS["demo"][0])
    asked = needs(module, verb_parser("demo", module).parse_args(["--view"]))
    assert {library.extra for library in OPTIONAL if library.module in asked} <= brought


def test_every_need_is_a_library_of_the_table():
    known = {library.module for library in OPTIONAL}
    tables = (*BY_ARGUMENT.values(), *BY_ENDING.values(), *EXPERIMENT_NEEDS.values())
    assert {name for names in tables for name in names} <= known
    assert set(EXPERIMENT_NEEDS) <= set(EXPERIMENTS)
