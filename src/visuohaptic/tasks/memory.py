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
from ..recognition.touch.contents import SCALE
from ..recognition.touch.haptic_model import UNKNOWN
from .mobile.floor_outline import POINT_M, FloorOutline
from .mobile.known_objects import CONFIDENT_PROBABILITY, recognise, remembered_outline

#: An object within this distance of its last position has not been moved [m].
MOVED_M = 0.15
#: Standard deviations, measured on containers of open houses: of a radius that is seen, half of whose error is common to all heights,
#: and of one that is touched [m]. Number of heights at which outlines are stored.
SEEN_M, TOUCHED_M, HEIGHTS = 0.001, 0.001, 24
#: Standard deviation of the height of an outline [m]: rms of eight transparent containers of open houses .37 mm (mean +.07), of
#: two opaque ones .25 mm; of six bottles of the office .21 mm (+.06; ``benchmarks.completed_outlines --seeds open --count 6``).
HEIGHT_SIGMA_M = 4e-4
#: Root mean square variation of the logarithms of radius and height within a class, over the six classes of containers; radii are
#: correlated in proportion to what is left of the height. And of any containers, about the mean radius and height [m].
SIBLING, ANY, USUAL_M = (0.067, 0.080), (0.4, 0.35), (0.033, 0.16)
#: Fraction of slices in which the camera sees the background through the wall: one of 75, of twelve scans of open houses.
REFRACTED, LOG_TWO_PI = 1 / 75, math.log(2.0 * math.pi)
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
    outline_m: Float[np.ndarray, "k 2"]  #: radii and heights, from the ground
    sigma_m: float | Float[np.ndarray, "k"]  #: standard deviation of its radii
    lid: str = UNKNOWN  #: ``open``, ``closed``, or ``UNKNOWN`` where the last visit did not decide
    fill: float = 0.0
    wall_m: float = math.nan  #: thickness
    alike: tuple[str, ...] = ()  #: of a recognised one: other stored ones of its class that it may be instead

    def __post_init__(self) -> None:
        shape = np.shape(self.outline_m)
        if len(shape) != 2 or shape[0] < 2 or shape[1] != 2:
            raise InputError(
                "RememberedContainer", f"found shape {shape}, expected (k, 2) with k > 1", field="outline_m"
            )


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
        """Containers that stood on a table, as far as their outlines have positive radii and a height."""
        found = []
        for one in self._objects("table"):
            shape = one.features.get("outline")
            if shape is None or len(shape.values) != HEIGHTS + 1 or shape.sigma is None:
                continue
            if not (shape.values > 0.0).all():  # its logarithms would leave no container recognised
                continue
            heights = np.linspace(0.0, float(shape.values[-1]), HEIGHTS)
            state, wall = one.state, None if one.material is None else one.material.wall_thickness_m
            found.append(
                RememberedContainer(
                    self._name(one), one.visual_class, float(state.get("class_probability", 0.0)),
                    np.column_stack([shape.values[:-1], heights]), shape.sigma[:-1],
                    str(state.get("lid", UNKNOWN)), float(state.get("fill", 0.0)),
                    math.nan if wall is None else wall.value,
                )
            )  # fmt: skip
        return found

    def store_bottle(self, bottle: RememberedContainer) -> None:
        """Store a container; a new name is created if its own is empty.

        Parameters
        ----------
        bottle
            Its properties.
        """
        name = bottle.id or f"table-{len(self._objects('table')) + 1}"
        height = float(bottle.outline_m[-1, 1])
        sigma_m = np.broadcast_to(bottle.sigma_m, len(bottle.outline_m))
        at = np.linspace(0.0, height, HEIGHTS)
        radii, sigmas = (
            np.interp(at, bottle.outline_m[:, 1], one) for one in (bottle.outline_m[:, 0], sigma_m)
        )
        self._keep(
            name,
            visual_class=bottle.class_name,
            features={"outline": FeatureVector(np.append(radii, height), np.append(sigmas, HEIGHT_SIGMA_M))},
            material=None if math.isnan(bottle.wall_m) else Material(wall_thickness_m=Estimate(bottle.wall_m, SCALE * bottle.wall_m)),
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
    """The known container with the observed height and radii, and its probability.

    The others are any new container, and, as probable as that, one that resembles a known container as two of its class
    resemble each other: an observation that both would have alike is no evidence of identity. Known containers of one class
    that would be recognised as each other are recognised as either, with the mean of their outlines.

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

    Returns
    -------
    tuple or None
        ``None`` if the most probable one, with those alike, has a probability below ``CONFIDENT_PROBABILITY``.
    """
    if not known:
        return None
    radius_m, z_m = np.vstack([seen_m, touched_m]).T
    values, count = np.log(np.append(radius_m, height_m)), len(seen_m)
    common = np.zeros((len(values), len(values)))
    common[:count, :count] = 0.5
    errors_m = np.append(np.repeat((SEEN_M, TOUCHED_M), (count, len(touched_m))), HEIGHT_SIGMA_M)
    errors = errors_m / np.exp(values)
    noise = np.outer(errors, errors) * (common + np.diag(1.0 - np.diag(common)))
    left = np.clip(1.0 - np.abs(z_m[:, None] - z_m) / height_m, 0.0, 1.0)

    strays = (values[:count] - math.log(USUAL_M[0])) / ANY[0]
    background = math.log(REFRACTED) - math.log(ANY[0]) - 0.5 * (strays**2 + LOG_TWO_PI)

    def log_density(means: np.ndarray, covariance: np.ndarray, spread: tuple[float, float]) -> float:
        whole, logs = covariance.copy(), []
        whole[:-1, :-1] += spread[0] ** 2 * left
        whole[-1, -1] += spread[1] ** 2
        for refracted in range(-1, count):  # none, or one of the slices
            kept = np.arange(len(values)) != refracted
            part = whole[np.ix_(kept, kept)]
            white = np.linalg.solve(np.linalg.cholesky(part), (values - means)[kept])
            log = -0.5 * white @ white - 0.5 * np.linalg.slogdet(part)[1] - 0.5 * len(white) * LOG_TWO_PI
            logs.append(log if refracted < 0 else log + background[refracted])
        return float(np.logaddexp.reduce(logs))

    # Whether it was here before is as probable as not; all known containers are.
    usual = np.log(np.append(np.full(len(z_m), USUAL_M[0]), USUAL_M[1]))
    same, other = [], [log_density(usual, noise, ANY)]
    for one in known:
        means, sigma_m = map(np.append, _radii_at(one, z_m), (one.outline_m[-1, 1], HEIGHT_SIGMA_M))
        covariance = noise + np.diag((sigma_m / means) ** 2)
        same.append(log_density(np.log(means), covariance, (0.0, 0.0)))
        other.append(log_density(np.log(means), covariance, SIBLING) - math.log(len(known)))
    best = max(*same, *other)
    weights = np.exp(np.array(same) - math.log(len(known)) - best)
    weights /= weights.sum() + 0.5 * np.exp(np.array(other) - best).sum()
    k = int(np.argmax(weights))
    # Which of those that would be taken for it themselves it is, does not matter.
    for j, one in enumerate(known):
        if j != k and (
            one.class_name != known[k].class_name
            or recognise_container(one.outline_m, one.outline_m[-1, 1], [known[k]], touched_m[:0]) is None
        ):
            weights[j] = 0.0
    probability = float(weights.sum())
    return (
        (_either(known, k, weights / probability), probability)
        if probability >= CONFIDENT_PROBABILITY
        else None
    )


def _either(
    known: Sequence[RememberedContainer], best: int, weights: Float[np.ndarray, "n"]
) -> RememberedContainer:
    """The best one with the outline of a mixture; the weights sum to 1."""
    at_m = known[best].outline_m[:, 1]
    radii_m, sigmas_m = np.array([_radii_at(one, at_m) for one in known]).transpose(1, 0, 2)
    mean_m = weights @ radii_m
    return replace(
        known[best],
        outline_m=np.column_stack([mean_m, at_m]),
        sigma_m=np.sqrt(weights @ (sigmas_m**2 + (radii_m - mean_m) ** 2)),
        alike=tuple(
            one.id for one, weight in zip(known, weights, strict=True)
            if weight > 1.0 - CONFIDENT_PROBABILITY and one is not known[best]
        ),
    )  # fmt: skip


def _radii_at(
    one: RememberedContainer, at_m: Float[np.ndarray, "k"]
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Radii at some heights and their standard deviations [m]."""
    z_m = one.outline_m[:, 1]
    sigma_m = np.broadcast_to(one.sigma_m, len(z_m))
    return np.interp(at_m, z_m, one.outline_m[:, 0]), np.interp(at_m, z_m, sigma_m)
