"""Object model: visual and haptic properties of an object; every part is optional."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .errors import InputError
from .measurement import normal_sigmas
from .ranges import FINITE, NON_NEGATIVE, check_numbers, within

#: Unsigned quantities of a haptic tag.
_MAGNITUDES = (
    "static_friction_N",
    "dynamic_friction_N",
    "deceleration_s",
    "deformability",
    "stiffness_N_per_m",
)
#: Stiffness features of an object: 16 heights and four sides; limit of low deformation [m]; nominal force [N] and deformation [m] of
#: the quadratic coefficient (Alt 2016, Sec. 6.1.6).
HEIGHTS, SIDES = 16, ("x+", "x-", "y+", "y-")
LOW_m, NOMINAL_N, NOMINAL_m = 0.003, 50.0, 0.01
#: By noise, a magnitude is below zero by more than this number of standard deviations once in 10^9.
_MAX_NOISE = normal_sigmas(2e-9)
#: A contact contour spans one contact of a platform; coordinates larger than any building are invalid.
_MAX_CONTOUR_M = 1e3


@dataclass(frozen=True, slots=True)
class Estimate:
    """A measured property. An unobserved property is ``None``, never an estimate of zero."""

    value: float  #: best estimate
    #: standard deviation of ``value`` as measured at this contact; 0 if the file does not state it
    sigma: float = 0.0
    spread: float = 0.0  #: standard deviation of the property over contact points and repetitions
    samples: int = 1  #: number of observations

    def __post_init__(self) -> None:
        if not (np.isfinite(self.value) and self.sigma >= 0 and self.spread >= 0 and self.samples >= 1):
            raise InputError(
                "Estimate",
                f"found value {self.value}, sigma {self.sigma}, spread {self.spread}, "
                f"samples {self.samples}; "
                "expected a finite value, sigma and spread >= 0, samples >= 1",
            )

    @classmethod
    def from_number(cls, value: float) -> Estimate:
        """An estimate with unspecified uncertainty.

        Parameters
        ----------
        value
            Value of the property, in its unit.
        """
        return cls(value)

    @property
    def predictive_sigma(self) -> float:
        """Standard deviation predicted for the next push, at another contact point."""
        return float(np.hypot(self.sigma, self.spread))


class PrimitiveKind(StrEnum):
    """Shapes fitted to a contact (Alt 2016, Sec. 3.3.3)."""

    LINE = "line"
    SEGMENT = "segment"
    CORNER = "corner"
    CIRCLE = "circle"


#: Number of parameters of a primitive, by kind.
_PARAMETERS = {
    PrimitiveKind.LINE: 3,
    PrimitiveKind.SEGMENT: 4,
    PrimitiveKind.CORNER: 4,
    PrimitiveKind.CIRCLE: 3,
}


@dataclass(frozen=True, slots=True, eq=False)
class Primitive:
    """A planar shape fitted to a contact, in the frame of the fitted points.

    ``parameters`` by kind [m, rad]:

    - line: (x, y, angle), a point on it and its direction
    - segment: (x1, y1, x2, y2), the end points
    - corner: (x, y, angle_1, angle_2), the tip and the directions of both edges
    - circle: (x, y, radius)
    """

    kind: PrimitiveKind
    parameters: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    score: float  #: S_p of Eq. (3.11), 0..1

    def check_read(self) -> None:
        """Reject invalid contents of a file: a wrong number of parameters for the kind, or non-finite values."""
        count = _PARAMETERS[self.kind]
        if self.parameters.shape != (count,) or self.covariance.shape != (count, count):
            raise InputError(
                "Primitive",
                f"found {len(self.parameters)} parameters and a covariance of shape {self.covariance.shape}, "
                f"expected {count} of a {self.kind}",
            )
        if not (np.isfinite(self.parameters).all() and np.isfinite(self.covariance).all()):
            raise InputError("Primitive", "found a number that is not finite")


@dataclass(frozen=True, slots=True, eq=False)
class HapticTag:
    """Response of an object to a push (Alt 2016, Sec. 4.1); ``None`` means not observed.

    Examples
    --------
    >>> tag = HapticTag(static_friction_N=Estimate(8.1, 0.3), min_static_friction_N=6.0, explored=1)
    >>> tag.needs_more_than(5.0), tag.needs_more_than(10.0)
    (True, False)
    >>> tag.updated(explored=2).explored
    2
    """

    static_friction_N: Estimate | None = None  #: H_F
    dynamic_friction_N: Estimate | None = None  #: H_F'
    deceleration_s: Estimate | None = None  #: H_I, duration of the motion after the platform stopped
    drift: Estimate | None = None  #: H_S [m/m], lateral shift of the contact per pushed distance
    deformability: Estimate | None = None  #: H_D [m/m], 0 = rigid, 1 = fully compliant
    stiffness_N_per_m: Estimate | None = None  #: pushing force over absolute deformation of the object
    rotation_rad_per_m: Estimate | None = None  #: H_R on the floor plane
    contact_offset_m: Estimate | None = None  #: lateral distance of the contact from the object's centre
    primitive: Primitive | None = None  #: best fitting shape
    deformation_shape_m: Float[np.ndarray, "k 2"] | None = None  #: contact contour at the largest force
    fixed: bool | None = None  #: does not move within the platform's capability
    falls: bool | None = None  #: fell over when pushed
    explored: int = 0  #: number of explorations
    failed: int = 0  #: number of failures
    #: lower bound of the static friction [N]: a push with this force did not move the object
    min_static_friction_N: float | None = None

    def check_read(self) -> None:
        """Reject invalid contents of a file.

        Magnitudes are nonnegative up to noise, counts strictly; bounds are finite, and a contour
        is not larger than a building.
        """
        for name in _MAGNITUDES:
            found: Estimate | None = getattr(self, name)
            if found is not None and found.value < -_MAX_NOISE * found.predictive_sigma:
                raise InputError("HapticTag", f"found {found.value:g}, expected >= 0", field=name)
        check_numbers("HapticTag", NON_NEGATIVE, explored=self.explored, failed=self.failed)
        check_numbers("HapticTag", FINITE, min_static_friction_N=self.min_static_friction_N)
        limits = within(-_MAX_CONTOUR_M, _MAX_CONTOUR_M)
        check_numbers("HapticTag", limits, deformation_shape_m=self.deformation_shape_m)

    def needs_more_than(self, force_N: float) -> bool:
        """Whether a push is known not to move the object, or the measured friction exceeds the push.

        Parameters
        ----------
        force_N
            Force of the push [N].
        """
        bound = self.min_static_friction_N
        if bound is not None and bound >= force_N:
            return True
        measured = (self.static_friction_N, self.dynamic_friction_N)
        return any(friction is not None and friction.value > force_N for friction in measured)

    def updated(self, **changes: Any) -> HapticTag:
        """A copy with some fields replaced.

        Parameters
        ----------
        changes
            New values by field name.
        """
        return replace(self, **changes)


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Shape of an object in its own frame: z is up, the origin on the floor below the centroid."""

    vertices_m: Float[np.ndarray, "v 3"] | None = None
    faces: Int[np.ndarray, "f 3"] | None = None
    footprint_m: Float[np.ndarray, "p 2"] | None = None  #: outline on the floor, counter-clockwise

    def check_read(self) -> None:
        """Reject faces with vertex indices out of range."""
        _check_faces(self.faces, 0 if self.vertices_m is None else len(self.vertices_m))


@dataclass(frozen=True, slots=True, eq=False)
class Appearance:
    """Visual appearance of the object."""

    template_png: bytes | None = None  #: image of a planar face
    template_size_m: tuple[float, float] | None = None  #: width and height


@dataclass(frozen=True, slots=True)
class Material:
    """Material of the object."""

    name: str = "unknown"
    youngs_modulus_Pa: Estimate | None = None
    poisson_ratio: Estimate | None = None
    density_kg_per_m3: Estimate | None = None
    wall_thickness_m: Estimate | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StiffnessMap:
    """Local stiffness of a surface under a dual-tip pinch (Alt 2016, Sec. 6.1.6)."""

    vertices_m: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    stiffness_N_per_m: Float[np.ndarray, "v"]
    stiffness_sigma_N_per_m: Float[np.ndarray, "v"]

    def check_read(self) -> None:
        """Reject faces with indices out of range, and a number of stiffnesses or sigmas that differs from the vertices."""
        count = len(self.vertices_m)
        _check_faces(self.faces, count)
        if not len(self.stiffness_N_per_m) == len(self.stiffness_sigma_N_per_m) == count:
            raise InputError("StiffnessMap", f"expected one stiffness and sigma for {count} vertices")


def _check_faces(faces: Int[np.ndarray, "f 3"] | None, count: int) -> None:
    if faces is not None and faces.size and not (faces.min() >= 0 and faces.max() < count):
        raise InputError("faces", f"faces refer to vertices outside 0..{count - 1}", field="faces")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Origin of a piece of information."""

    source: str = "unknown"  #: sensor, simulation or file
    t_s: float = float("nan")  #: time of acquisition, seconds since the epoch
    version: str = ""  #: version of the library that wrote it
    note: str = ""

    def check_read(self) -> None:
        """Reject an infinite time: it would take precedence in every merge."""
        if math.isinf(self.t_s):
            raise InputError("Provenance", f"found {self.t_s}, expected a finite number", field="t_s")


@dataclass(frozen=True, slots=True)
class Evidence:
    """One observation (or simulation) of one property; the property is estimated from all of them."""

    property: str  #: path in the object, with dots: "material.youngs_modulus_Pa", "parts.lid.tag.drift"
    estimate: Estimate
    provenance: Provenance = Provenance()
    key: str = ""  #: distinguishes otherwise identical observations, as "run 7, contact 2"


@dataclass(frozen=True, slots=True, eq=False)
class FeatureVector:
    """A feature vector of fixed length, for similarity search."""

    values: Float[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"] | None = None  #: standard deviations; None if unknown


@dataclass(frozen=True, slots=True, eq=False)
class ObjectPart:
    """Properties of a single part, such as a lid or a handle."""

    vertices: Int[np.ndarray, "k"] | None = None  #: indices of its vertices in the object's geometry
    material: Material | None = None
    tag: HapticTag | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ObjectState:
    """Haptic properties of the object in one state, such as "open", "closed" or "full"."""

    stiffness: StiffnessMap | None = None
    features: Mapping[str, FeatureVector] = field(default_factory=dict)  #: by kind
    tag: HapticTag | None = None


@dataclass(frozen=True, slots=True)
class Sighting:
    """Last known position of the object, and its context (Alt 2016, Sec. 6.3.3)."""

    position_m: tuple[float, float, float]  #: of the object's origin, in ``frame``
    sigma_m: float  #: standard deviation along each axis
    t_s: float  #: seconds since the epoch
    frame: str = "map"
    context: tuple[str, ...] = ()  #: room, furniture and neighbours, such as ("kitchen", "sink")

    def check_read(self) -> None:
        """Reject a non-finite position or time."""
        if not all(map(math.isfinite, (*self.position_m, self.sigma_m, self.t_s))) or self.sigma_m < 0:
            raise InputError("Sighting", "expected finite position_m, sigma_m >= 0 and t_s")


@dataclass(frozen=True, slots=True, eq=False)
class VisuoHapticObject:
    """All known properties of one object.

    Examples
    --------
    >>> cup = VisuoHapticObject("cup-1", visual_class="cup", tag=HapticTag(fixed=False), state={"fill": 0.5})
    >>> cup.visual_class, cup.tag.fixed, cup.state["fill"]
    ('cup', False, 0.5)
    """

    id: str
    name: str = ""
    geometry: Geometry | None = None
    appearance: Appearance | None = None
    material: Material | None = None
    stiffness: StiffnessMap | None = None
    tag: HapticTag | None = None
    state: Mapping[str, str | float] = field(default_factory=dict)  #: e.g. closed, fill level
    provenance: Mapping[str, Provenance] = field(default_factory=dict)  #: by field name
    #: visual class; several objects with different haptic models may share it
    visual_class: str = ""
    parts: Mapping[str, ObjectPart] = field(default_factory=dict)  #: by name
    states: Mapping[str, ObjectState] = field(default_factory=dict)  #: haptic models by state
    features: Mapping[str, FeatureVector] = field(default_factory=dict)  #: by kind
    evidence: tuple[Evidence, ...] = ()  #: what the estimates above were combined from
    seen: Sighting | None = None  #: last known position, specific to one robot
    licence: str = ""  #: licence of the data, an SPDX identifier
