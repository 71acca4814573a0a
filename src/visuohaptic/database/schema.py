"""Tables of the object databases, the same in SQLite and PostgreSQL, and how old ones become new ones."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Float,
    ForeignKey,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    inspect,
    text,
)

from ..core.errors import DatabaseError

__all__ = ["VERSION", "counter", "feature", "meta", "migrate", "object_", "peer", "shard"]

_METADATA = MetaData()

#: What the database says of itself: schema version, and an identity that peers know it by.
meta = Table(
    "meta", _METADATA, Column("key", String, primary_key=True), Column("value", String, nullable=False)
)

#: One row; every write takes the next number, and holds the row until it is committed: changes
#: become visible in the order of their numbers.
counter = Table("counter", _METADATA, Column("id", Integer, primary_key=True), Column("value", BigInteger))

#: Files of arrays; ``data`` holds the file where there is no folder for it (shared databases).
shard = Table(
    "shard",
    _METADATA,
    Column("name", String, primary_key=True),
    Column("sha256", String, nullable=False),
    Column("bytes", BigInteger, nullable=False),
    Column("data", LargeBinary),
)

object_ = Table(
    "object",
    _METADATA,
    Column("id", String, primary_key=True),
    Column("name", String, nullable=False),
    Column("visual_class", String, nullable=False, index=True),
    Column("change", BigInteger, nullable=False, index=True),
    Column("card", Text, nullable=False),
    Column("shard", String, ForeignKey("shard.name"), index=True),
    Column("row_group", Integer),
    Column("arrays_sha256", String, nullable=False),
    Column("digest", String, nullable=False),
    Column("deleted_s", Float),  # since version 2
)

feature = Table(
    "feature",
    _METADATA,
    Column("object_id", String, ForeignKey("object.id", ondelete="CASCADE"), primary_key=True),
    Column("kind", String, primary_key=True),
    Column("change", BigInteger, nullable=False, index=True),
    Column("data", LargeBinary, nullable=False),  # float64, little endian
)

#: How far each other database is known here; since version 2.
peer = Table(
    "peer",
    _METADATA,
    Column("id", String, primary_key=True),
    Column("sent", BigInteger, nullable=False),
    Column("received", BigInteger, nullable=False),
)


def _from_nothing(connection: Connection) -> None:
    """Version 1, as it was: without deletions and peers."""
    import uuid

    first = MetaData()
    for table in (meta, counter, shard, object_, feature):
        table.to_metadata(first)
    old = first.tables["object"]
    old._columns.remove(old.c.deleted_s)
    first.create_all(connection)
    connection.execute(
        meta.insert(), [{"key": "id", "value": uuid.uuid4().hex}, {"key": "schema", "value": "1"}]
    )
    connection.execute(counter.insert(), {"id": 1, "value": 0})


def _deletions_and_peers(connection: Connection) -> None:
    connection.execute(text("ALTER TABLE object ADD COLUMN deleted_s DOUBLE PRECISION"))
    peer.create(connection)


#: What makes version n + 1 of version n.
MIGRATIONS = (_from_nothing, _deletions_and_peers)
#: Version of the schema that this library reads and writes.
VERSION = len(MIGRATIONS)


def version_of(connection: Connection, where: str) -> int:
    """Version of the schema; 0 for an empty database."""
    if not inspect(connection).has_table("meta"):
        return 0
    found = connection.execute(meta.select().where(meta.c.key == "schema")).first()
    try:
        return int(found.value) if found is not None else 0
    except ValueError as error:
        raise DatabaseError(f"{where}: is not a database of objects ({error})") from error


def migrate(connection: Connection, where: str, upto: int = VERSION) -> None:
    """Bring the schema to this library's version, all steps in the transaction of the connection.

    Parameters
    ----------
    connection
        Connection with an open transaction.
    where
        The database, for messages.
    upto
        Version of the schema.

    Raises
    ------
    DatabaseError
        A newer version of the library has written it.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(7065241)"))  # any number, only ours
    version = version_of(connection, where)
    if version > VERSION:
        raise DatabaseError(
            f"{where}: has schema version {version}, expected at most {VERSION}; update visuohaptic"
        )
    for step in range(version, upto):
        MIGRATIONS[step](connection)
        connection.execute(meta.update().where(meta.c.key == "schema").values(value=str(step + 1)))
