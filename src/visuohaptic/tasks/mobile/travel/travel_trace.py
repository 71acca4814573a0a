"""What happened on a travel, event by event, to JSON and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ....core.errors import InputError

__all__ = ["TravelRecord", "final_places", "records_from_json", "records_to_json"]


@dataclass(frozen=True, slots=True)
class TravelRecord:
    """One event."""

    t_s: float  #: by the base's clock
    state: str  #: of the machine, when it happened
    event: str  #: "planned", "pushed", "looked", ...
    pose_m: tuple[float, float, float]  #: estimated, of the robot in the map: x, y [m], heading [rad]
    object: str = ""  #: that it concerns
    values: Mapping[str, Any] = field(default_factory=dict)  #: numbers and texts that belong to it


def records_to_json(records: Sequence[TravelRecord]) -> list[dict[str, Any]]:
    """Plain data for ``json.dumps``.

    Parameters
    ----------
    records
        Records in order of time.
    """
    return [
        {
            "t_s": round(record.t_s, 4),
            "state": record.state,
            "event": record.event,
            "pose_m": [round(value, 5) for value in record.pose_m],
            **({"object": record.object} if record.object else {}),
            **({"values": dict(record.values)} if record.values else {}),
        }
        for record in records
    ]


def records_from_json(data: Sequence[Mapping[str, Any]], *, where: str = "trace") -> tuple[TravelRecord, ...]:
    """Read what :func:`records_to_json` wrote.

    Parameters
    ----------
    data
        One mapping per record.
    where
        Name of the source in errors.

    Raises
    ------
    InputError
        A field that is missing or of the wrong kind.
    """
    found = []
    for number, entry in enumerate(data):
        try:
            x, y, heading = (float(value) for value in entry["pose_m"])
            t_s = float(entry["t_s"])
            values = dict(entry.get("values", {}))
            if not np.isfinite([x, y, heading, t_s]).all():
                raise ValueError("a number that is not finite")
            found.append(
                TravelRecord(
                    t_s,
                    str(entry["state"]),
                    str(entry["event"]),
                    (x, y, heading),
                    str(entry.get("object", "")),
                    values,
                )
            )
        except KeyError as error:
            raise InputError(f"{where}[{number}]", "is missing", field=str(error.args[0])) from error
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{where}[{number}]", f"is no record ({error})") from error
    return tuple(found)


def final_places(records: Sequence[TravelRecord]) -> dict[str, tuple[float, float, float]]:
    """Where each object was seen last: x, y of its centroid [m], turn since the start [rad].

    Parameters
    ----------
    records
        Records in order of time.
    """
    places: dict[str, tuple[float, float, float]] = {}
    for record in records:
        if record.event == "looked":
            x, y, turn = record.values["place_m"]
            places[record.object] = (float(x), float(y), float(turn))
    return places
