"""Typical mistakes of new users: rejected or reported in one line that says what to do."""

from __future__ import annotations

import pytest
from tests.cli.misuses import MISUSES, add_files, respond

pytest.importorskip("av")


@pytest.fixture(scope="module")
def example(tmp_path_factory, world):
    """The files of the first hour."""
    folder = world.copy_recording(tmp_path_factory.mktemp("misuse"))
    add_files(folder)
    return folder


def test_there_are_twenty_and_more():
    assert len(MISUSES) >= 20


@pytest.mark.parametrize("name", MISUSES)
def test_a_misuse_is_refused_or_told(example, tmp_path, name):
    response = respond(MISUSES[name], example, tmp_path / "copy")
    assert not response.faults, response
