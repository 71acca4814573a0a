"""Connections of the object databases: a SQLite file that loses nothing, or a PostgreSQL server."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import ArgumentError, NoSuchModuleError

from ..errors import InputError, MissingExtraError

__all__ = ["connect_file", "connect_server"]

#: How long a writer waits for the others [s].
_WAIT_S = 60.0


def connect_file(path: Path) -> Engine:
    """Engine of a SQLite file, set so that what is committed is on the disk."""
    engine = create_engine(f"sqlite:///{path}", connect_args={"timeout": _WAIT_S, "check_same_thread": False})

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

    Raises
    ------
    InputError
        The address is none.
    MissingExtraError
        The driver is not installed.
    """
    if "://" in url and not re.match(r"^postgres(ql)?(\+psycopg)?://", url):
        raise InputError(url, "is no address of a PostgreSQL server, expected postgresql://...")
    url = re.sub(r"^postgres(ql)?://", "postgresql+psycopg://", url)
    try:
        return create_engine(url, pool_pre_ping=True)
    except ModuleNotFoundError as error:
        raise MissingExtraError("psycopg", "shared", "a shared database") from error
    except (ArgumentError, NoSuchModuleError) as error:
        raise InputError(url, f"is not the address of a database ({error})") from error
