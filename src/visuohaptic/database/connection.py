"""Connections of the object databases: a SQLite file that loses nothing, or a PostgreSQL server."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError

from ..core.errors import InputError, MissingExtraError

__all__ = ["connect_file", "connect_server", "shown_url"]

#: How long a writer waits for the others [s].
_WAIT_S = 60.0
_SERVER = re.compile(r"^postgres(ql)?(\+psycopg)?://")
#: Parameters of an address that messages may show.
_HARMLESS = frozenset(
    {"user", "host", "port", "dbname", "sslmode", "connect_timeout", "application_name", "options"}
)


def connect_file(path: Path) -> Engine:
    """Engine of a SQLite file, set so that what is committed is on the disk.

    Parameters
    ----------
    path
        The file; created when it is not there.
    """
    # Not a text: a folder may be called run?1 or per%20cent.
    url = URL.create("sqlite", database=str(path))
    engine = create_engine(url, connect_args={"timeout": _WAIT_S, "check_same_thread": False})

    @event.listens_for(engine, "connect")
    def prepare(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # BEGIN is ours, below
        for line in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
            connection.execute(f"PRAGMA {line}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # A writer takes its turn at once: a read that becomes a write could be refused half-way.
        writes = connection.get_execution_options().get("writes", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def connect_server(url: str) -> Engine:
    """Engine of a PostgreSQL server.

    Parameters
    ----------
    url
        Address of the form ``postgresql://user:password@host:port/name``.

    Raises
    ------
    InputError
        The address is none.
    MissingExtraError
        The driver is not installed.
    """
    expected = "expected postgresql://USER@HOST:PORT/NAME"
    if not _SERVER.match(url):
        raise InputError(shown_url(url), f"is not the address of a PostgreSQL server, {expected}")
    try:
        # What the parser says is left out: it may quote a part of the password.
        address = make_url(_SERVER.sub("postgresql+psycopg://", url))
    except (ArgumentError, ValueError) as error:
        raise InputError(shown_url(url), f"is not the address of a database, {expected}") from error
    try:
        return create_engine(address, pool_pre_ping=True)
    except ModuleNotFoundError as error:
        raise MissingExtraError("psycopg", "shared", "a shared database") from error


def shown_url(location: str) -> str:
    """The address of a server without its secrets, for messages; a folder as it is.

    Works on addresses that cannot be parsed, too: those are the ones that messages are about.

    Parameters
    ----------
    location
        Folder or address.

    Examples
    --------
    >>> shown_url("mysql://bob:pw@host/objects?password=pw&sslmode=require")
    'mysql://bob:***@host/objects?password=***&sslmode=require'
    """
    if "://" not in location:
        return location
    # Up to the last @: a password may hold one, and slashes and question marks, too.
    shown = re.sub(r"://([^:@/]*):.*@", r"://\1:***@", location, flags=re.DOTALL)
    address, mark, query = shown.partition("?")
    parts = [part.partition("=") for part in query.split("&")]
    return (
        address
        + mark
        + "&".join(
            name + sign + (value if name in _HARMLESS or not value else "***") for name, sign, value in parts
        )
    )
