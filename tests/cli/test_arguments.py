"""The arguments that a verb reads are those that its parser declares."""

from __future__ import annotations

import argparse
import importlib
import re
from pathlib import Path

import pytest

from visuohaptic.cli._arguments import overwritten_file
from visuohaptic.cli._console import Arguments
from visuohaptic.cli.main import VERBS, verb_parser

#: Of the console, set by ``main``.
COMMON = {name for name in (*Arguments.__annotations__, *vars(Arguments)) if not name.startswith("_")}


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_reads_only_arguments_that_it_declares(verb):
    module = importlib.import_module(VERBS[verb][0])
    declared = {action.dest for action in verb_parser(verb, module)._actions}
    text = Path(module.__file__).read_text(encoding="utf-8")
    used = set(re.findall(r"\bargs\.([a-z_A-Z]+)", text))
    assert used - declared - COMMON == set()


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ({"data": "a.csv", "out": "sub/../a.csv"}, ("out", "a.csv, which is read")),
        ({"scans": ["b.csv", "a.csv"], "out": "a.csv"}, ("out", "a.csv, which is read")),
        ({"data": "b.csv", "out": "new.csv", "plot": "new.csv"}, ("plot", "new.csv, which --out writes")),
        ({"csv": "new.csv", "parquet": "new.csv"}, ("parquet", "new.csv, which --csv writes")),
        *(
            ({"data": "a.csv", name: "a.csv"}, (name, "a.csv, which is read"))
            for name in ("steps", "mask", "save")
        ),
        ({"data": "a.csv", "out": "b.csv"}, None),
        ({"beam": "a.csv", "data": "b.csv", "out": "a.csv"}, None),  # updated in its place
        ({"data": "sub", "out": "sub"}, None),  # folders
        ({"label": "a" * 300, "data": "a\0", "out": "b.csv"}, None),  # texts that are no names of files
    ],
)
def test_an_output_that_is_an_input_is_found(tmp_path, monkeypatch, names, found):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).touch()
    assert overwritten_file(argparse.Namespace(**names, tag=30.0, json=False)) == found


@pytest.mark.parametrize("verb", VERBS)
def test_no_number_of_a_verb_may_be_nan(verb):
    parser = verb_parser(verb, importlib.import_module(VERBS[verb][0]))
    numbers = [action for action in parser._actions if getattr(action.type, "__name__", "") == "float"]
    for action in numbers:
        with pytest.raises((argparse.ArgumentTypeError, ValueError)):
            action.type("nan")
        assert action.type("0.1") == pytest.approx(0.1)
