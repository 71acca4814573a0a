"""Connections of the object databases: a durable SQLite file, or a PostgreSQL server."""

from __future__ import annotations

import re
import sqlite3
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DBAPIError

from ..core.errors import DatabaseError, InputError, MissingExtraError
from ..core.files import check_name

#: How long a writer waits while no other writer commits [s].
_WAIT_S = 60.0
#: Interval at which a writer tries to lock [s]: about the duration of a commit, which syncs the disk four times. Longer
#: intervals leave the database idle, shorter ones take processor time from the writer that holds the lock.
_TURN_S = 0.005
_SERVER = re.compile(r"^postgres(ql)?(\+psycopg)?://")
_NOT_STORED = "; what was being written is not stored"
#: Parameters of an address that may appear in messages.
_HARMLESS = frozenset(
    {"user", "host", "port", "dbname", "sslmode", "connect_timeout", "application_name", "options"}
)


def connect(location: Path | str, *, create: bool) -> tuple[Engine, str, Path | None]:
    """Create the engine of a database in a folder or on a server.

    Parameters
    ----------
    location
        Folder, or URL such as ``postgresql://host/name``.
    create
        Whether to create the folder if it does not exist.

    Returns
    -------
    engine
        Engine of the database.
    where
        The location without secrets, for messages.
    shards
        Folder of the arrays; ``None`` for a server.

    Raises
    ------
    InputError
        The database does not exist and ``create`` is false, or the location cannot be used.
    """
    if "://" in str(location):
        return connect_server(str(location)), shown_url(str(location)), None
    folder = check_name(location)
    if not create and not (folder / "objects.sqlite").is_file():
        raise InputError(folder, "is not a database of objects", remedy="add or import an object first")
    try:
        (folder / "shards").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(folder, f"cannot be created ({error.strerror})") from error
    return connect_file(folder / "objects.sqlite"), str(location), folder / "shards"


def connect_file(path: Path) -> Engine:
    """Engine of an SQLite file, configured so that commits are durable.

    Parameters
    ----------
    path
        The file; created if it does not exist.
    """
    # Not a string URL: a folder may be named run?1 or per%20cent.
    url = URL.create("sqlite", database=str(path))
    engine = create_engine(url, connect_args={"timeout": _WAIT_S, "check_same_thread": False})

    @event.listens_for(engine, "connect")
    def prepare(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # BEGIN is issued explicitly, below
        for line in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
            connection.execute(f"PRAGMA {line}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        if connection.get_execution_options().get("writes", False):
            _begin_writing(connection)
        else:
            connection.exec_driver_sql("BEGIN")

    return engine


def _begin_writing(connection: Connection) -> None:
    """Begin a transaction with the write lock; waits without limit while other writers commit.

    A writer locks immediately: upgrading from a read to a write lock could fail halfway. The wait is not left to SQLite,
    whose pauses grow from 1 to 100 ms: a writer that has just committed asks again before those that have waited for long,
    and one of 16 writers may starve. Here all ask at the same interval.
    """
    driver: Any = connection.connection.driver_connection
    seen, until_s = None, time.monotonic() + _WAIT_S
    driver.execute("PRAGMA busy_timeout = 0")
    try:
        while True:
            try:
                # Changes with every commit of another connection.
                if (version := driver.execute("PRAGMA data_version").fetchone()) != seen:
                    seen, until_s = version, time.monotonic() + _WAIT_S
                driver.execute("BEGIN IMMEDIATE")
                return
            except sqlite3.OperationalError as error:
                # The low byte is common to all kinds of busy.
                busy = error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_BUSY
                if not busy or time.monotonic() > until_s:
                    raise
            time.sleep(_TURN_S)
    finally:
        driver.execute(f"PRAGMA busy_timeout = {round(1000 * _WAIT_S)}")


def connect_server(url: str) -> Engine:
    """Engine of a PostgreSQL server.

    Parameters
    ----------
    url
        Address of the form ``postgresql://user:password@host:port/name``.

    Raises
    ------
    InputError
        The address is invalid.
    MissingExtraError
        The driver is not installed.
    """
    expected = "expected postgresql://USER@HOST:PORT/NAME"
    if not _SERVER.match(url):
        raise InputError(shown_url(url), f"is not the address of a PostgreSQL server, {expected}")
    if (
        url.count("@") > 1
    ):  # the parser would take part of the password for the host, and the driver would print it
        raise InputError(
            shown_url(url),
            "has more than one @",
            remedy="write @ : / ? of names and passwords as %40 %3A %2F %3F",
        )
    try:
        # The parser's message is omitted: it may quote part of the password.
        address = make_url(_SERVER.sub("postgresql+psycopg://", url))
    except (ArgumentError, ValueError) as error:
        raise InputError(shown_url(url), f"is not the address of a database, {expected}") from error
    try:
        return create_engine(address, pool_pre_ping=True)
    except ModuleNotFoundError as error:
        raise MissingExtraError("psycopg", "shared", "a shared database") from error


def shown_url(location: str) -> str:
    """The address of a server without secrets, for messages; a folder is returned unchanged.

    Also works for addresses that cannot be parsed, which often appear in messages.

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
    # Up to the last @: a password may contain one, and also slashes and question marks.
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


class Connections:
    """Connections to one database, for reading or for one transaction; converts errors of the driver.

    Parameters
    ----------
    engine
        Engine of :func:`connect_file` or :func:`connect_server`.
    where
        The database, for messages.
    """

    def __init__(self, engine: Engine, where: str) -> None:
        self._engine = engine
        self._where = where

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A connection to read from."""
        with self._guarded(""), self._engine.connect() as connection:
            yield connection

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A connection with a transaction, committed at the end; other writers wait."""
        engine = self._engine.execution_options(writes=True)
        with self._guarded(_NOT_STORED), engine.connect() as connection, connection.begin():
            yield connection

    def storing(self) -> AbstractContextManager[None]:
        """Convert errors while files are written for a transaction that has not begun."""
        return self._guarded(_NOT_STORED)

    @contextmanager
    def _guarded(self, loss: str) -> Iterator[None]:
        """Convert errors of the underlying libraries, stating what was lost."""
        try:
            yield
        except (DBAPIError, sqlite3.Error) as error:
            said = " ".join(str(error.orig if isinstance(error, DBAPIError) else error).split())
            raise DatabaseError(f"{self._where}: {said}{loss}") from error
        except FileNotFoundError:
            raise
        except OSError as error:
            raise DatabaseError(f"{self._where}: {error.strerror or error}{loss}") from error
