"""What a push is planned in: an object, the local costmap around it, and the platform (Alt 2016, Sec. 4.3)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.geometry import polygon_centroid
from ...core.objects import HapticTag
from ...core.ranges import NON_NEGATIVE, POSITIVE, check_ranges
from ...io.maps.occupancy_map import OccupancyMap
from ...navigation.pushing.push_model import PushModel
from .local_costmap import FootprintSamples, LocalCostmap

__all__ = ["PushLimits", "PushScene", "PushedObject"]


@dataclass(frozen=True, slots=True)
class PushLimits:
    """The platform as far as a push is concerned."""

    radius_m: float = field(default=0.17, metadata=POSITIVE)
    v_push_m_s: float = field(default=0.05, metadata=POSITIVE)
    setup_time_s: float = field(default=4.0, metadata=NON_NEGATIVE)
    push_force_max_N: float = field(default=20.0, metadata=POSITIVE)
    #: angle between push and the outline's normal at the contact; more would slide
    tolerance_rad: float = field(default=0.35, metadata=POSITIVE)

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, slots=True, eq=False)
class PushedObject:
    """What is known of an object that has to be pushed aside."""

    footprint_m: Float[np.ndarray, "p 2"]  #: outline, map frame
    tag: HapticTag | None = (
        None  #: from former pushes; one that is fixed, falls or is too heavy is never pushed
    )
    #: direction of the push behind ``tag`` on the object as it now stands, map frame: with it the contact goes to
    #: the centre of friction that the tag implies
    tag_direction_rad: float | None = None
    #: outline about the footprint's centroid, supports, contact friction; without one a flat bottom is assumed
    model: PushModel | None = None

    def pushable(self, limits: PushLimits) -> bool:
        """Whether the tag allows a push by this platform.

        Parameters
        ----------
        limits
            The platform, of which the largest force counts.
        """
        tag = self.tag
        return tag is None or not (tag.fixed or tag.falls or tag.needs_more_than(limits.push_force_max_N))


@dataclass(frozen=True, slots=True, eq=False)
class PushScene:
    """One object without which the costmap is, and the platform that pushes it."""

    costmap: LocalCostmap
    footprint: FootprintSamples  #: the outline of ``model``, sampled for the platform's radius
    model: PushModel
    object_m: tuple[float, float, float]  #: x, y [m], yaw [rad] of the model's reference point, map frame
    limits: PushLimits

    @classmethod
    def of(
        cls,
        map: OccupancyMap,
        obj: PushedObject,
        limits: PushLimits,
        reach_m: float,
    ) -> PushScene:
        """Cut the local costmap out of a map and sample the object's footprint.

        Parameters
        ----------
        map
            With or without the object's cells.
        obj
            The object.
        limits
            The platform.
        reach_m
            How far from the outline planning goes [m].

        Raises
        ------
        InputError
            The footprint is not an outline or not on the map.
        """
        outline = np.asarray(obj.footprint_m, dtype=np.float64)
        costmap = LocalCostmap.around(map, outline, reach_m)
        place = polygon_centroid(outline)
        model = obj.model if obj.model is not None else PushModel.patch(outline - place)
        footprint = FootprintSamples.of(
            model.outline_m, limits.radius_m, costmap.map.resolution_m, round_m=model.round_m
        )
        return cls(costmap, footprint, model, (float(place[0]), float(place[1]), 0.0), limits)
