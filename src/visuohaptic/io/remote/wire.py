"""Messages between a robot's process and its client: permitted members, and types of values.

A message is a line of JSON followed by the bytes of its arrays, without pickle. Values are numbers, strings, tuples and
the dataclasses of :data:`KINDS`; other types cannot be transferred.
"""

from __future__ import annotations

import json
import math
import os
import socket
import struct
import threading
from dataclasses import dataclass, is_dataclass
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, answer_challenge, deliver_challenge
from typing import Any

import numpy as np

from ...core import (
    BaseState,
    Camera,
    DeviceError,
    Frame,
    GripperState,
    InputError,
    LaserScan,
    MapPose,
    Pose,
    Wrench,
)
from ...core.codec import DTYPES, encode_record, from_dict

#: Larger messages are rejected before memory is allocated: about ten 4K images.
MAX_MESSAGE_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True, slots=True)
class RemoteTouch:
    """A transferred :class:`~visuohaptic.core.robots.FingerTouch`."""

    valid: bool
    force_N: float
    surface_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RemoteDepth:
    """A transferred :class:`~visuohaptic.core.robots.DepthImage`."""

    t_s: float
    depth_m: np.ndarray


#: Dataclasses that can be transferred.
KINDS: dict[str, type] = {
    kind.__name__: kind
    for kind in (BaseState, Camera, Frame, GripperState, LaserScan, MapPose, Pose, RemoteTouch, Wrench)
}
#: Array types as written by :func:`pack`.
_CODES = frozenset(np.dtype(name).newbyteorder("<").str for name in DTYPES)
#: Components of a robot, and the members of each that the client may call.
PROTOCOLS: dict[str, tuple[str, ...]] = {
    "base": ("drive", "stop", "state"),
    "arm": ("move_linear", "stop", "pose", "reach_m"),
    "gripper": ("move", "stop", "state"),
    "localizer": ("locate",),
    "laser": ("scan",),
    "senses": ("pose", "touch", "look"),
    "camera": ("model", "next"),
    "load_camera": ("model", "next"),
    "depth": ("model", "read"),
    "feel": ("touch",),
    "wrench": ("read",),
    "weigh": ("read",),
    "wait": ("wait",),
}


def handshake(connection: Connection[Any, Any], key: bytes, patience_s: float, *, asks_first: bool) -> None:
    """Both ends prove that they have the key, within a time that no number of small messages prolongs.

    Parameters
    ----------
    connection
        Of a ``Listener`` or ``Client`` without a key; closed if the proof fails.
    key
        Shared secret.
    patience_s
        Time for all messages together [s].
    asks_first
        Whether this end sends the first challenge: the server does.

    Raises
    ------
    DeviceError
        The other end has another key, no protocol, or is silent.
    """
    with _line(connection) as line:
        watch = threading.Timer(patience_s, line.shutdown, (socket.SHUT_RDWR,))
        watch.daemon = True
        watch.start()
        try:
            for step in (deliver_challenge, answer_challenge)[:: 1 if asks_first else -1]:
                step(connection, key)
        except (AuthenticationError, AssertionError, EOFError, OSError) as problem:
            connection.close()
            # Its text would hold what the other end has sent.
            raise DeviceError(f"no proof of the key ({type(problem).__name__})") from problem
        finally:
            watch.cancel()
            watch.join()


def limit_waiting(connection: Connection[Any, Any], patience_s: float) -> None:
    """Let each transfer of bytes end with ``OSError`` if the other end does not take part in it for this time.

    Parameters
    ----------
    connection
        Of a socket.
    patience_s
        Time [s].
    """
    value = (
        int(patience_s * 1000)
        if os.name == "nt"
        else struct.pack("@ll", int(patience_s), int(patience_s % 1 * 1e6))
    )
    with _line(connection) as line:
        for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
            line.setsockopt(socket.SOL_SOCKET, option, value)


def _line(connection: Connection[Any, Any]) -> socket.socket:
    """Another handle of the connection's socket."""
    own = socket.socket(fileno=connection.fileno())
    try:
        return own.dup()
    finally:
        own.detach()


def pack(value: Any) -> bytes:
    """Serialise a value.

    Parameters
    ----------
    value
        Number, string, boolean, ``None``, array, dataclass of :data:`KINDS`, or a tuple or mapping of them.

    Raises
    ------
    InputError
        The value has another type.
    """
    arrays: list[np.ndarray] = []
    head = json.dumps({"value": _plain(value, arrays), "arrays": [[a.dtype.str, a.shape] for a in arrays]})
    return head.encode() + b"\n" + b"".join(a.tobytes() for a in arrays)


def unpack(message: bytes) -> Any:
    """Deserialise a message.

    Parameters
    ----------
    message
        Message of :func:`pack`.

    Raises
    ------
    DeviceError
        The message is invalid.
    """
    head, _, body = message.partition(b"\n")
    try:
        data = json.loads(head)
        arrays, at = [], 0
        for name, shape in data["arrays"]:
            if name not in _CODES or any(type(n) is not int or n < 0 for n in shape):
                raise ValueError(f"array of {name!r}")
            dtype, count = np.dtype(name), math.prod(shape)
            arrays.append(np.frombuffer(body, dtype, count, at).reshape(shape))
            at += count * dtype.itemsize
        return _value(data["value"], arrays)
    except (
        ValueError,
        TypeError,
        KeyError,
        IndexError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as problem:
        raise DeviceError(f"found {len(message)} bytes that are not a message ({problem})") from problem


def _plain(value: Any, arrays: list[np.ndarray]) -> Any:
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else {"number": str(float(value))}
    if isinstance(value, np.ndarray):
        if value.dtype.name not in DTYPES:
            raise InputError("remote", f"found an array of {value.dtype}, which cannot be transmitted")
        arrays.append(np.ascontiguousarray(value).astype(value.dtype.newbyteorder("<"), copy=False))
        return {"array": len(arrays) - 1}
    if isinstance(value, (tuple, list)):
        return {"tuple": [_plain(item, arrays) for item in value]}
    if isinstance(value, dict):
        return {"items": {str(name): _plain(item, arrays) for name, item in value.items()}}
    if is_dataclass(value) and type(value) in KINDS.values():
        apart: dict[str, np.ndarray] = {}
        fields = encode_record(value, apart)
        return {
            "kind": type(value).__name__,
            "fields": _plain(json.dumps(fields), arrays),
            "apart": _plain(apart, arrays),
        }
    raise InputError("remote", f"found {type(value).__name__}, which cannot be transmitted")


def _value(data: Any, arrays: list[np.ndarray]) -> Any:
    if not isinstance(data, dict):
        return data
    if "number" in data:
        return float(data["number"])
    if "array" in data:
        return arrays[data["array"]]
    if "tuple" in data:
        return tuple(_value(item, arrays) for item in data["tuple"])
    if "items" in data:
        return {name: _value(item, arrays) for name, item in data["items"].items()}
    apart = _value(data["apart"], arrays)
    return from_dict(KINDS[data["kind"]], json.loads(data["fields"]), arrays=apart, where="remote")
