"""Launch files without ROS: their contents, invalid files, and joint termination of all processes."""

from __future__ import annotations

import itertools
import os
import sys
import threading
import time
from pathlib import Path

import pytest

from visuohaptic.cli.main import main
from visuohaptic.core import DeviceError, InputError
from visuohaptic.ros import nodes
from visuohaptic.ros.nodes import NODES, declared, node_kind, read_launch, run_launch
from visuohaptic.ros.nodes.parameters import given as parameter_values

OWN = sorted((Path(nodes.__file__).parent / "launch_files").glob("*.launch.xml"))


@pytest.mark.parametrize(
    ("command", "words"),
    [
        # As launch documents the text between substitutions: $(find-pkg-prefix csd)/asd bsd dsd xsd
        ("$(var p)/asd bsd dsd xsd", ("a b/asd", "bsd", "dsd", "xsd")),
        ("$(var p) $(var q)", ("a b", "it's 1")),
        ("$(var p)$(var q)", ("a bit's 1",)),
        ("exec  $(var p) ", ("exec", "a b")),
        ("exec --to:=$(var p)x 'one word' y:=$(var none)", ("exec", "--to:=a bx", "one word", "y:=")),
        ("exec $(var none) z", ("exec", "", "z")),
    ],
)
def test_words_are_those_of_ros2_launch(tmp_path: Path, command: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "a.launch.xml"
    path.write_text(
        '<launch><!-- two --><arg name="p"/><arg name="q" default="no"/><arg name="none" default=""/>'
        f'<executable cmd="{command}"/><executable cmd=\'two\' output="screen"/></launch>'
    )
    assert read_launch(path, {"p": "a b", "q": "it's 1"}) == (words, ("two",))


@pytest.mark.parametrize("path", OWN, ids=lambda path: path.name)
def test_those_of_the_library_name_nodes_and_their_parameters(path: Path) -> None:
    given = {"config": "sensor.yaml"} | ({"robot": "robot.yaml"} if "platform" in path.name else {})
    for words in read_launch(path, given):
        assert words[:3] == ("visuohaptic", "ros", "node")
        known = {parameter.name for parameter in declared(node_kind(words[3]).parameter_model)}
        named = {word.partition(":=")[0] for flag, word in itertools.pairwise(words) if flag == "--param"}
        assert named <= known
        # What is empty by default is a value that the node takes.
        values = [word for flag, word in itertools.pairwise(words) if flag == "--param"]
        assert parameter_values(values, node_kind(words[3]).parameter_model, words[3])
    assert {"foam", "travel"} <= NODES.keys()


@pytest.mark.parametrize(
    ("text", "given", "words"),
    [
        ("<launch>", {}, "is not XML"),
        ('<launch><arg name="a"/></launch>', {}, "a: needs a value, give a:=VALUE"),
        ('<launch><arg name="a" default="1"/></launch>', {"b": "1"}, "has no argument b; it has a"),
        ("<launch><node pkg='x'/></launch>", {}, "found <node>, expected <arg> or <executable>"),
        ("<launch><executable cmd='$(var c)'/></launch>", {}, r"uses \$\(var c\)"),
        ("<launch/>", {}, "has no <executable>"),
        ("<robot/>", {}, "found <robot>, expected <launch>"),
        # Refused by ros2 launch, too: each piece of text is split on its own.
        (
            "<launch><arg name='a' default=''/><executable cmd=\"x '$(var a)'\"/></launch>",
            {},
            "unterminated quote",
        ),
        # Understood by ros2 launch alone.
        ("<launch><executable cmd='x $(env HOME)'/></launch>", {}, "expected no substitution but"),
        (
            "<launch><executable cmd='x' cwd='/'/></launch>",
            {},
            "found cwd in <executable>, expected cmd, name, output",
        ),
        (
            "<launch><executable cmd='x'><env name='a'/></executable></launch>",
            {},
            "found <env> in <executable>",
        ),
        ('<!DOCTYPE a [<!ENTITY b "c">]><launch/>', {}, "document type or entities"),
    ],
)
def test_what_cannot_be_run_is_refused(tmp_path: Path, text: str, given: dict[str, str], words: str) -> None:
    path = tmp_path / "a.launch.xml"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_launch(path, given)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_all_end_together(tmp_path: Path) -> None:
    """Where one fails, and where they are stopped; the other one is asked, and has time to say goodbye."""
    said = tmp_path / "said"
    stays = f"import signal, sys, time; signal.signal(15, lambda *_: (open({str(said)!r}, 'w').close(), sys.exit(0)))"
    stays += f"; open({str(said) + '.up'!r}, 'w').close(); time.sleep(60)"
    up = Path(str(said) + ".up")
    fails = f"import os, time\nwhile not os.path.exists({str(up)!r}): time.sleep(0.01)\nraise SystemExit(4)"
    with pytest.raises(DeviceError, match="ended with exit code 4"):
        run_launch(((sys.executable, "-c", stays), (sys.executable, "-c", fails)), threading.Event())
    assert said.exists()
    said.unlink()
    up.unlink()
    stop = threading.Event()
    thread = threading.Thread(target=run_launch, args=(((sys.executable, "-c", stays),), stop))
    thread.start()
    while not up.exists():
        time.sleep(0.01)
    stop.set()
    thread.join(60.0)
    assert said.exists()
    with pytest.raises(DeviceError, match="cannot be started"):
        run_launch((("no-such-program-here",),), stop)


def test_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ros", "launch"]) == 0
    assert "foam.launch.xml" in capsys.readouterr().out
    assert main(["ros", "launch", "foam"]) == 2
    assert "config: needs a value" in capsys.readouterr().err
    path = tmp_path / "a.launch.xml"
    path.write_text('<launch><executable cmd="visuohaptic ros node"/></launch>')
    assert main(["ros", "launch", str(path)]) == 0
