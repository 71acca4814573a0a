"""Scripts with which a shell completes: bash is asked, the others at least parse where they are installed."""

from __future__ import annotations

import importlib
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from visuohaptic.cli.main import VERBS, main, verb_parser


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    from contextlib import redirect_stdout

    folder, found = tmp_path_factory.mktemp("shells"), {}
    for shell in ("bash", "zsh", "fish"):
        found[shell] = folder / shell
        with found[shell].open("w") as stream, redirect_stdout(stream):
            assert main(["completion", shell]) == 0
    return found


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_verbs_options_and_choices(scripts: dict[str, Path]) -> None:
    expected = {
        "visuohaptic gr": "grasp",
        "visuohaptic map ''": "inspect build graph",
        "visuohaptic map b": "build",
        "visuohaptic grasp can.stl --state ''": "open closed",
        "visuohaptic grasp can.stl --max-f": "--max-force",
        "visuohaptic example task ''": "cap room",
        "visuohaptic example task --out ''": "",  # a file
        "visuohaptic completion ''": "bash zsh fish",
    }
    asked = "".join(
        f'COMP_WORDS=({line}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); _visuohaptic; echo "${{COMPREPLY[*]}}"\n'
        for line in expected
    )
    script = scripts["bash"].read_text() + asked
    done = subprocess.run(["bash"], input=script, capture_output=True, text=True, check=True)
    assert dict(zip(expected, done.stdout.split("\n"), strict=False)) == expected


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_option_is_there(shell: str, scripts: dict[str, Path]) -> None:
    text = scripts[shell].read_text()
    for verb, (module, _) in VERBS.items():
        options = verb_parser(verb, importlib.import_module(module))._option_string_actions
        for flag in options:
            assert (
                f"-l {flag[2:]} " if shell == "fish" and flag.startswith("--") else flag.strip("-")
            ) in text
    if shutil.which(shell):
        subprocess.run([shell, "-n", str(scripts[shell])], check=True)
    assert all(len(shlex.split(line)) > 6 for line in text.splitlines() if line.startswith("complete -c"))
