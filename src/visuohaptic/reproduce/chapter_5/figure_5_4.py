"""Reconstruction of partly transparent bottles (Fig. 5.4).

Left: fused surface (signed distance, 5 mm); it contains only labels and caps of the bottles. Middle: with the
regions found by the transparency detector, in yellow. Right: the true bottles (simulated depth camera and
objects).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.files import new_figure
from ...reconstruction.fusion.depth_fusion import TsdfVolume
from ...simulation.tabletop.glass_scenes import glass_scene
from .._solid import frame_3d, shaded
from ..output import Columns, Output
from ..worlds.virtual_glass import HIGH_M, LOW_M, detected, judged, rendered

VOXEL_m = 0.005


def run(out: Output) -> None:
    """Fuse, detect, and compare the surface of the bottles with ground truth.

    Parameters
    ----------
    out
        Receives the tables ``bottles`` and ``regions``, picture ``reconstruction``, and the comparisons; its seed and size are used.
    """
    scene = glass_scene(
        out.seed, kind="labelled", arc_deg=105 if out.quick else 180, step_m=0.09 if out.quick else 0.05
    )
    frames = rendered(scene, out.seed, 160 if out.quick else 320)
    volume = TsdfVolume.around(
        np.array(LOW_M), np.array(HIGH_M), 2 * VOXEL_m if out.quick else VOXEL_m, color=False
    )
    volume.integrate_all(frames)
    mesh = volume.mesh(2.0)
    regions = detected(frames, "consistency")
    said = judged(scene, regions)
    walls = [_wall_points(solid) for solid in scene.glass]
    rows = Columns("bottle part points reconstructed")
    from scipy.spatial import cKDTree

    tree = cKDTree(mesh.vertices_m)
    for number, (points, clear) in enumerate(walls):
        near = tree.query(points)[0] < 0.01
        for part, chosen in (("opaque", ~clear), ("transparent", clear)):
            if chosen.any():
                rows.add(number, part, int(chosen.sum()), float(near[chosen].mean()))
    out.table("bottles", rows)
    out.table("regions", {
        "x_m": [r.centroid_m[0] for r in regions] or [np.nan], "y_m": [r.centroid_m[1] for r in regions] or [np.nan],
        "z_m": [r.centroid_m[2] for r in regions] or [np.nan], "volume_m3": [r.volume_m3 for r in regions] or [np.nan],
    })  # fmt: skip
    figure, axes = new_figure(1, 3, size=(15.0, 4.2), layout="constrained", projection="3d")
    for axis, title in zip(axes, ("a  fused surface", "b  with transparency", "c  truth"), strict=True):
        axis.set_title(title)
        frame_3d(axis, (-0.4, -0.4, 0.0), (0.4, 0.4, 0.3), elev=25, zoom=1.9)
    used = mesh.vertices_m[mesh.faces].mean(axis=1)
    keep = (np.abs(used[:, :2]) < 0.4).all(axis=1) & (used[:, 2] > 0.01)
    from ...reconstruction.mesh import SurfaceMesh

    opaque = SurfaceMesh(mesh.vertices_m, mesh.faces[keep])
    for axis in axes[:2]:
        shaded(axis, opaque, "#c8564b")
    for region in regions:
        shaded(axes[1], SurfaceMesh(region.hull_m, region.faces), "#f0d21e", alpha=0.75)
    for points, clear in walls:
        axes[2].scatter(*(1e3 * points[clear]).T, s=1.5, color="#56b4e9")
        axes[2].scatter(*(1e3 * points[~clear]).T, s=1.5, color="#c8564b")
    out.picture("reconstruction", figure, dpi=80)
    for part in ("opaque", "transparent"):
        fractions = [s for p, s in zip(rows["part"], rows["reconstructed"], strict=True) if p == part]
        if fractions:
            out.compare(f"{part} wall that the fused surface has", 100 * float(np.mean(fractions)), "%",
                        note="a picture only: the transparent part is missing there" if part == "transparent" else "")  # fmt: skip
    out.compare("bottles whose transparent part is found", said["found"], f"of {said['objects']:.0f}")
    out.compare("false regions", said["false"])


def _wall_points(solid: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points on the outer wall, and mask of the transparent ones."""
    theta, z = np.meshgrid(
        np.linspace(0, 2 * np.pi, 48, endpoint=False), np.linspace(0.02, solid.height_m - 0.004, 60)
    )
    radius = solid.radius_m(z) * 0.97
    x, y = solid.squash * radius * np.cos(theta), radius * np.sin(theta)
    c, s = np.cos(solid.yaw_rad), np.sin(solid.yaw_rad)
    points = np.stack([c * x - s * y, s * x + c * y, z], axis=-1).reshape(-1, 3) + np.asarray(solid.foot_m)
    return points, solid.transparent_at(points)
