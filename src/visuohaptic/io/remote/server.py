"""Serves the components of a robot to one other process on this machine, through the members of their protocols."""

from __future__ import annotations

import importlib
import json
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from multiprocessing.connection import Connection, Listener
from typing import Any

from ...core import ROBOT_CONTRACT, DeviceError, InputError, VisuohapticError
from .wire import MAX_MESSAGE_BYTES, PROTOCOLS, RemoteTouch, handshake, pack, unpack

_log = logging.getLogger(__name__)
#: Time in which a client must prove that it has the key [s]: four messages of some bytes on one machine.
HANDSHAKE_S = 2.0


def serve_robot(parts: Mapping[str, Any], *, key: bytes, ready: Callable[[tuple[str, int]], None]) -> None:
    """Serve one client until it disconnects; then stop all components that have a stop function.

    Parameters
    ----------
    parts
        Components from :data:`~.wire.PROTOCOLS`: ``base``, ``arm``, ``gripper``, ``localizer``, ``laser``, ``senses``, ``camera``, ``load_camera``,
        ``depth``, and the functions ``feel`` (frame to touch), ``wrench``, ``weigh`` (of a frame) and ``wait`` (of seconds).
    key
        Secret shared with the client.
    ready
        Called with the address once a client may connect.

    Raises
    ------
    InputError
        A component is not in the protocol.
    """
    if unknown := sorted(set(parts) - set(PROTOCOLS)):
        raise InputError("serve_robot", f"found part {unknown[0]!r}, expected some of {', '.join(PROTOCOLS)}")
    with Listener(("127.0.0.1", 0)) as listener:
        host, port = listener.address[:2]
        ready((str(host), int(port)))
        with _accepted(listener, key) as connection:
            _answer(_Served(parts), connection)


def _accepted(listener: Listener, key: bytes) -> Connection[Any, Any]:
    """The first client that has the key; others on this machine may try, or stay silent, and do not end the service."""
    while True:
        try:
            connection = listener.accept()
            handshake(connection, key, HANDSHAKE_S, asks_first=True)
            return connection
        except (DeviceError, OSError) as problem:
            _log.warning("refused a client: %s", problem)


def _answer(served: _Served, connection: Connection[Any, Any]) -> None:
    try:
        connection.send_bytes(pack({"contract": ROBOT_CONTRACT, "parts": tuple(served.parts)}))
        while True:
            connection.send_bytes(_reply(served, connection.recv_bytes(MAX_MESSAGE_BYTES)))
    except (EOFError, OSError):
        pass  # the client has disconnected
    finally:
        served.stop()


def _reply(served: _Served, message: bytes) -> bytes:
    try:
        return pack({"value": served.call(unpack(message))})
    except VisuohapticError as problem:
        return pack({"error": type(problem).__name__, "text": str(problem)})
    except Exception as problem:  # noqa: BLE001 - drivers' errors have no common base; what moves must stay stoppable
        _log.exception("a part of the robot has failed")
        return pack({"error": "DeviceError", "text": f"{type(problem).__name__}: {problem}"})


class _Served:
    """Calls the permitted members of components.

    Parameters
    ----------
    parts
        Components by name.
    """

    def __init__(self, parts: Mapping[str, Any]) -> None:
        self.parts = {name: part for name, part in parts.items() if part is not None}
        self._frames: dict[str, Iterator[Any]] = {
            name: iter(self.parts[name]) for name in ("camera", "load_camera") if name in self.parts
        }

    def call(self, request: Any) -> Any:
        """Result of a request ``{"part", "member", "arguments"}``."""
        fields = request if isinstance(request, dict) else {}
        part, member, arguments = fields.get("part"), fields.get("member"), fields.get("arguments", ())
        if part not in self.parts or member not in PROTOCOLS[part]:
            raise InputError("remote", f"found {part}.{member}, which is not a member of a served part")
        served = self.parts[part]
        if part in self._frames:
            return served.camera if member == "model" else next(self._frames[part], None)
        if part == "depth":
            if member == "model":
                return served.camera
            image = served.read()
            return {"t_s": float(image.t_s), "depth_m": image.depth_m}
        if part in ("feel", "wrench", "weigh", "wait"):
            found = served(*arguments)
            return (
                RemoteTouch(bool(found.valid), float(found.force_N), float(found.surface_m))
                if part == "feel"
                else found
            )
        return getattr(served, member)(*arguments)

    def stop(self) -> None:
        """Stop all motion."""
        for part in self.parts.values():
            if hasattr(part, "stop"):
                part.stop()


def main() -> None:
    """``python -m visuohaptic.io.remote.server MODULE:FUNCTION ARGUMENTS``; the key is read from standard input."""
    # Output of a module or a library is not the address.
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    module, _, function = sys.argv[1].partition(":")
    key = bytes.fromhex(sys.stdin.readline().strip())
    sys.path.insert(0, os.getcwd())
    parts = getattr(importlib.import_module(module), function)(**json.loads(sys.argv[2]))

    def ready(address: tuple[str, int]) -> None:
        print(json.dumps(address), file=out, flush=True)

    serve_robot(parts, key=key, ready=ready)


if __name__ == "__main__":
    main()
