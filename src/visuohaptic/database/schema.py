"""Tables of the object databases, identical in SQLite and PostgreSQL, and migration of old versions."""

from __future__ import annotations

import re

import sqlalchemy as sa

from ..core.errors import DatabaseError, brief

_METADATA = sa.MetaData()

#: Metadata of the database: schema version, and its identity for peers.
meta = sa.Table(
    "meta",
    _METADATA,
    sa.Column("key", sa.String, primary_key=True),
    sa.Column("value", sa.String, nullable=False),
)

#: A single row. Every write takes the next number and locks the row until it commits: changes
#: become visible in the order of their numbers.
counter = sa.Table(
    "counter", _METADATA, sa.Column("id", sa.Integer, primary_key=True), sa.Column("value", sa.BigInteger)
)

#: Array files; ``data`` contains the file if there is no folder for it (shared databases).
shard = sa.Table(
    "shard",
    _METADATA,
    sa.Column("name", sa.String, primary_key=True),
    sa.Column("sha256", sa.String, nullable=False),
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Column("data", sa.LargeBinary),
)

object_ = sa.Table(
    "object",
    _METADATA,
    sa.Column("id", sa.String, primary_key=True),
    sa.Column("name", sa.String, nullable=False),
    sa.Column("visual_class", sa.String, nullable=False, index=True),
    sa.Column("change", sa.BigInteger, nullable=False, index=True),
    sa.Column("card", sa.Text, nullable=False),
    sa.Column("shard", sa.String, sa.ForeignKey("shard.name"), index=True),
    sa.Column("row_group", sa.Integer),
    sa.Column("arrays_sha256", sa.String, nullable=False),
    sa.Column("digest", sa.String, nullable=False),
    sa.Column("deleted_s", sa.Float),  # since version 2
)

feature = sa.Table(
    "feature",
    _METADATA,
    sa.Column("object_id", sa.String, sa.ForeignKey("object.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("kind", sa.String, primary_key=True),
    sa.Column("change", sa.BigInteger, nullable=False, index=True),
    sa.Column("data", sa.LargeBinary, nullable=False),  # float64, little endian
)

#: Last change of each other database that was processed here; since version 2.
peer = sa.Table(
    "peer",
    _METADATA,
    sa.Column("id", sa.String, primary_key=True),
    sa.Column("sent", sa.BigInteger, nullable=False),
    sa.Column("received", sa.BigInteger, nullable=False),
)


def _from_nothing(connection: sa.Connection) -> None:
    """Version 1 in its original form: without deletions and peers."""
    import uuid

    first = sa.MetaData()
    for table in (meta, counter, shard, object_, feature):
        table.to_metadata(first)
    old = first.tables["object"]
    old._columns.remove(old.c.deleted_s)
    first.create_all(connection)
    connection.execute(
        meta.insert(), [{"key": "id", "value": uuid.uuid4().hex}, {"key": "schema", "value": "1"}]
    )
    connection.execute(counter.insert(), {"id": 1, "value": 0})


def _deletions_and_peers(connection: sa.Connection) -> None:
    connection.execute(sa.text("ALTER TABLE object ADD COLUMN deleted_s DOUBLE PRECISION"))
    peer.create(connection)


def _shards_of_grouped_objects(_: sa.Connection) -> None:
    """The tables are the same; older versions of the library cannot read the new shards."""


#: Migration steps: step n converts version n to n + 1.
MIGRATIONS = (_from_nothing, _deletions_and_peers, _shards_of_grouped_objects)
#: Version of the schema that this library reads and writes.
VERSION = len(MIGRATIONS)


def version_of(connection: sa.Connection, where: str) -> int:
    """Version of the schema; 0 for an empty database.

    Parameters
    ----------
    connection
        Of the database.
    where
        Name of the database, for errors.

    Raises
    ------
    DatabaseError
        Its version is not a number, or its file has views or triggers, which may compute without end.
    """
    if connection.dialect.name == "sqlite":
        words = "SELECT type, name FROM sqlite_master WHERE type NOT IN ('table', 'index')"
        if found := connection.execute(sa.text(words)).first():
            raise DatabaseError(f"{where}: has the {found[0]} {brief(found[1])}, expected tables only")
    if not sa.inspect(connection).has_table("meta"):
        return 0
    found = connection.execute(meta.select().where(meta.c.key == "schema")).first()
    version = "0" if found is None else str(found.value)
    if not re.fullmatch("[0-9]{1,9}", version):
        raise DatabaseError(
            f"{where}: found schema version {brief(version)}, expected that of a database of objects"
        )
    return int(version)


def migrate(connection: sa.Connection, where: str, upto: int = VERSION) -> None:
    """Migrate the schema to this library's version, all steps in the transaction of the connection.

    Parameters
    ----------
    connection
        sa.Connection with an open transaction.
    where
        The database, for messages.
    upto
        Target version of the schema.

    Raises
    ------
    DatabaseError
        It was written by a newer version of the library.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(
            sa.text("SELECT pg_advisory_xact_lock(7065241)")
        )  # arbitrary, but unique to this library
    version = version_of(connection, where)
    if version > VERSION:
        raise DatabaseError(
            f"{where}: has schema version {version}, expected at most {VERSION}; update visuohaptic"
        )
    for step in range(version, upto):
        MIGRATIONS[step](connection)
        connection.execute(meta.update().where(meta.c.key == "schema").values(value=str(step + 1)))
