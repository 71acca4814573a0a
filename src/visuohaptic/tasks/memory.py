"""Persistent memory of a place between visits of any robot, in a database of objects: its map, obstacles, and containers.

A place is a name; entries about it have this name at the start of their id and in the context of their sighting.
Objects on the floor are recognised by :func:`~visuohaptic.tasks.mobile.recognise`, containers on a table by
:func:`recognise_container`; a match is used if its probability is at least ``CONFIDENT_PROBABILITY``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import Closing, InputError, decode_image, normal_sigmas
from ..core.objects import (
    Appearance,
    Estimate,
    FeatureVector,
    Geometry,
    HapticTag,
    Material,
    Provenance,
    Sighting,
    VisuoHapticObject,
)
from ..io.maps.occupancy_map import OccupancyMap
from ..recognition.touch.haptic_model import UNKNOWN
from .mobile.floor_outline import POINT_M, FloorOutline
from .mobile.known_objects import CONFIDENT_PROBABILITY, recognise, remembered_outline

#: An object within this distance of its last position has not been moved [m].
MOVED_M = 0.15
#: Standard deviation of a radius that is seen and touched, and of the population [m]; heights at which outlines are stored.
RADIUS_M, TOUCHED_M, ANY_RADIUS_M, HEIGHTS = 0.003, 0.001, 0.012, 24
#: Two measurements of one friction differ by less in 99 of 100 cases [standard deviations].
AGREE_SIGMAS = normal_sigmas(0.01)
_FREE, _OCCUPIED, _UNKNOWN = 254, 0, 127


@dataclass(frozen=True, slots=True, eq=False)
class RememberedMap:
    """The mapped floor."""

    grid: OccupancyMap
    goal_m: tuple[float, float]  #: position from which the table is reached
    home: tuple[float, float, float]  #: start of the tasks
    #: mean laser hits of its cells, for localisation finer than a cell
    hits_m: Float[np.ndarray, "k 2"] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RememberedContainer:
    """Stored data of a container that stood on the table."""

    id: str  #: its name in this memory; empty: a new one is given
    class_name: str
    probability: float  #: of the class
    outline_m: Float[np.ndarray, "k 2"]
    sigma_m: float  #: expected error of its radius
    lid: str = UNKNOWN  #: ``open``, ``closed``, or ``UNKNOWN`` where the last visit did not decide
    fill: float = 0.0


class PlaceMemory(Closing):
    """The entries of one place in a database of objects.

    Parameters
    ----------
    location
        Folder, or URL of a server that several robots share.
    place
        Its name.
    """

    def __init__(self, location: Path | str, place: str) -> None:
        from ..database.database import open_database  # an optional dependency, not needed without memory

        self._database = open_database(location)
        self.place = place

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def _objects(self, visual_class: str) -> list[VisuoHapticObject]:
        names = [
            one.id for one in self._database.summaries() if one.id.startswith(f"{self.place}.{visual_class}")
        ]
        return [self._database.get(name) for name in sorted(names)]

    def map(self) -> RememberedMap | None:
        """The floor of this place; ``None`` if it was never mapped.

        Raises
        ------
        InputError
            The stored data are not a map.
        """
        found = self._objects("map")
        if not found:
            return None
        floor, where = found[0], f"{found[0].id} in the memory"
        numbers = {name: float(value) for name, value in floor.state.items() if not isinstance(value, str)}
        if floor.appearance is None or floor.appearance.template_png is None or set(numbers) < set(_NUMBERS):
            raise InputError(
                where, "is not a map of a floor", remedy="remove it, then the floor is mapped again"
            )
        picture = decode_image(floor.appearance.template_png, where, "grey")
        cells = np.full(picture.shape, -1, np.int8)
        cells[picture == _FREE], cells[picture == _OCCUPIED] = 0, 100
        res, x0, y0, gx, gy, hx, hy, heading = (numbers[name] for name in _NUMBERS)
        shape = floor.geometry
        hits_m = None if shape is None or shape.vertices_m is None else shape.vertices_m[:, :2]
        return RememberedMap(OccupancyMap(cells, res, (x0, y0, 0.0)), (gx, gy), (hx, hy, heading), hits_m)

    def store_map(self, found: RememberedMap) -> None:
        """Store or replace a map.

        Parameters
        ----------
        found
            Map of the tour.
        """
        import cv2

        cells = found.grid.cells
        picture = np.where(cells == 0, _FREE, np.where(cells >= 50, _OCCUPIED, _UNKNOWN)).astype(np.uint8)
        height, width = (found.grid.resolution_m * count for count in cells.shape)
        values = (found.grid.resolution_m, *found.grid.origin[:2], *found.goal_m, *found.home)
        self._keep(
            "map",
            appearance=Appearance(template_png=cv2.imencode(".png", picture)[1].tobytes(), template_size_m=(width, height)),
            geometry=None if found.hits_m is None else Geometry(np.pad(found.hits_m, ((0, 0), (0, 1)))),
            state=dict(zip(_NUMBERS, map(float, values), strict=True)),
        )  # fmt: skip

    def floor_objects(self) -> list[VisuoHapticObject]:
        """Touched objects on this floor: tag, outline about its centroid, and last position."""
        return [one for one in self._objects("floor") if one.geometry is not None and one.tag is not None]

    def store_floor_object(self, outline: FloorOutline, tag: HapticTag, others: Iterable[str] = ()) -> str:
        """Store an object that was touched, or refine the stored one that it is; returns its name in this memory.

        Parameters
        ----------
        outline
            Current outline, map frame.
        tag
            Measured tag.
        others
            Names of stored objects that are other ones.
        """
        about, stored = replace(outline, pose=(-0.5 * outline.size_m[1], 0.0, 0.0)), self._objects("floor")
        # What the laser left open, the foam may tell: an object stored twice would be recognised no more.
        same = [
            one
            for one in self.floor_objects()
            if self._name(one) not in others
            and (own := remembered_outline(one)) is not None
            and own.round == outline.round
            and one.tag is not None
            and _agree(one.tag, tag)
        ]
        (match,) = recognise([[outline]], same)
        name = f"floor-{len(stored) + 1}" if match is None else self._name(match[0])
        self._keep(
            name, geometry=Geometry(footprint_m=about.corners_m), tag=tag, seen=self._sighting(outline.centre_m),
            state=dict(zip(("width_sigma_m", "depth_sigma_m"), outline.sigma_m, strict=True)),
        )  # fmt: skip
        return name

    def move_floor_object(self, name: str, place_m: Sequence[float], tag: HapticTag | None = None) -> None:
        """Record the observed position of an object, and what pushes have shown.

        Parameters
        ----------
        name
            Name of the object in this memory.
        place_m
            x, y of the centroid of its outline, map frame [m].
        tag
            Its tag after pushes; ``None`` leaves the stored one.
        """
        parts: dict[str, Any] = {"seen": self._sighting(place_m)}
        if tag is not None:
            stored = self._database.get(f"{self.place}.{name}").tag or HapticTag()
            # What was measured before is no second measurement.
            again = [one.name for one in fields(stored) if isinstance(getattr(stored, one.name), Estimate)]
            parts["tag"] = tag.updated(**dict.fromkeys(again))
        self._keep(name, **parts)

    def _name(self, one: VisuoHapticObject) -> str:
        return one.id.removeprefix(f"{self.place}.")

    def _sighting(self, place_m: Sequence[float] | Float[np.ndarray, "2"]) -> Sighting:
        place = (float(place_m[0]), float(place_m[1]), 0.0)
        return Sighting(place, POINT_M, time.time(), context=(self.place,))

    def bottles(self) -> list[RememberedContainer]:
        """Containers that stood on a table."""
        found = []
        for one in self._objects("table"):
            shape = one.features.get("outline")
            if shape is None or len(shape.values) != HEIGHTS + 1 or shape.sigma is None:
                continue
            heights = np.linspace(0.0, float(shape.values[-1]), HEIGHTS)
            state = one.state
            found.append(
                RememberedContainer(
                    self._name(one), one.visual_class, float(state.get("class_probability", 0.0)),
                    np.column_stack([shape.values[:-1], heights]), float(shape.sigma[0]),
                    str(state.get("lid", UNKNOWN)), float(state.get("fill", 0.0)),
                )
            )  # fmt: skip
        return found

    def store_bottle(self, bottle: RememberedContainer, wall: Estimate) -> None:
        """Store a container; a new name is created if its own is empty.

        Parameters
        ----------
        bottle
            Its properties.
        wall
            Thickness of its wall [m].
        """
        name = bottle.id or f"table-{len(self._objects('table')) + 1}"
        height = float(bottle.outline_m[-1, 1])
        radii = np.interp(np.linspace(0.0, height, HEIGHTS), bottle.outline_m[:, 1], bottle.outline_m[:, 0])
        self._keep(
            name,
            visual_class=bottle.class_name,
            features={"outline": FeatureVector(np.append(radii, height), np.full(HEIGHTS + 1, bottle.sigma_m))},
            material=Material(wall_thickness_m=wall),
            state={"lid": bottle.lid, "fill": bottle.fill, "class_probability": bottle.probability},
        )  # fmt: skip

    def _keep(self, name: str, **parts: Any) -> None:
        now = {part: Provenance("mission", time.time()) for part in parts}
        self._database.add(replace(VisuoHapticObject(f"{self.place}.{name}"), provenance=now, **parts))


_NUMBERS = (
    "resolution_m", "origin_x_m", "origin_y_m", "goal_x_m", "goal_y_m", "home_x_m", "home_y_m", "home_heading_rad",
)  # fmt: skip


def _agree(first: HapticTag, second: HapticTag) -> bool:
    """Whether frictions, or a friction and a bound, may be those of one object; of one in a hundred they are not."""
    frictions = [one for tag in (first, second) if (one := tag.static_friction_N) is not None]
    if len(frictions) == 2:
        a, b = frictions
        return abs(a.value - b.value) < AGREE_SIGMAS * math.hypot(a.sigma, b.sigma)
    bounds_N = [low for tag in (first, second) if (low := tag.min_static_friction_N) is not None]
    return all(one.value + AGREE_SIGMAS * one.sigma > low for one in frictions for low in bounds_N)


def recognise_container(
    seen_m: Float[np.ndarray, "k 2"],
    height_m: float,
    known: Sequence[RememberedContainer],
    touched_m: Float[np.ndarray, "n 2"],
) -> tuple[RememberedContainer, float] | None:
    """The known container with the observed radii, and its probability.

    Parameters
    ----------
    seen_m
        Radius and height of the slices that the camera sees (k, 2); none if all of it is transparent [m].
    height_m
        Height of its top [m].
    known
        Containers that stood here.
    touched_m
        Radius and height of contacts (n, 2) [m].
    """
    radius_m, z_m = np.vstack([seen_m, touched_m]).T
    own_m = np.repeat((RADIUS_M, TOUCHED_M), (len(seen_m), len(touched_m)))
    # Errors of adjacent slices are correlated: two thirds of the square.
    weight = np.repeat((1.0 / 1.5, 1.0), (len(seen_m), len(touched_m)))
    # Whether it was here before is as probable as not; all known containers are.
    logs = [math.log(0.5) - len(z_m) * math.log(ANY_RADIUS_M)]
    for one in known:
        off_m = np.interp(z_m, one.outline_m[:, 1], one.outline_m[:, 0]) - radius_m
        sigma_m = np.hypot(own_m, one.sigma_m)
        height = (height_m - float(one.outline_m[-1, 1])) / math.hypot(RADIUS_M, one.sigma_m)
        square = float(weight @ (off_m / sigma_m) ** 2) + height**2
        logs.append(math.log(0.5 / len(known)) - float(np.log(sigma_m).sum()) - 0.5 * square)
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    k = int(np.argmax(weights))
    return None if k == 0 or weights[k] < CONFIDENT_PROBABILITY else (known[k - 1], float(weights[k]))
