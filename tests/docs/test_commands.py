"""Every command line in the documentation is accepted by the parser."""

from __future__ import annotations

import importlib
import re
import shlex

import pytest
from tests.docs.test_blocks import PAGES

from visuohaptic.cli.main import VERBS, verb_parser
from visuohaptic.core import VisuohapticError

FENCE = re.compile(r"^ *```(?:text|sh|bash|console)?\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`(?:\.venv/bin/)?(visuohaptic [^`]+)`")


def lines(text: str) -> list[str]:
    """Whole command lines of the blocks, without what is said behind them."""
    joined = [re.sub(r"\\\n *", "", block) for block in FENCE.findall(text)]
    shown = [line.strip() for block in joined for line in block.splitlines()]
    # A comment follows a sharp, or stands in a column of its own.
    return [re.split(r"\s{2,}|\s#", line)[0] for line in shown if line.startswith("visuohaptic ")]


def parsed(line: str) -> str:
    """What is wrong with a command line; empty when the verb's parser takes it."""
    words = shlex.split(line)[1:]
    verb = next((name for name in (" ".join(words[:2]), words[0]) if name in VERBS), None)
    if verb is None:
        return f"no verb in {line!r}"
    parser = verb_parser(verb, importlib.import_module(VERBS[verb][0]))
    try:
        parser.parse_args(words[len(verb.split()) :])
    except VisuohapticError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("page", [p for p in PAGES if lines(p.read_text())], ids=lambda page: page.name)
def test_command_lines_of_a_page_have_what_their_verbs_require(page):
    wrong = {line: problem for line in lines(page.read_text()) if (problem := parsed(line))}
    assert wrong == {}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_verbs_and_flags_named_in_a_sentence_exist(page):
    for text in INLINE.findall(re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)):
        words = text.split()[1:]
        verbs = [name for name in VERBS if f"{' '.join(words)} ".startswith(f"{name} ")]
        groups = [name for name in VERBS if name.startswith(f"{words[0]} ")]
        assert verbs or (groups and len(words) == 1), f"{page.name} names {text!r}"
        for verb in verbs:
            flags = verb_parser(verb, importlib.import_module(VERBS[verb][0])).format_help()
            for flag in re.findall(r"(?<!\S)--[\w-]+", text):
                assert re.search(rf"{flag}\b", flags), f"{page.name}: {verb} has no {flag}"


def test_the_search_finds_lines_and_what_is_wrong_with_them():
    text = (
        "```text\nvisuohaptic doctor   tries all\nvisuohaptic map graph a.yaml \\\n  --out b  # no radius\n```\n"
        "```yaml\nfoam: x  # visuohaptic calibrate foam\n```\n"
    )
    first, second = lines(text)
    assert (first, parsed(first)) == ("visuohaptic doctor", "")
    assert second == "visuohaptic map graph a.yaml --out b"
    assert "required: --radius" in parsed(second)
    assert "unrecognized arguments: --quick" in parsed("visuohaptic doctor --quick")
    assert "no verb" in parsed("visuohaptic heal")
