"""Appearance of surfaces before the effects of lens and sensor, and the soft shadow of what stands on the floor."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32

from ...core import InputError, check_choice
from ._solids import at_height
from .rolling_view import RollingView
from .scene import FoamScene
from .textures import MATERIALS

#: The shadow is soft: it is computed on an image this many times smaller.
_REDUCTION = 8


@dataclass(frozen=True, slots=True)
class Surface:
    """Paint and texture of a surface."""

    grey: float  #: mean grey level, 0..255
    texture: float = 0.0  #: standard deviation of its texture [grey levels]
    material: str = "plain"  #: kind of texture, a name of ``textures.MATERIALS``
    bgr: tuple[float, float, float] | None = None  #: mean colour in a colour image; ``None`` = grey
    seed: int = 0  #: of the texture

    def __post_init__(self) -> None:
        check_choice("Surface", MATERIALS, self.material, field="material")

    def levels(self, channels: int) -> Float[np.ndarray, "channels"]:
        """Mean level of each channel.

        Parameters
        ----------
        channels
            1 grey, 3 blue, green, red.
        """
        if channels == 3 and self.bgr is not None:
            return np.array(self.bgr, dtype=np.float64)
        return np.full(channels, float(self.grey))


@dataclass(frozen=True, slots=True)
class Look:
    """Surfaces of sensor and floor, and their lighting."""

    foam: Surface = Surface(170.0, 0.0, "foam", (60.0, 140.0, 235.0))
    body: Surface = Surface(60.0, 0.0, "metal", (62.0, 60.0, 58.0))
    floor: Surface = Surface(100.0, 0.0, "concrete", (96.0, 101.0, 104.0))
    stripe: Surface | None = None  #: stripe along the front edge on top of the foam
    stripe_width_m: float = 0.003  #: width of the stripe, measured from the front edge
    foam_height_m: float = 0.01  #: height of the strip, if its side is visible
    body_margin_m: float = 0.03  #: length of the mounting plate beyond the strip's ends
    face_contrast: float = 0.0  #: relative difference of light between faces of an object
    shadow: float = 0.0  #: darkening of the floor close to objects and sensor, 0..1
    shadow_reach_m: float = 0.02  #: range of that darkening
    colour: bool = False  #: images in blue, green, red instead of grey

    @classmethod
    def photo(cls, *, colour: bool = False, stripe: bool = False) -> Look:
        """Textured surfaces with shading, nearly photorealistic.

        Parameters
        ----------
        colour
            Whether images have three channels.
        stripe
            Whether the front edge of the foam has a stripe.
        """
        return cls(
            foam=Surface(175.0, 3.5, "foam", (70.0, 165.0, 240.0)),
            body=Surface(52.0, 3.0, "metal", (56.0, 52.0, 49.0)),
            floor=Surface(112.0, 10.0, "planks", (74.0, 108.0, 138.0)),
            stripe=Surface(105.0, 2.0, "plain", (80.0, 165.0, 60.0)) if stripe else None,
            face_contrast=0.35,
            shadow=0.55,
            colour=colour,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Occluder:
    """A temporary occluder between camera and scene: a hand, a cable."""

    outline: Float[np.ndarray, "n 2"]  #: polygon in pixels, or in x, y of frame F [m] if a height is given
    height_m: float | None = None  #: z of the polygon in frame F; ``None`` = the outline is in pixels
    surface: Surface = field(default_factory=lambda: Surface(130.0, 6.0, "plain", (120.0, 150.0, 200.0)))
    start_s: float = -np.inf  #: visible from this time on
    end_s: float = np.inf  #: visible until this time
    velocity: tuple[float, float] = (0.0, 0.0)  #: of the outline [px/s or m/s], zero shift at ``start_s``

    def outline_at(self, t_s: float) -> Float[np.ndarray, "n 2"]:
        """The polygon at a time.

        Parameters
        ----------
        t_s
            Time [s].
        """
        outline = np.asarray(self.outline, dtype=np.float64)
        if not np.isfinite(self.start_s):
            if any(self.velocity):
                raise InputError(
                    "Occluder", "a moving occluder needs a finite start_s", field="start_s, velocity"
                )
            return outline
        return outline + (t_s - self.start_s) * np.asarray(self.velocity)


def shade_floor(
    view: RollingView, scene: FoamScene, outlines_m: list[np.ndarray], look: Look
) -> Float32[np.ndarray, "rows columns"]:
    """Light of the floor in each pixel of the image, reduced around the feet of outlines.

    Parameters
    ----------
    view
        Camera.
    scene
        Heights of the floor.
    outlines_m
        Outlines (n, K, 2) in frame F [m].
    look
        Strength and width of the shadow.
    """
    import cv2

    rows, columns = view.camera.height, view.camera.width
    small = np.zeros((rows // _REDUCTION + 1, columns // _REDUCTION + 1), np.uint8)
    for outline in outlines_m:
        polygon = view.polygon(at_height(outline, -scene.floor_below_m))
        if len(polygon) >= 3:
            fixed = np.rint((polygon + 0.5) / _REDUCTION * 16 - 8).astype(np.int32)
            cv2.fillPoly(small, [fixed], 255, shift=4)
    distance_m = float(np.linalg.norm(view.centre_foam_m))
    sigma = 0.6 * look.shadow_reach_m * view.camera.focal_px / distance_m / _REDUCTION
    soft = cv2.GaussianBlur(small.astype(np.float32), (0, 0), max(sigma, 0.3))
    factor = cv2.resize(
        1 - look.shadow / 255 * soft, (small.shape[1] * _REDUCTION, small.shape[0] * _REDUCTION)
    )
    # In one piece, like other layers: the kernels are compiled for each memory layout.
    return np.ascontiguousarray(factor[:rows, :columns])
