"""Client for the components of a robot served by another process on this machine."""

from __future__ import annotations

import json
import secrets
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, cast

from ...core import (
    Camera,
    Closing,
    DeviceError,
    Frame,
    InputError,
    LaserScan,
    VisuohapticError,
    Wrench,
    errors,
)
from ...core.robots import ROBOT_CONTRACT, Gripper, MapPose, MobileBase, ProbeArm
from . import server
from .wire import (
    MAX_MESSAGE_BYTES,
    PROTOCOLS,
    RemoteDepth,
    RemoteTouch,
    handshake,
    limit_waiting,
    pack,
    unpack,
)

#: Time-out of the connection, and of each reply [s]: a simulated world renders, a robot's driver waits.
PATIENCE_S = 60.0


class RemoteRobot(Closing):
    """A robot in another process; a component that is not served is rejected when it is used.

    Parameters
    ----------
    address
        Host and port of the server.
    key
        Shared secret.
    process
        Server process, if it was started here; terminated by :meth:`close`.

    Raises
    ------
    DeviceError
        The server does not respond, or does not have the key.
    """

    def __init__(
        self, address: tuple[str, int], key: bytes, process: subprocess.Popen[str] | None = None
    ) -> None:
        self._process, self._lock = process, threading.Lock()
        try:
            with socket.create_connection(address, PATIENCE_S) as line:
                line.setblocking(True)
                self._connection: Connection[Any, Any] = Connection(line.detach())
            handshake(self._connection, key, PATIENCE_S, asks_first=False)
            limit_waiting(self._connection, PATIENCE_S)
        except (OSError, DeviceError) as problem:
            raise DeviceError(
                f"the robot at {address[0]}:{address[1]} does not answer ({problem})"
            ) from problem
        hello = self._receive()
        self.parts: tuple[str, ...] = tuple(hello.get("parts", ()))  #: served components
        if str(hello.get("contract")).partition(".")[0] != ROBOT_CONTRACT.partition(".")[0]:
            self.close()
            raise InputError(
                "remote", f"found a robot for contract {hello.get('contract')}, expected {ROBOT_CONTRACT}"
            )
        self.base = cast("MobileBase", _Part(self, "base"))
        self.arm, self.gripper = cast("ProbeArm", _Part(self, "arm")), cast("Gripper", _Part(self, "gripper"))
        self.senses: Any = _Part(self, "senses")
        self.camera, self.depth = _RemoteCamera(self, "camera"), _RemoteDepthCamera(self)
        #: camera of the load sensor from which the hand hangs
        self.load_camera = _RemoteCamera(self, "load_camera")
        #: latest pose in the map: the robot is its own ``Localizer``
        self.locate: Callable[[], MapPose] = partial(self.call, "localizer", "locate")
        #: measurement of the finger's sensor for a frame of :attr:`camera`
        self.feel: Callable[[Frame], RemoteTouch] = partial(self.call, "feel", "touch")
        #: measurement of the beam sensor for a frame
        self.wrench: Callable[[Frame], Wrench] = partial(self.call, "wrench", "read")
        #: downward load on the fingers [N], for a frame
        self.weigh: Callable[[Frame], float] = partial(self.call, "weigh", "read")
        #: lets time pass on the server [s]
        self.wait: Callable[[float], None] = partial(self.call, "wait", "wait")

    def call(self, part: str, member: str, *arguments: Any) -> Any:
        """Call a member of a component on the server.

        Parameters
        ----------
        part, member
            Component and member, from :data:`~.wire.PROTOCOLS`.
        *arguments
            Arguments that can be serialised.

        Raises
        ------
        VisuohapticError
            Same type as raised on the server.
        DeviceError
            The connection to the robot is lost.
        """
        with self._lock:
            try:
                self._connection.send_bytes(
                    pack({"part": part, "member": member, "arguments": tuple(arguments)})
                )
            except OSError as problem:
                self._connection.close()
                raise DeviceError(
                    f"{part}.{member}: lost the connection to the robot ({problem})"
                ) from problem
            reply = self._receive()
        if "error" in reply:
            kind = getattr(errors, str(reply["error"]), DeviceError)
            if isinstance(kind, type) and issubclass(kind, InputError):
                raise InputError(f"{part}.{member}", str(reply["text"]))
            known = isinstance(kind, type) and issubclass(kind, DeviceError)
            raise (kind if known else DeviceError)(str(reply["text"]))
        return reply.get("value")

    def scan(self) -> LaserScan:
        """Newest scan of the laser.

        Raises
        ------
        DeviceError
            The served driver returns something else.
        """
        found = self.call("laser", "scan")
        if not isinstance(found, LaserScan):
            raise DeviceError(f"laser.scan: found {type(found).__name__}, expected LaserScan")
        return found

    def _receive(self) -> dict[str, Any]:
        try:
            if not self._connection.poll(PATIENCE_S):
                raise DeviceError(f"the robot has not answered for {PATIENCE_S:g} s")
            reply = unpack(self._connection.recv_bytes(MAX_MESSAGE_BYTES))
            if not isinstance(reply, dict):
                raise DeviceError(f"found {type(reply).__name__}, expected the reply of a robot")
        except (OSError, EOFError) as problem:
            self._connection.close()
            raise DeviceError(f"lost the connection to the robot ({type(problem).__name__})") from problem
        except DeviceError:
            self._connection.close()  # a late reply would be taken for that of the next call
            raise
        return reply

    def served(self) -> dict[str, Any]:
        """The served components that have a protocol, by name."""
        names = ("base", "arm", "gripper", "camera", "localizer", "depth", "feel", "wait")
        own = {"localizer": self}
        return {name: own.get(name) or getattr(self, name) for name in names if name in self.parts}

    def close(self) -> None:
        """Disconnect; the other process stops its robot. May be called repeatedly."""
        self._connection.close()
        if self._process is not None:
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    pipe.close()


def start_robot(target: str, arguments: Mapping[str, Any] | None = None) -> RemoteRobot:
    """Start a process that creates a robot, or a simulated world with one, and serves its components.

    Parameters
    ----------
    target
        ``module:function``; returns the components as :func:`~.server.serve_robot` expects them.
    arguments
        Arguments of the function, plain data by name.

    Raises
    ------
    DeviceError
        The process ended before it served anything; the reason is on its standard error.

    Examples
    --------
    >>> with start_robot("my_worlds:office", {"seed": 3}) as robot:  # doctest: +SKIP
    ...     travel(problem, robot.base, robot.senses, robot.wait)
    """
    key = secrets.token_bytes(32)
    process = subprocess.Popen(
        [sys.executable, "-m", server.__name__, target, json.dumps(dict(arguments or {}))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    patience = threading.Timer(PATIENCE_S, process.kill)
    patience.start()
    try:
        # Not a command-line argument: the process list is public.
        process.stdin.write(key.hex() + "\n")
        process.stdin.flush()
        host, port = json.loads(process.stdout.readline())
        return RemoteRobot((str(host), int(port)), key, process)
    except VisuohapticError:
        process.kill()
        process.wait()
        raise
    except (OSError, ValueError, TypeError) as problem:
        process.kill()
        process.wait()
        raise DeviceError(
            f"{target} did not serve a robot within {PATIENCE_S:g} s; see its messages"
        ) from problem
    finally:
        patience.cancel()


class _Part:
    """A component whose members, listed in :data:`~.wire.PROTOCOLS`, are called on the server."""

    def __init__(self, robot: RemoteRobot, part: str) -> None:
        self._robot, self._part = robot, part

    def __getattr__(self, member: str) -> Any:
        if member not in PROTOCOLS[self._part]:
            raise AttributeError(f"{self._part} has no {member}")
        return partial(self._robot.call, self._part, member)


class _RemoteCamera(Closing):
    frame_count = None

    def __init__(self, robot: RemoteRobot, part: str) -> None:
        self._robot, self._part = robot, part

    @property
    def camera(self) -> Camera | None:
        found: Camera | None = self._robot.call(self._part, "model")
        return found

    def __iter__(self) -> Iterator[Frame]:
        while (frame := self._robot.call(self._part, "next")) is not None:
            yield frame

    def close(self) -> None:
        """Does nothing: there is nothing to release."""


class _RemoteDepthCamera:
    def __init__(self, robot: RemoteRobot) -> None:
        self._robot = robot

    @property
    def camera(self) -> Camera:
        found: Camera = self._robot.call("depth", "model")
        return found

    def read(self) -> RemoteDepth:
        found = self._robot.call("depth", "read")
        return RemoteDepth(float(found["t_s"]), found["depth_m"])
