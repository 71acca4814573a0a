"""Transparency detection on tables with different glass (Fig. 5.6).

Points of the depth camera, coloured by height, with the detected regions in yellow and the true transparent
parts in blue, for thin plastic, thick glass, labelled and filled bottles (simulated depth camera and
scenes; no mirror).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.files import new_figure
from ...core.geometry import rotation_2d
from ...io.depth.depth_sequence import DepthFrame
from ...reconstruction.mesh import SurfaceMesh
from ...simulation.tabletop.glass_scenes import SCENE_KINDS, glass_scene
from .._solid import frame_3d, shaded
from ..output import Columns, Output
from ..worlds.virtual_glass import detected, judged, rendered


def run(out: Output) -> None:
    """One scene of each kind, with the published detector and with this library's.

    Parameters
    ----------
    out
        Receives the table ``scenes``, picture ``transparency``, and the comparisons; its seed and size are used.
    """
    kinds = SCENE_KINDS[2:3] if out.quick else SCENE_KINDS
    figure, axes = new_figure(
        1 if len(kinds) == 1 else 2,
        max(1, len(kinds) // 2),
        size=(11.0, 9.0),
        layout="constrained",
        projection="3d",
    )
    rows = Columns("kind method objects found false f1")
    for number, (kind, axis) in enumerate(zip(kinds, axes, strict=True)):
        scene = glass_scene(
            out.seed + 16 + number,
            kind=kind,
            arc_deg=105 if out.quick else 180,
            step_m=0.09 if out.quick else 0.045,
        )
        frames = rendered(scene, out.seed + 16 + number, 160 if out.quick else 320)
        for method in ("published", "consistency"):
            regions = detected(frames, method)
            said = judged(scene, regions)
            rows.add(kind, method, *(int(said[key]) for key in ("objects", "found", "false")), said["f1"])
        _draw(axis, frames, scene, regions)
        axis.set_title(f"{'abcd'[number]}  {kind}: {int(said['found'])} of {int(said['objects'])} found")
    out.table("scenes", rows)
    out.picture("transparency", figure, dpi=75)
    for method in ("published", "consistency"):
        chosen = [k for k, m in enumerate(rows["method"]) if m == method]
        found, objects, false = (sum(rows[key][k] for k in chosen) for key in ("found", "objects", "false"))
        name = "detector of Sec. 5.2" if method == "published" else "our detector"
        out.compare(f"{name}: objects found", 100 * found / objects, "%",
                    note=f"{found} of {objects}; the dissertation shows pictures of six objects")  # fmt: skip
        out.compare(f"{name}: false regions of a scene", false / len(chosen))


def _draw(axis: Any, frames: list[DepthFrame], scene: Any, regions: Any) -> None:
    clouds = []
    for frame in frames[:: max(1, len(frames) // 6)]:
        height, width = frame.depth_m.shape
        rows, columns = np.mgrid[0:height:2, 0:width:2]
        rays = frame.camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(float))
        depth = frame.depth_m[::2, ::2].reshape(-1, 1)
        points = frame.T_world_camera.apply(rays * depth)
        clouds.append(points[np.isfinite(points).all(axis=1)])
    points = np.concatenate(clouds)
    inside = (np.abs(points[:, :2]) < 0.42).all(axis=1) & (points[:, 2] > -0.01) & (points[:, 2] < 0.35)
    points = points[inside][:: max(1, int(inside.sum()) // 12000)]
    axis.scatter(*(1e3 * points).T, s=0.7, c=points[:, 2], cmap="copper", vmin=-0.05, vmax=0.25)
    for solid in scene.glass:
        theta, z = np.meshgrid(np.linspace(0, 2 * np.pi, 24), np.linspace(0.01, solid.height_m, 24))
        radius = solid.radius_m(z)
        ring = np.stack([solid.squash * radius * np.cos(theta), radius * np.sin(theta), z], axis=-1).reshape(
            -1, 3
        )
        ring[:, :2] = ring[:, :2] @ rotation_2d(solid.yaw_rad).T
        axis.plot(*(1e3 * (ring + np.asarray(solid.foot_m))).T, ".", ms=0.8, color="#0072b2")
    for region in regions:
        shaded(axis, SurfaceMesh(region.hull_m, region.faces), "#f0d21e", alpha=0.8)
    frame_3d(axis, (-0.4, -0.4, 0.0), (0.4, 0.4, 0.3), elev=28)
