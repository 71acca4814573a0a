"""The arguments that a verb reads are those that its parser declares."""

from __future__ import annotations

import argparse
import ast
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


def refused(tree: ast.AST) -> set[str]:
    """Options in calls of ``refuse``, written there or as a text with a name."""
    texts = {
        target.id: node.value.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args]
    options = [call.args[0] for call in calls if getattr(call.func, "attr", "") == "refuse"]
    names = [texts[one.id] if isinstance(one, ast.Name) else ast.literal_eval(one) for one in options]
    return set(" ".join(names).split())


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_refuses_only_options_that_it_has(verb):
    """An option with another spelling, or a second name of it, would never be refused."""
    module = importlib.import_module(VERBS[verb][0])
    options = {one.option_strings[0] for one in verb_parser(verb, module)._actions if one.option_strings}
    assert refused(ast.parse(Path(module.__file__).read_text(encoding="utf-8"))) <= options


def test_refused_options_are_found():
    text = "WORDS = '--a --b'\ndef run(args):\n    args.refuse(WORDS, 'x')\n    args.refuse('--c', 'y')"
    assert refused(ast.parse(text)) == {"--a", "--b", "--c"}


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
