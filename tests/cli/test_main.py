"""Behaviour of the command line, with verbs defined for the test."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from visuohaptic._version import __version__
from visuohaptic.cli.main import VERBS, main
from visuohaptic.core import InputError


@pytest.fixture
def verbs(monkeypatch):
    """A registry of made-up verbs; ``behave`` decides what the verb 'touch box' does."""

    def register(name, run, **more):
        module = types.ModuleType(f"fake_{name.replace(' ', '_')}")
        module.__doc__ = (
            "A verb.\n\nreads   a box\nwrites  a tag\n\nexample: visuohaptic touch box --force 3\n"
        )
        module.run = run
        module.add_arguments = lambda add: add("--force", 1.0, "in newtons")
        for key, value in more.items():
            setattr(module, key, value)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        registry[name] = (module.__name__, f"help of {name}")
        return registry

    registry: dict[str, tuple[str, str]] = {}
    register("stand", lambda args: None)
    register.registry = registry
    return register


def fail_with(error):
    def run(args):
        raise error

    return run


def one_line(text: str) -> str:
    assert text.count("\n") == 1
    assert text.startswith("visuohaptic: error: ")
    assert "Traceback" not in text
    return text.removeprefix("visuohaptic: error: ").rstrip("\n")


def test_overview_lists_every_verb_without_importing_one(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")  # not folded
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for verb, (_, text) in VERBS.items():
        assert verb in out
        assert text in out


@pytest.mark.parametrize("words", [["--help"], ["plan", "--help"], ["sense", "foam", "--help"]])
def test_help_is_folded_to_the_terminal_and_commands_are_not(words, capsys, monkeypatch):
    texts = []
    for columns in ("80", "200"):
        monkeypatch.setenv("COLUMNS", columns)
        with contextlib.suppress(SystemExit):
            main(words)
        texts.append(capsys.readouterr().out)
    narrow, wide = texts
    assert [line for line in narrow.splitlines() if len(line) > 80 and "visuohaptic " not in line] == []
    assert narrow.split() == wide.split()  # no word is lost


def test_no_words_print_the_overview(capsys):
    assert main([]) == 0
    assert "usage: visuohaptic VERB" in capsys.readouterr().out


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"visuohaptic {__version__}\n"


def test_json_has_stdout_for_itself(verbs, capsys):
    def run(args):
        args.report("felt it")
        return {
            "force_N": np.float32(args.force),
            "sigma_N": float("nan"),
            "valid": np.True_,
            "s_m": np.arange(3) * 0.5,
            "out": Path("a") / "b",
        }

    registry = verbs("touch box", run)
    assert main(["--json", "touch", "box", "--force", "3"], registry) == 0
    first = capsys.readouterr()
    assert main(["touch", "box", "--force=3", "--json"], registry) == 0
    assert capsys.readouterr().out == first.out
    assert json.loads(first.out) == {
        "force_N": 3.0,
        "sigma_N": None,
        "valid": True,
        "s_m": [0.0, 0.5, 1.0],
        "out": str(Path("a") / "b"),
    }
    assert first.err == "felt it\n"


def test_reports_are_for_people_on_stdout(verbs, capsys):
    registry = verbs("touch box", lambda args: args.report("felt it") or {"force_N": 1})
    assert main(["touch", "box"], registry) == 0
    assert capsys.readouterr().out == "felt it\n"
    assert main(["touch", "box", "--quiet"], registry) == 0
    assert capsys.readouterr().out == ""


def test_a_verb_that_reports_nothing_has_its_result_printed(verbs, capsys):
    result = {
        "file": "a.mcap",
        "duration_s": 1.5,
        "size": [3, 4],
        "whole": True,
        "topics": [{"name": "/a", "n": None}],
    }
    registry = verbs("touch box", lambda args: result)
    assert main(["touch", "box"], registry) == 0
    assert capsys.readouterr().out.splitlines() == [
        "file: a.mcap",
        "duration: 1.5 s",
        "size: 3, 4",
        "whole: yes",
        "topics",
        "  1.",
        "    name: /a",
        "    n: none",
    ]
    assert main(["touch", "box", "--quiet"], registry) == 0
    assert capsys.readouterr().out == ""


def test_bad_input_is_one_line_and_code_2(verbs, capsys):
    error = InputError("foam.csv", "found 'x',\nexpected a number", field="line 3, strain")
    assert main(["touch", "box"], verbs("touch box", fail_with(error))) == 2
    text = one_line(capsys.readouterr().err)
    assert text == "foam.csv: line 3, strain: found 'x', expected a number"


def test_a_missing_file_is_bad_input(verbs, capsys):
    registry = verbs("touch box", lambda args: Path("no_such.yaml").read_text())
    assert main(["touch", "box"], registry) == 2
    assert one_line(capsys.readouterr().err) == "no_such.yaml: No such file or directory"


def test_our_own_mistake_is_code_1_and_shows_its_place_when_asked(verbs, capsys):
    registry = verbs("touch box", fail_with(ZeroDivisionError("oh")))
    assert main(["touch", "box"], registry) == 1
    assert "--verbose" in one_line(capsys.readouterr().err)
    assert main(["touch", "box", "--verbose"], registry) == 1
    assert "Traceback" in capsys.readouterr().err


def test_interruption_is_code_130(verbs, capsys):
    assert main(["touch", "box"], verbs("touch box", fail_with(KeyboardInterrupt()))) == 130
    assert one_line(capsys.readouterr().err) == "interrupted"


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["toch", "box"], "unknown verb 'toch box'; did you mean 'touch box'?"),
        (["xyz"], "unknown verb 'xyz'; see visuohaptic --help"),
        (["touch", "bx"], "unknown verb 'touch bx'; did you mean 'touch box'?"),
        (["touch"], "touch: incomplete verb, expected 'touch box'"),
        (["touch", "box", "--force", "much"], "touch box: argument --force: invalid float value: 'much'"),
        (["touch", "box", "--forc", "1"], "touch box: unrecognized arguments: --forc 1"),
        (["--loud", "stand"], "unknown option --loud before the verb"),
    ],
)
def test_usage_errors_name_what_is_expected(verbs, capsys, words, expected):
    assert main(words, verbs("touch box", lambda args: None)) == 2
    assert one_line(capsys.readouterr().err).startswith(expected)


def test_help_of_a_verb_has_its_example(verbs, capsys):
    registry = verbs("touch box", lambda args: None)
    assert main(["touch", "box", "--help"], registry) == 0
    out = capsys.readouterr().out
    assert "Help of touch box." in out
    assert "example: visuohaptic touch box --force 3" in out
    assert main(["touch", "--help"], registry) == 0
    assert "help of touch box" in capsys.readouterr().out


def test_a_verb_may_bring_its_own_json_flag(verbs, capsys):
    def add_arguments(add):
        add("--json", bool, "its own")

    registry = verbs("touch box", lambda args: {"done": 1}, add_arguments=add_arguments)
    assert main(["touch", "box", "--json"], registry) == 0
    assert json.loads(capsys.readouterr().out) == {"done": 1}


def test_a_verb_of_a_later_version_says_so(capsys):
    assert main(["fly"], {"fly": ("visuohaptic.cli.no_such_verb", "")}) == 2
    assert "'fly' is not part of this version" in one_line(capsys.readouterr().err)


def test_a_missing_library_says_what_to_install(tmp_path, monkeypatch, capsys):
    (tmp_path / "needs_av.py").write_text("raise ModuleNotFoundError('No module', name='av')")
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["see"], {"see": ("needs_av", "")}) == 2
    assert "pip install 'visuohaptic[recording]'" in one_line(capsys.readouterr().err)


def test_numpy_is_not_imported_before_a_verb_runs():
    script = (
        "import sys; from visuohaptic.cli.main import main; main(['--help']); "
        "heavy = {'numpy', 'cv2', 'rich', 'numba', 'scipy', 'pydantic'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", script], check=True, stdout=subprocess.DEVNULL)


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_reader_that_goes_away_is_no_error():
    script = (
        "import sys, types; m = types.ModuleType('talk'); m.add_arguments = lambda p: None\n"
        "m.run = lambda args: [args.report('x' * 1000) for _ in range(1000)] and None\n"
        "sys.modules['talk'] = m\n"
        "from visuohaptic.cli.main import main; sys.exit(main(['talk'], {'talk': ('talk', '')}))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    complaint = process.stderr.read()
    assert process.wait(timeout=120) == 141
    assert complaint == ""


@pytest.mark.parametrize("verb", list(VERBS))
def test_every_verb_that_is_there_says_what_it_reads_and_writes(verb, capsys):
    code = main([*verb.split(), "--help"])
    captured = capsys.readouterr()
    if code == 2 and "not part of this version" in captured.err:
        pytest.skip(captured.err.strip())
    assert code == 0
    for word in ("reads", "writes", f"visuohaptic {verb}"):
        assert word in captured.out.lower(), f"{verb} --help does not say what it {word}"


def test_the_package_runs_as_a_module():
    """Where the script is not on the path."""
    done = subprocess.run(
        [sys.executable, "-m", "visuohaptic", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == f"visuohaptic {__version__}"


def test_missing_memory_is_told_in_one_line(verbs, capsys):
    verbs("touch box", fail_with(MemoryError("Unable to allocate 9 GiB")))
    assert main(["touch", "box"], verbs=verbs.registry) == 2
    assert "memory does not suffice (Unable to allocate 9 GiB)" in one_line(capsys.readouterr().err)
