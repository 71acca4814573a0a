"""Reading of JSON files: irregular files, files that are too large, invalid JSON and missing fields give a one-line error."""

import os

import pytest

from visuohaptic.core import InputError
from visuohaptic.core.files import load_json
from visuohaptic.io.depth.depth_import import import_sequence
from visuohaptic.recognition.touch import load_state_model
from visuohaptic.recognition.trees import load_tree


def doubled(data):
    return 2 * float(data["size"])


def test_what_a_reader_makes_of_a_file(tmp_path):
    path = tmp_path / "size.json"
    path.write_text('{"format": 3, "size": "1.5"}')
    assert load_json(path, "a size", doubled) == 3.0
    assert load_json(path, "a size", doubled, version=3) == 3.0
    with pytest.raises(InputError, match=r"size.json: found format 3, expected 4; measure it"):
        load_json(path, "a size", doubled, version=4, remedy="measure it")


@pytest.mark.parametrize(("own", "told"), [("", "measure it"), ("give metres", "give metres")])
def test_an_error_of_the_parser_has_its_remedy_or_that_of_the_file(tmp_path, own, told):
    path = tmp_path / "size.json"
    path.write_text("{}")

    def parse(data):
        raise InputError(path, "found 2000, expected less", field="size", remedy=own)

    with pytest.raises(InputError, match=rf"size.json: size: found 2000, expected less; {told}$"):
        load_json(path, "a size", parse, remedy="measure it")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not valid JSON"),
        ("[" * 100_000, "is not valid JSON"),  # as deep as no recursion goes
        ("{}", r"is not a size \('size'\); measure it"),
        ('{"size": [1]}', "is not a size"),
        ("[1]", "is not a size"),
        ('{"size": "ten"}', "is not a size"),
    ],
)
def test_other_contents_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "size.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as refused:
        load_json(path, "a size", doubled, remedy="measure it")
    assert "\n" not in str(refused.value)


def test_a_file_that_is_not_there_has_the_remedy_too(tmp_path):
    with pytest.raises(InputError, match=r"none.json: cannot be read \(.+\); measure it"):
        load_json(tmp_path / "none.json", "a size", doubled, remedy="measure it")


def test_large_files_are_refused_unread(tmp_path):
    path = tmp_path / "large.json"
    with path.open("wb") as stream:
        stream.truncate((256 << 20) + 1)  # holes, which take no place on the disk
    with pytest.raises(InputError, match=r"has 268435457 bytes, expected at most 268435456"):
        load_json(path, "a size", doubled)


@pytest.mark.parametrize("load", [load_tree, load_state_model])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, load):
    path = tmp_path / "pipe.json"
    os.mkfifo(path)
    # A writer that says nothing: who opens the pipe neither waits for one nor reads to an end.
    silent = os.open(path, os.O_RDWR)
    try:
        with pytest.raises(InputError, match="it is a pipe, expected a file"):
            load(path)
    finally:
        os.close(silent)


def test_fields_of_a_model_are_named_each_with_what_is_wrong(tmp_path):
    """A library's own text would be many lines, with addresses of its pages."""
    (tmp_path / "camera.json").write_text('{"width": "x", "height": 480, "fx": 600}')
    (tmp_path / "base_T_cam.txt").write_text("1 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n")
    (tmp_path / "depth").mkdir()
    with pytest.raises(
        InputError, match=r"camera\.json: fy: is missing; .*; width: found 'x', expected a whole number"
    ) as told:
        import_sequence(tmp_path, tmp_path / "out")
    assert "http" not in str(told.value)
