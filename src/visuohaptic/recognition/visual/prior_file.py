"""File of a visual prior: NPZ arrays, one of which contains the metadata as JSON."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ...core import InputError, atomic_path, read_npz
from ...core.files import check_target
from .prior import Entry, VisualPrior
from .prior_evidence import PriorSettings
from .shape import DESCRIPTOR_LENGTH, ShapeViews
from .visual_words import LocalFeatures

_FORMAT = "visuohaptic visual prior 1"
_ARRAYS = ("card", "places", "descriptors", "points_m", "directions", "views")


def save_prior(path: Path | str, prior: VisualPrior) -> None:
    """Write an NPZ file atomically.

    Parameters
    ----------
    path
        Path with the suffix .npz.
    prior
        Visual prior.
    """
    path = check_target(path, (".npz",))
    entries = list(prior.entries.items())
    images = [one for _, entry in entries for one in entry.images]
    shapes = [entry.shape for _, entry in entries if entry.shape is not None]
    card = {
        "format": _FORMAT,
        "settings": asdict(prior.settings),
        "objects": [
            {
                "id": name,
                "models": list(entry.models),
                "features": [len(one) for one in entry.images],
                "shape": None
                if entry.shape is None
                else [len(entry.shape.points_m), len(entry.shape.directions)],
                "context": dict(entry.context),
                "sightings": entry.sightings,
            }
            for name, entry in entries
        ],
    }

    def joined(parts: list[Any], width: int, kind: type) -> np.ndarray:
        return np.concatenate(parts) if parts else np.zeros((0, width), kind)

    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            card=np.frombuffer(json.dumps(card).encode(), np.uint8),
            places=joined([one.points_px for one in images], 2, np.float32),
            descriptors=joined([one.descriptors for one in images], 128, np.uint8),
            points_m=joined([one.points_m for one in shapes], 3, np.float32),
            directions=joined([one.directions for one in shapes], 3, np.float32),
            views=joined([one.descriptors for one in shapes], DESCRIPTOR_LENGTH, np.float32),
        )


def load_prior(path: Path | str) -> VisualPrior:
    """Read a visual prior written by :func:`save_prior`.

    Parameters
    ----------
    path
        NPZ file.

    Raises
    ------
    InputError
        The file does not exist, or is damaged.
    """
    path = Path(path)
    arrays = read_npz(path, "a visual prior", names=_ARRAYS, remedy="write it again")
    try:
        return _decoded(json.loads(bytes(arrays["card"])), arrays)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(path, f"is not a visual prior ({error})", remedy="write it again") from error


def _decoded(card: Any, arrays: dict[str, np.ndarray]) -> VisualPrior:
    if card["format"] != _FORMAT:
        raise ValueError(f"found the format {card['format']!r}, expected {_FORMAT!r}")
    prior = VisualPrior(PriorSettings(**card["settings"]))
    wanted = {
        "places": (np.float32, 2), "descriptors": (np.uint8, 128), "points_m": (np.float32, 3),
        "directions": (np.float32, 3), "views": (np.float32, DESCRIPTOR_LENGTH),
    }  # fmt: skip
    for name, (kind, width) in wanted.items():
        array = arrays[name]
        if array.dtype != kind or array.ndim != 2 or array.shape[1] != width:
            raise ValueError(f"{name} has {array.dtype} {array.shape}, expected {kind.__name__} (n, {width})")
        if array.dtype != np.uint8 and not np.isfinite(array).all():
            raise ValueError(f"{name} has numbers that are not finite")
    at = dict.fromkeys(wanted, 0)

    def take(name: str, count: int) -> np.ndarray:
        part = arrays[name][at[name] : at[name] + count]
        if count < 0 or len(part) != count:
            raise ValueError(f"{name} is truncated")
        at[name] += count
        return part

    for one in card["objects"]:
        entry = Entry(tuple(str(model) for model in one["models"]))
        for count in one["features"]:
            entry.images.append(LocalFeatures(take("places", count), take("descriptors", count)))
        if one["shape"] is not None:
            points, views = one["shape"]
            entry.shape = ShapeViews(
                take("points_m", points), take("directions", views), take("views", views)
            )
        entry.context = Counter({str(word): int(times) for word, times in one["context"].items()})
        entry.sightings = int(one["sightings"])
        prior.entries[str(one["id"])] = entry
    return prior
