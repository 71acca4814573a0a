"""A robot's database and a shared one tell each other what is new.

Both sides join versions by :func:`~visuohaptic.database.merge.merge_objects`, which gives the same result in any
order: there are no conflicts to ask about, and a synchronisation that was interrupted is simply run again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from sqlalchemy import select

from ..core import cards
from ..core.objects import VisuoHapticObject
from .database import BATCH, ObjectDatabase
from .schema import peer

__all__ = ["Synchronised", "synchronise"]


@dataclass(frozen=True, slots=True)
class Synchronised:
    """What went over."""

    sent: int  #: objects offered to the shared database
    received: int  #: objects that are new here, or changed by what it knew


def synchronise(
    local: ObjectDatabase,
    shared: ObjectDatabase,
    *,
    is_shared: Callable[[VisuoHapticObject], bool] = lambda obj: True,
) -> Synchronised:
    """Send what is new here, then fetch what is new there.

    Parameters
    ----------
    local
        The database of this robot.
    shared
        The database that several robots share.
    is_shared
        Tells which objects are of general interest; the others stay here.

    Notes
    -----
    Where an object was seen last stays here: it is knowledge of one robot in one place (Alt 2016, Sec. 6.3.3).
    """
    sent_to, received_to = _known(local, shared.id)
    ids, last_here = local.changed(sent_to)
    sent = 0
    for start in range(0, len(ids), BATCH):
        found = local.stored(ids[start : start + BATCH])
        offer = {
            one: (replace(obj, seen=None), deleted_s)
            for one, (obj, deleted_s) in found.items()
            if deleted_s is not None or is_shared(obj)
        }
        if offer:
            shared.write_merged(offer)
            sent += len(offer)
    ids, last_there = shared.changed(received_to)
    received = 0
    for start in range(0, len(ids), BATCH):
        batch = ids[start : start + BATCH]
        before = local.stored(batch)
        after = local.write_merged(shared.stored(batch))
        # What was sent a moment ago comes back as it is: nothing was learnt from it.
        received += sum(one not in before or _told(before[one]) != _told(pair) for one, pair in after.items())
    # What came from there is a change here, too, and is offered once more next time: it merges to nothing new.
    _note(local, shared.id, last_here, last_there)
    return Synchronised(sent, received)


def _told(pair: tuple[VisuoHapticObject, float | None]) -> tuple[str, str, float | None]:
    card, arrays = cards.encode(pair[0])
    return cards.card_text(card), cards.arrays_digest(arrays) if arrays else "", pair[1]


def _known(local: ObjectDatabase, peer_id: str) -> tuple[int, int]:
    with local.connections.reading() as connection:
        row = connection.execute(select(peer.c.sent, peer.c.received).where(peer.c.id == peer_id)).first()
    return (0, 0) if row is None else (row.sent, row.received)


def _note(local: ObjectDatabase, peer_id: str, sent: int, received: int) -> None:
    with local.connections.writing() as connection:
        connection.execute(peer.delete().where(peer.c.id == peer_id))
        connection.execute(peer.insert(), {"id": peer_id, "sent": sent, "received": received})
