"""Connection of a node to its domain: options, and the zenoh session."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...core.errors import DeviceError, InputError, needs
from ...core.ranges import check_ranges, within

#: Address of the router of rmw_zenoh (``ros2 run rmw_zenoh_cpp rmw_zenohd``) on the same machine.
ROUTER = "tcp/127.0.0.1:7447"


@dataclass(frozen=True, slots=True)
class RosOptions:
    """Connection options of a node; by default through a router on this machine, and never by multicast."""

    #: by default that of ``ROS_DOMAIN_ID``, or 0 if it is not set
    domain: int | None = field(default=None, metadata=within(0, 232))
    namespace: str = "/"
    type_hashes: bool = True  #: false for Humble, which has none
    connect: tuple[str, ...] = (ROUTER,)  #: routers or peers; empty = wait for others to connect
    listen: tuple[str, ...] = (
        "tcp/127.0.0.1:0",
    )  #: addresses on which peers may connect; port 0 = any free port
    zenoh_config: Path | None = (
        None  #: zenoh configuration file (JSON5), for TLS etc., instead of the two above
    )
    patience_s: float = 3.0  #: time-out for a router [s]

    def __post_init__(self) -> None:
        check_ranges(self)


def environment_domain() -> int:
    """Domain of the environment variable ``ROS_DOMAIN_ID``; 0 without it, as in ROS.

    Raises
    ------
    InputError
        The variable is not a number from 0 to 232.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isdecimal() or int(text) > 232:
        raise InputError("ROS_DOMAIN_ID", f"found {text!r}, expected a number from 0 to 232")
    return int(text)


def check_security(transport: str, configured: bool, remedy: str) -> None:
    """Refuse to open an unprotected node where ``ROS_SECURITY_ENABLE`` asks for protection.

    The keys of ROS (``ROS_SECURITY_KEYSTORE``) are used by ROS itself alone, that is, by the transport ``rclpy``.

    Parameters
    ----------
    transport
        Name of the transport, for messages.
    configured
        Whether it has a configuration of its own, which decides then.
    remedy
        Where its own protection is configured.

    Raises
    ------
    InputError
        Protection is asked for, and nothing configures it.
    """
    if os.environ.get("ROS_SECURITY_ENABLE", "") == "true" and not configured:
        found = f"found true, but {transport} does not use the keys of ROS, and would be unprotected"
        raise InputError("ROS_SECURITY_ENABLE", found, remedy=f"{remedy}, or the transport rclpy")


def shown_error(error: Exception) -> str:
    """zenoh's error text without the source location.

    Parameters
    ----------
    error
        Error raised by zenoh.
    """
    return " ".join(str(error).partition(" at /")[0].split())


def open_session(options: RosOptions) -> Any:
    """Open a zenoh session according to the options.

    Parameters
    ----------
    options
        Routers, peers, or a zenoh configuration file.

    Raises
    ------
    MissingExtraError
        zenoh is not installed.
    InputError
        The options, or the file that they name, are not a valid configuration, or leave a node unprotected
        where ``ROS_SECURITY_ENABLE`` is set.
    DeviceError
        No router responds.
    """
    with needs("eclipse-zenoh", "ros", "live ROS 2"):
        import zenoh
    try:
        config = _config(options, zenoh)
    except (zenoh.ZError, OSError) as error:
        where = options.zenoh_config or "RosOptions"
        raise InputError(where, f"is not a zenoh configuration ({shown_error(error)})") from error
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        where = options.zenoh_config or ", ".join(options.connect) or "zenoh"
        raise DeviceError(
            f"{where}: no connection ({shown_error(error)}); start the router (ros2 run rmw_zenoh_cpp rmw_zenohd), "
            "name another one, or connect to none"
        ) from error


def _is_protected(config: Any) -> bool:
    """Whether a zenoh configuration admits only encrypted links whose both ends have certificates.

    As ``zenoh_security_tools`` of ROS 2 writes it. Endpoints alone decide nothing: discovered peers are connected to over
    every protocol that is not excluded.
    """
    protocols = json.loads(config.get_json("transport/link/protocols")) or []
    mutual = json.loads(config.get_json("transport/link/tls/enable_mtls"))
    return bool(protocols) and set(protocols) <= {"tls", "quic"} and mutual is True


def _config(options: RosOptions, zenoh: Any) -> Any:
    config = None
    if options.zenoh_config is not None:
        if not options.zenoh_config.is_file():
            raise InputError(options.zenoh_config, "does not exist")
        config = zenoh.Config.from_file(options.zenoh_config)
    remedy = "name a zenoh_config with transport/link/protocols of tls alone, and with enable_mtls"
    check_security("zenoh", config is not None and _is_protected(config), remedy)
    if config is not None:
        return config
    fields = {
        "mode": "peer",
        "connect": {
            "endpoints": list(options.connect),
            "timeout_ms": int(1e3 * options.patience_s),
            "exit_on_failure": True,
        },
        "listen": {"endpoints": list(options.listen)},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        # Latched topics are ordered by time.
        "timestamping": {"enabled": True},
    }
    return zenoh.Config.from_json5(json.dumps(fields))
