"""The arguments that a verb reads are those that its parser declares."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

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
