"""Local background model and error score of one view (Fig. 5.3).

Mean depth, standard deviation and reliability of the model from eight past views, the depth of the current
view, and the error score (simulated depth camera and bottles with labels).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...io.depth.depth_sequence import DepthFrame
from ...reconstruction.fusion.depth_noise import SENSOR_NOISE
from ...reconstruction.transparency.view_geometry import ideal_depth
from ...report.style import draw_axes
from ...simulation.tabletop import DepthCamera, glass_scene
from ..output import Output
from ..worlds.published_detector import background_model, error_image

#: Views 2 cm apart over 0.2 m, with a gap of 16 cm behind the current one.
STEP_m, VIEWS, GAP = 0.02, 8, 8


def run(out: Output) -> None:
    """Render the past views and the current one, build the model, compare.

    Parameters
    ----------
    out
        Receives the table ``pixels``, picture ``model``, and the comparisons; its seed and size are used.
    """
    scene = glass_scene(out.seed, kind="labelled", arc_deg=105, step_m=STEP_m)
    sensor = DepthCamera.kinect(160 if out.quick else 320)
    chosen = [*range(VIEWS), VIEWS + GAP]
    frames = [
        DepthFrame(0.1 * i, sensor.render(scene.scene, scene.poses[i], out.rng(i)), None, scene.poses[i],
                   sensor.camera, i)
        for i in chosen
    ]  # fmt: skip
    past, present = frames[:-1], frames[-1]
    model = background_model(past, present.T_world_camera, SENSOR_NOISE["kinect"])
    depth = ideal_depth(present)
    poses = [frame.T_world_camera for frame in past]
    error = error_image(model, depth, present.camera, present.T_world_camera, poses)
    glass = _shows_glass(scene, present)
    judged = model.reliability > 0
    bad = error > 0
    rows, columns = np.nonzero(judged)
    pick = slice(None, None, max(1, len(rows) // 20000))
    out.table(
        "pixels",
        {
            "row": rows[pick], "column": columns[pick], "mean_m": model.mean_m[judged][pick],
            "sigma_m": model.sigma_m[judged][pick], "reliability": model.reliability[judged][pick],
            "depth_m": depth[judged][pick], "error": error[judged][pick], "glass": glass[judged][pick],
        },
    )  # fmt: skip

    def draw(*axes: Any) -> None:
        near, far = np.nanpercentile(depth, [1, 99])
        for axis, (title, image, low, high, colours) in zip(
            axes,
            (
                ("a  depth of the view [m]", depth, near, far, "viridis"),
                ("b  mean of the model [m]", model.mean_m, near, far, "viridis"),
                ("c  standard deviation [mm]", 1e3 * model.sigma_m, 0, 30, "magma"),
                ("d  reliability", model.reliability, 0, 1, "gray"),
                ("e  error score", error, 0, 1, "inferno"),
                ("f  true transparent parts", glass, 0, 1, "gray"),
            ),
            strict=True,
        ):
            shown = axis.imshow(image, vmin=low, vmax=high, cmap=colours)
            axis.figure.colorbar(shown, ax=axis, shrink=0.7)
            axis.set(title=title, xticks=[], yticks=[])
            axis.grid(visible=False)

    out.picture("model", draw_axes(2, 3, draw, size=(12.0, 6.4)), dpi=85)
    opaque = judged & ~glass
    out.compare("views of the model", model.views, dissertation=8)
    out.compare("reliable pixels", 100 * float(judged.mean()), "%")
    out.compare("flagged of reliable opaque pixels", 100 * float(bad[opaque].mean()), "%",
                note="the dissertation shows a picture only")  # fmt: skip
    both = judged & glass
    if both.any():
        out.compare("flagged of reliable glass pixels", 100 * float(bad[both].mean()), "%")


def _shows_glass(scene: Any, frame: DepthFrame) -> np.ndarray:
    """Pixels whose ray passes through a transparent part: sampled along the ray, 5 mm apart."""
    height, width = frame.depth_m.shape
    rows, columns = np.mgrid[0:height, 0:width]
    rays = frame.camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
    found = np.zeros(height * width, dtype=bool)
    limit = np.nan_to_num(frame.depth_m.ravel(), nan=np.inf)
    for z in np.arange(0.4, 1.6, 0.005):
        points = frame.T_world_camera.apply(rays * z)
        found |= scene.truth(points) & ((z < limit) | ~np.isfinite(limit))
    return found.reshape(height, width)
