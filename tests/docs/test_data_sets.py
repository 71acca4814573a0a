"""The commands of the page of data sets, if the data are available."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from tests.docs.test_blocks import PAGES
from tests.docs.test_commands import lines

from visuohaptic.cli.main import main

pytest.importorskip("av")

(PAGE,) = (page for page in PAGES if page.name == "data_sets.md")
#: Names of the page -> where the data lie.
FOLDERS = {
    "maps": "navigation/dev/maps",
    "apc_f200_shelf": "geometry/dev/apc_f200_shelf",
    "cleargrasp_d435": "geometry/dev/cleargrasp_d435",
    "oxford_graf": "sensing/oxford_graf",
}
#: Those that take seconds; the others are run by the tests of their packages on the same files.
QUICK = ("map inspect", "recording import apc", "recording info", "recording import clear", "template check")


@pytest.mark.data
def test_the_commands_open_the_data_sets(data: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    for name, place in FOLDERS.items():
        (tmp_path / name).symlink_to(data / place)
    shown = [line.removeprefix("visuohaptic ") for line in lines(PAGE.read_text())]
    quick = [line for line in shown if line.startswith(QUICK)]
    assert len(quick) == 6
    for line in quick:
        assert main(shlex.split(line)) == 0, (line, capsys.readouterr().err)
