"""A press that pushes known shapes into foam, with exact ground truth: the bench of Alt 2016, Fig. 3.2 and 3.7."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from ...core import InputError, finite_array
from ..rendering.scene import FoamScene, SceneObject
from .outline import Outline
from .strip import FoamStrip, StripState
from .strip_geometry import FoamStripGeometry
from .strip_law import SOFT_FOAM, StripLaw

#: Maximum motion of the plate per step (m).
STEP_M = 1e-4
#: Speed of the press (m/s).
SPEED_M_S = 0.01


class PressShape(StrEnum):
    """Test shapes of Fig. 3.7b."""

    CYLINDER_4CM = "A4"
    CYLINDER_12CM = "A12"
    LARGE_PLATE = "B"
    PLATE_4CM = "C"


@dataclass(frozen=True, slots=True, eq=False)
class PressSample:
    """Static state of the press at one depth."""

    t_s: float
    depth_m: float  #: travel of the shape after first touch
    direction: str  #: "loading" or "unloading"
    force_N: float  #: true force of the foam on the shape, along the direction of travel
    strip: StripState  #: true profiles
    scene: FoamScene  #: view of the camera


def press_outline(
    shape: PressShape, depth_m: float, *, width_m: float = 0.02, centre_m: float = 0.0, yaw_rad: float = 0.0
) -> Outline:
    """Cross section of a test shape in frame F whose foremost point has penetrated the foam by ``depth_m``.

    Parameters
    ----------
    shape
        Test shape.
    depth_m
        Depth of its foremost point below the undeformed front [m].
    width_m
        Undeformed width of the foam, from back to front [m].
    centre_m
        Position of its centre along y [m].
    yaw_rad
        Rotation about its foremost point [rad].
    """
    reach = {
        PressShape.CYLINDER_4CM: Outline.disc((0.02, 0.0), 0.02),
        PressShape.CYLINDER_12CM: Outline.disc((0.06, 0.0), 0.06),
        PressShape.LARGE_PLATE: Outline.box((0.01, 0.0), (0.02, 0.6)),
        PressShape.PLATE_4CM: Outline.box((0.01, 0.0), (0.02, 0.04), edge_m=0.0005),
    }
    return reach[PressShape(shape)].moved(0.0, 0.0, yaw_rad).moved(width_m - depth_m, centre_m)


def press_path(max_m: float, steps: int, *, runs: int = 1, unload: bool = True) -> Float[np.ndarray, "n"]:
    """Depths of stepwise runs from 0 to ``max_m`` and back.

    Parameters
    ----------
    max_m
        Deepest point of each run [m].
    steps
        Number of equal steps down to it.
    runs
        Number of runs, one after the other.
    unload
        Whether to include the steps back; otherwise a run ends with one move to 0.

    Raises
    ------
    InputError
        The depth is not positive or there are no steps.
    """
    if not (max_m > 0 and steps >= 1 and runs >= 1):
        raise InputError(
            "press_path", f"found {max_m} m in {steps} steps, expected a depth > 0 and steps >= 1"
        )
    up = np.linspace(0.0, max_m, steps + 1)
    run = np.concatenate([up, up[-2::-1]]) if unload else np.concatenate([up, [0.0]])
    return np.concatenate([run] * runs)


def press(
    shape: PressShape,
    depths_m: Sequence[float] | Float[np.ndarray, "n"],
    *,
    geometry: FoamStripGeometry | None = None,
    law: StripLaw = SOFT_FOAM,
) -> Iterator[PressSample]:
    """Move a shape at 1 cm/s through a path of depths, in the middle of the strip; a sample at every one of them.

    Parameters
    ----------
    shape
        Test shape.
    depths_m
        Path [m], see :func:`press_path`.
    geometry, law
        The foam strip and its material.

    Raises
    ------
    InputError
        A depth is beyond the strip.
    """
    strip = FoamStrip(geometry, law)
    width = strip.geometry.width_m
    path = finite_array("press", depths_m, None, field="depths_m", least=0)
    if path.max(initial=0.0) > 0.9 * width:
        raise InputError("press", f"found depths {path}, expected a list of at most {0.9 * width:.4f} m")
    t_s, now, direction = 0.0, 0.0, "loading"
    back = strip.geometry.back_m(strip.s_m)
    for target in path:
        if target != now:
            direction = "loading" if target > now else "unloading"
        count = max(1, int(np.ceil(abs(target - now) / STEP_M)))
        elapsed = abs(target - now) / SPEED_M_S / count
        for depth in np.linspace(now, target, count + 1)[1:]:
            outline = press_outline(shape, float(depth), width_m=width)
            state = strip.press([outline], elapsed)
        now, t_s = float(target), t_s + elapsed * count
        body = SceneObject(outline.polygon_m(), top_m=0.01)
        yield PressSample(
            t_s=t_s,
            depth_m=now,
            direction=direction,
            force_N=float(state.force_N[0]),
            strip=state,
            scene=FoamScene(t_s=t_s, back_m=back, front_m=state.front_m, objects=(body,)),
        )


def calibration_press(
    *,
    geometry: FoamStripGeometry | None = None,
    law: StripLaw = SOFT_FOAM,
    steps: int = 60,
    runs: int = 3,
    reference_sigma_N: float = 0.0,
    rng: np.random.Generator | None = None,
) -> list[tuple[float, float, str]]:
    """Calibration rows (strain, stress_Pa, direction) measured with a large plate (Sec. 3.2), down to a strain of 0.6.

    The stress is the force by the area of the front; write the rows with
    :func:`~visuohaptic.simulation.foam.strip_law.write_calibration_csv`.

    Parameters
    ----------
    geometry, law
        The foam strip and its material.
    steps, runs
        Steps of each run, and number of runs.
    reference_sigma_N
        Standard deviation of the force sensor [N].
    rng
        Source of the force sensor's noise; seed 0 by default.
    """
    geometry = geometry if geometry is not None else FoamStripGeometry()
    rng = rng if rng is not None else np.random.default_rng(0)
    area = geometry.length_m * geometry.height_m
    return [
        (strain, (force_N + reference_sigma_N * float(rng.standard_normal())) / area, direction)
        for strain, force_N, direction in _pressed(geometry, law, steps, runs)
    ]


@lru_cache(maxsize=8)
def _pressed(
    geometry: FoamStripGeometry, law: StripLaw, steps: int, runs: int
) -> tuple[tuple[float, float, str], ...]:
    """Strain, force [N] and direction without sensor noise: identical for every sensor of one foam."""
    path = press_path(0.6 * geometry.width_m, steps, runs=runs)
    samples = press(PressShape.LARGE_PLATE, path, geometry=geometry, law=law)
    return tuple((x.depth_m / geometry.width_m, x.force_N, x.direction) for x in samples)
