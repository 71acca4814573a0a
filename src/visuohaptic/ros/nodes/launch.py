"""Launch files in XML, as ``ros2 launch`` runs them, without ROS: arguments and executables."""

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

from ...core.errors import DeviceError, InputError
from ...core.files import read_text

__all__ = ["read_launch", "run_launch"]

_MAX_BYTES = 1_000_000
_VARIABLE = re.compile(r"\$\(var ([\w-]+)\)")
_MARKED = re.compile(r"\x1f([\w-]+)\x1f")
#: Time for the processes to end after Ctrl-C before they are killed [s].
_GRACE_S = 10.0


def read_launch(path: Path | str, given: Mapping[str, str]) -> tuple[tuple[str, ...], ...]:
    """Commands of a launch file.

    Understood are ``arg`` (``name``, ``default``), ``executable`` (``cmd``, ``output``) and ``$(var name)``, which plain
    ``ros2 launch`` understands as well.

    Parameters
    ----------
    path
        ``*.launch.xml``.
    given
        Values of its arguments.

    Raises
    ------
    InputError
        It is not XML, has other elements, or lacks the value of an argument.
    """
    text = read_text(path, _MAX_BYTES)
    if "<!" in text.replace("<!--", ""):
        raise InputError(path, "has a document type or entities, expected elements only")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(path, f"is not XML ({error})") from error
    values: dict[str, str] = {}
    commands = []
    for element in root:
        if element.tag == "arg":
            name = element.get("name", "")
            value = given.get(name, element.get("default"))
            if value is None:
                raise InputError(path, f"needs a value, give {name}:=VALUE", field=name)
            values[name] = value
        elif element.tag == "executable":
            # The name of a variable must not be split, and its value neither.
            words = shlex.split(_VARIABLE.sub("\x1f\\1\x1f", element.get("cmd", "")))
            commands.append(tuple(_MARKED.sub(lambda m: _value(path, values, m[1]), word) for word in words))
        else:
            raise InputError(path, f"found <{element.tag}>, expected <arg> or <executable>")
    if unknown := sorted(given.keys() - values.keys()):
        known = ", ".join(sorted(values)) or "none"
        raise InputError(path, f"has no argument {', '.join(unknown)}; it has {known}")
    if not commands or not all(commands):
        raise InputError(path, "has no <executable> with a cmd")
    return tuple(commands)


def _value(path: Path | str, values: Mapping[str, str], name: str) -> str:
    if name not in values:
        raise InputError(path, f"uses $(var {name}), which no <arg> before it declares")
    return values[name]


def run_launch(commands: tuple[tuple[str, ...], ...], stop: threading.Event) -> None:
    """Run all commands until ``stop`` is set; where one ends by itself with an error, all end.

    Parameters
    ----------
    commands
        Of :func:`read_launch`; ``visuohaptic`` is this installation's.
    stop
        Set to end them.

    Raises
    ------
    DeviceError
        A command cannot be started, or has ended with an error.
    """
    processes: list[subprocess.Popen[bytes]] = []
    try:
        for words in commands:
            command = [sys.executable, "-m", *words] if words[0] == "visuohaptic" else list(words)
            try:
                # A group of its own: Ctrl-C of the terminal comes to us alone, and is handed on once.
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
