"""YAML of unknown origin: limited in size, numbers in base 10, one-line errors."""

from __future__ import annotations

import os
import socket

import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files import load_yaml, parse_yaml

from .hostile import refusal

#: 8^9 = 134 million values in 450 bytes.
BOMB = (
    "[&a0 [1, 1, 1, 1, 1, 1, 1, 1]"
    + "".join(f", &a{k} [{', '.join([f'*a{k - 1}'] * 8)}]" for k in range(1, 9))
    + "]"
)
LONG = "59" + ":59" * 200_000  # base 60: quadratic in the number of digits
ROBOT = "visuohaptic.navigation.problem.objects_file:load_robot(path)"
OBJECTS = "visuohaptic.navigation.problem.objects_file:load_objects(path)"
CARD = "visuohaptic.database.exchange:import_object(path)"
CARD_HEAD = "format: visuohaptic object\nversion: 1\nlicence: CC0-1.0\nobject: "
SQUARE = "footprint_m: [[0, 0], [1, 0], [1, 1]]"


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (ROBOT, f"radius_m: {BOMB}"),
        (ROBOT, f"radius_m: {LONG}"),
        (ROBOT, f"radius_m: {'7' * 30}"),
        (ROBOT, f"radius_m: !!int {LONG}"),
        (ROBOT, f"radius_m: !!float {LONG}"),
        (ROBOT, "radius_m: !!timestamp soon"),
        (ROBOT, "radius_m: &a [*a]"),
        (OBJECTS, f"objects: [{{id: {BOMB}, {SQUARE}}}]"),
        (OBJECTS, f"objects: [{{id: a, {SQUARE}, haptic_tag: {{static_friction_N: {BOMB}}}}}]"),
        (CARD, CARD_HEAD + f"{{id: {BOMB}}}\n"),
        (CARD, CARD_HEAD + f"{{id: a, evidence: {BOMB}}}\n"),
        (CARD, CARD_HEAD + f"{{id: a, state: {{x: {BOMB}}}}}\n"),
    ],
)
def test_what_multiplies_is_refused_in_small_memory(tmp_path, call, text):
    path = tmp_path / "input.yaml"
    path.write_text(text)
    refusal(call, path)


def test_aliases_are_counted_before_they_are_expanded():
    """Values and characters: neither many short ones nor a long text many times."""
    with pytest.raises(InputError, match="aliases that expand to more than 1000000"):
        parse_yaml(BOMB, "b.yaml")
    with pytest.raises(InputError, match="aliases"):
        parse_yaml(f"[&a {'x' * 100_000}{', *a' * 11}]", "b.yaml")  # adds 1.1 million characters
    assert len(parse_yaml(f"[&a {'x' * 100_000}{', *a' * 9}]", "b.yaml")) == 10  # 0.9 million
    bases = ", ".join(["*a"] * 20)
    assert parse_yaml(f"base: &a {{k: 1}}\nall: {{<<: [{bases}]}}", "b.yaml")["all"] == {"k": 1}


def test_a_literal_file_may_be_larger_than_what_aliases_may_add():
    text = "[" + ", ".join(["abcdefghij" * 100] * 1_100) + "]"  # 1.1 million values and characters
    assert len(parse_yaml(text, "l.yaml")) == 1_100


def test_numbers_are_read_in_base_10_and_stay_what_they_were():
    found = parse_yaml(
        "[1:30, 59:59.5, 12, -0x1F, 0b11, 017, 1_000, 1.5e+3, .5, -.inf, 1e-3, 2026-01-02]", "n"
    )
    assert found[:2] == ["1:30", "59:59.5"]
    assert found[2:7] == [12, -31, 3, 15, 1000]
    assert found[7:10] == pytest.approx([1500.0, 0.5, float("-inf")])
    assert found[10] == "1e-3"  # YAML 1.1; our readers of numbers convert it
    with pytest.raises(InputError, match="64 bits"):
        parse_yaml(str(2**64), "n")
    assert parse_yaml(str(2**64 - 1), "n") == 2**64 - 1


def test_a_number_may_have_a_hundred_characters_and_no_more():
    assert parse_yaml(f"n: 1.{'0' * 98}", "x.yaml") == {"n": 1.0}
    with pytest.raises(InputError, match="a number of 101 characters, expected at most 100"):
        parse_yaml(f"n: 1.{'0' * 99}", "x.yaml")


def test_the_line_is_named():
    with pytest.raises(InputError, match=r"f.yaml: line 3: .*base 60"):
        parse_yaml("a: 1\nb: 2\nc: !!int 1:30\n", "f.yaml")


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "socket"])
def test_special_files_are_refused_before_they_are_opened(tmp_path, kind):
    path = tmp_path / "x.yaml"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        with socket.socket(socket.AF_UNIX) as made:
            here = os.getcwd()
            os.chdir(tmp_path)  # the path of a socket is limited to 107 characters
            try:
                made.bind(path.name)
            finally:
                os.chdir(here)
    for call in (
        "visuohaptic.core.files:load_yaml(path)",
        "visuohaptic.core.files:read_image(path)",
        "visuohaptic.core.files:read_npz(path, 'arrays')",
        "visuohaptic.io:OccupancyMap.load(path)",
        "visuohaptic.io.meshes.ply:read_ply(path)",
    ):
        assert f"it is a {kind}" in refusal(call, path)
    if kind != "folder":  # of images
        assert f"it is a {kind}" in refusal("visuohaptic.io:open_source(path)", path)


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        load_yaml(tmp_path / "no.yaml")
