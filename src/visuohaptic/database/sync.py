"""Bidirectional synchronisation of a robot's database and a shared one.

Both sides merge versions with :func:`~visuohaptic.database.merge.merge_objects`, whose result does not depend on the
order: there are no conflicts to resolve, and an interrupted synchronisation is simply repeated.

A shared database that was restored from a backup counts its changes from there again. So a robot leaves a random mark
in it after what it has sent and received: where that is gone, both sides exchange everything again.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from sqlalchemy import Connection, select

from ..core import cards
from ..core.objects import VisuoHapticObject
from .database import BATCH, ObjectDatabase
from .rows import last_change
from .schema import meta, peer


@dataclass(frozen=True, slots=True)
class Synchronised:
    """Result of a synchronisation."""

    sent: int  #: objects offered to the shared database
    received: int  #: objects that are new locally, or were changed by the shared version


def synchronise(
    local: ObjectDatabase,
    shared: ObjectDatabase,
    *,
    is_shared: Callable[[VisuoHapticObject], bool] = lambda obj: True,
) -> Synchronised:
    """Send local changes, then fetch remote ones.

    Parameters
    ----------
    local
        The database of this robot.
    shared
        The database that several robots share.
    is_shared
        Returns which objects are of general interest; the others remain local.

    Notes
    -----
    The last known position of an object remains local: it is specific to one robot and place (Alt 2016, Sec. 6.3.3).
    """
    sent_to, received_to, mark = _known(local, shared)
    changes, last_here = local.changed(sent_to)
    sent, echoes = _offer(local, shared, list(changes), is_shared)
    changes, last_there = shared.changed(received_to)
    # Objects just sent are identical on both sides and are not fetched. But a different version that took precedence
    # in the shared database is new locally, even if it is not new there.
    news = [one for one, change in changes.items() if echoes.get(one) != change]
    news += [one for one in sent if one not in echoes and one not in changes]
    received, writes, differing = 0, 0, []
    for start in range(0, len(news), BATCH):
        offered = shared.stored(news[start : start + BATCH])
        written = local.write_merged(offered)
        received += len(written.changed)
        writes += 1
        differing += [one for one in written.known if not _same(written.merged[one], offered[one])]
    # Where it was merged with local changes not yet offered, the result is new for the others.
    again, _ = _offer(local, shared, differing, is_shared)
    now = local.last_change()
    # Objects just received are not offered back, unless another process has written here meanwhile.
    if sent or again or (news and mark):  # who only reads may not be allowed to write
        mark = _replace_mark(shared, mark, local.id)
    _note(local, shared.id, (now if now == last_here + writes else last_here, last_there), mark)
    return Synchronised(len(sent) + len(again), received)


def _offer(
    local: ObjectDatabase,
    shared: ObjectDatabase,
    ids: Sequence[str],
    is_shared: Callable[[VisuoHapticObject], bool],
) -> tuple[list[str], dict[str, int]]:
    """Send objects; returns which, and by id the change in which the shared database stored an unmodified version."""
    sent: list[str] = []
    echoes: dict[str, int] = {}
    for start in range(0, len(ids), BATCH):
        found = local.stored(ids[start : start + BATCH])
        offer = {
            one: (replace(obj, seen=None), deleted_s)
            for one, (obj, deleted_s) in found.items()
            if deleted_s is not None or is_shared(obj)
        }
        if offer:
            written = shared.write_merged(offer)
            sent += offer
            echoes |= {
                one: written.change
                for one in offer
                if one not in written.known or _same(written.merged[one], offer[one])
            }
    return sent, echoes


def _same(one: tuple[VisuoHapticObject, float | None], other: tuple[VisuoHapticObject, float | None]) -> bool:
    """Whether two versions are equal, except for the last known position."""
    return _content(one) == _content(other)


def _content(pair: tuple[VisuoHapticObject, float | None]) -> tuple[str, str, float | None]:
    card, arrays = cards.encode(replace(pair[0], seen=None))
    return cards.card_text(card), cards.arrays_digest(arrays) if arrays else "", pair[1]


def _known(local: ObjectDatabase, shared: ObjectDatabase) -> tuple[int, int, str]:
    """Last changes sent and received, and the mark left then; no changes where the shared database has lost some."""
    with local.connections.reading() as connection:
        row = connection.execute(select(peer.c.sent, peer.c.received).where(peer.c.id == shared.id)).first()
        mark = _value(connection, f"mark {shared.id}")
    if row is None:
        return 0, 0, mark
    with shared.connections.reading() as connection:
        whole = not mark or _value(connection, f"mark {mark}")
        if not whole or last_change(connection) < row.received:
            return 0, 0, mark
    return row.sent, row.received, mark


def _value(connection: Connection, key: str) -> str:
    return str(connection.scalar(select(meta.c.value).where(meta.c.key == key)) or "")


def _replace_mark(shared: ObjectDatabase, mark: str, owner: str) -> str:
    """Leave a new mark in the shared database.

    Not the same one again, which a backup may have; nor one under the robot's name, which copies of its database have, too.
    """
    new = uuid.uuid4().hex
    with shared.connections.writing() as connection:
        connection.execute(meta.delete().where(meta.c.key == f"mark {mark}"))
        connection.execute(meta.insert(), {"key": f"mark {new}", "value": owner})
    return new


def _note(local: ObjectDatabase, peer_id: str, changes: tuple[int, int], mark: str) -> None:
    key = f"mark {peer_id}"
    with local.connections.writing() as connection:
        connection.execute(peer.delete().where(peer.c.id == peer_id))
        connection.execute(peer.insert(), {"id": peer_id, "sent": changes[0], "received": changes[1]})
        connection.execute(meta.delete().where(meta.c.key == key))
        if mark:
            connection.execute(meta.insert(), {"key": key, "value": mark})
