"""Contents of a foam sensor's camera view at one time: plain geometry, shared by physics and renderer."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.camera.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A prism in any orientation, with a texture fixed to it."""

    outline_m: Float[np.ndarray, "n 2"]  #: cross section in its own frame, counter-clockwise
    height_m: float  #: from z = 0 to this in its own frame
    T_foam_solid: Pose  #: maps its own frame to frame F


@dataclass(frozen=True, slots=True, eq=False)
class SceneObject:
    """An upright prism in front of the sensor."""

    outline_foam_m: Float[np.ndarray, "n 2"]  #: cross section in frame F, counter-clockwise
    top_m: float = 0.3  #: height of its top above the sensor plane (z of frame F)
    grey: float = 90.0  #: mean grey level, 0..255
    texture: float = 0.0  #: amplitude of its surface texture in grey levels
    seed: int = 0  #: of the texture
    material: str = "cardboard"  #: kind of texture, a name of ``textures.MATERIALS``
    bgr: tuple[float, float, float] | None = None  #: mean colour in a colour image; ``None`` = grey
    solid: Solid | None = None  #: drawn in place of the upright prism, which still hides the sensor


@dataclass(frozen=True, slots=True, eq=False)
class FoamScene:
    """Strip, robot and surroundings in frame F of the sensor.

    Frame F: origin at the centre of the strip's back contour on the visible
    edge plane, x along the direction of exploration (away from the robot),
    y to the left along the strip, z up towards the camera. The back contour
    runs with increasing s; for a straight strip s grows with y.
    """

    t_s: float
    back_m: Float[np.ndarray, "n 2"]  #: back contour (B), glued to the robot
    front_m: Float[np.ndarray, "n 2"]  #: front contour, point i is material point i of ``back_m``
    objects: tuple[SceneObject, ...] = ()
    floor_below_m: float = 0.05  #: the floor is at z = -floor_below_m
    T_world_foam: Pose = field(default_factory=Pose.identity)  #: position of the floor's texture
    #: Inner edge of a stripe that is painted on the foam and deforms with it; ``None``: the stripe keeps
    #: its width behind the front.
    stripe_m: Float[np.ndarray, "n 2"] | None = None
