"""Execution of XML launch files of ``ros2 launch`` without ROS: arguments and executables."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path

from ...core import DeviceError, InputError, brief
from ...core.files import MAX_HAND_BYTES, read_text

_VARIABLE = re.compile(r"\$\(var ([\w-]+)\)")
#: Supported elements and attributes, with the same meaning as in ``ros2 launch``.
_ATTRIBUTES = {"arg": {"name", "default", "description"}, "executable": {"cmd", "name", "output"}}
#: Time-out for processes to terminate after Ctrl-C before they are killed [s].
_GRACE_S = 10.0


def read_launch(path: Path | str, given: Mapping[str, str]) -> tuple[tuple[str, ...], ...]:
    """Commands of a launch file.

    Supported are ``arg`` (``name``, ``default``), ``executable`` (``cmd``) and ``$(var name)`` in the latter, as in
    ``ros2 launch``; other features of ``ros2 launch``, and input that it rejects, are rejected.

    Parameters
    ----------
    path
        ``*.launch.xml``.
    given
        Values of the arguments.

    Raises
    ------
    InputError
        It is not XML, contains other elements, attributes or substitutions, or the value of an argument is missing.
    """
    text = read_text(path, MAX_HAND_BYTES)
    if "<!" in text.replace("<!--", ""):
        raise InputError(path, "has a document type or entities, expected elements only")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(path, f"is not XML ({error})") from error
    if root.tag != "launch":
        raise InputError(path, f"found <{root.tag}>, expected <launch>")
    values: dict[str, str] = {}
    commands = []
    for element in root:
        if element.tag not in _ATTRIBUTES:
            raise InputError(path, f"found <{element.tag}>, expected <arg> or <executable>")
        if others := [
            *sorted(element.attrib.keys() - _ATTRIBUTES[element.tag]),
            *(f"<{each.tag}>" for each in element),
        ]:
            expected = ", ".join(sorted(_ATTRIBUTES[element.tag]))
            raise InputError(path, f"found {others[0]} in <{element.tag}>, expected {expected}")
        if element.tag == "executable":
            commands.append(_words(path, element.get("cmd", ""), values))
            continue
        name = element.get("name", "")
        value = given.get(name, element.get("default"))
        if value is None:
            raise InputError(path, f"needs a value, give {name}:=VALUE", field=name)
        values[name] = value
    if unknown := sorted(given.keys() - values.keys()):
        known = ", ".join(sorted(values)) or "none"
        raise InputError(path, f"has no argument {', '.join(unknown)}; it has {known}")
    if not commands or not all(commands):
        raise InputError(path, "has no <executable> with a cmd")
    return tuple(commands)


def _words(path: Path | str, command: str, values: Mapping[str, str]) -> tuple[str, ...]:
    """Split a command like ``ros2 launch``: the text between two variables is split separately.

    Values are therefore never split, and quotes cannot extend over a variable.
    """
    words: list[str] = []
    continues = False  # whether the next piece continues the last word
    for number, piece in enumerate(_VARIABLE.split(command)):
        if number % 2:
            if piece not in values:
                raise InputError(path, f"uses $(var {piece}), which no <arg> before it declares")
            parts, apart = [values[piece]], False
        elif "$(" in piece:
            raise InputError(path, f"found {brief(piece)}, expected no substitution but $(var NAME)")
        else:
            try:
                parts, apart = shlex.split(piece), piece[:1].isspace()
            except ValueError as error:
                remedy = "ros2 launch never splits a variable: leave out the quotes around it"
                raise InputError(
                    path, f"found an unterminated quote in {brief(piece)}", remedy=remedy
                ) from error
        if parts and continues and not apart:
            words[-1] += parts.pop(0)
        words += parts
        continues = number % 2 == 1 or (not piece[-1].isspace() if piece else continues)
    return tuple(words)


def run_launch(commands: tuple[tuple[str, ...], ...], stop: threading.Event) -> None:
    """Run all commands until ``stop`` is set; if one exits with an error, all are stopped.

    Parameters
    ----------
    commands
        Result of :func:`read_launch`; ``visuohaptic`` refers to this installation.
    stop
        Event that stops them.

    Raises
    ------
    DeviceError
        A command could not be started, or exited with an error.
    """
    processes: list[subprocess.Popen[bytes]] = []
    try:
        for words in commands:
            command = [sys.executable, "-m", *words] if words[0] == "visuohaptic" else list(words)
            try:
                # A separate process group: Ctrl-C of the terminal reaches only this process, and is forwarded once.
                processes.append(subprocess.Popen(command, start_new_session=os.name == "posix"))
            except OSError as error:
                raise DeviceError(f"{words[0]}: cannot be started ({error.strerror})") from error
        while not stop.wait(0.2):
            for words, process in zip(commands, processes, strict=True):
                if process.poll():
                    raise DeviceError(f"{shlex.join(words)} has ended with exit code {process.returncode}")
            if all(process.poll() is not None for process in processes):
                return
    finally:
        for process in processes:
            if process.poll() is None:
                process.terminate()
        for process in processes:
            try:
                process.wait(_GRACE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
