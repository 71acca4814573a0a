"""A surface with data per vertex: colours, or numbers such as the uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.errors import InputError
from ..io.meshes.ply import PlyMesh
from .access_control import reported
from .server import markdown_text
from .stage import Stage, scale_colours

_OWN, _PLAIN = "its colours", "plain"


class SurfaceView:
    """A mesh or point cloud; every vertex field can be shown, uncertainty (``sigma...``) first.

    Parameters
    ----------
    title
        Headline.
    mesh
        Mesh or points, with vertex fields.
    """

    def __init__(self, title: str, mesh: PlyMesh) -> None:
        if not len(mesh.vertices_m):
            raise InputError(title, "has no vertices")
        self.title, self.mesh = title, mesh
        names = sorted(mesh.fields, key=lambda name: (not name.startswith("sigma"), name))
        self.choices: tuple[str, ...] = (
            *names,
            *((_OWN,) if mesh.colors is not None else ()),
            *(() if names or mesh.colors is not None else (_PLAIN,)),
        )

    def draw(self, stage: Stage) -> None:
        """Draw the mesh and a selector of the coloured field.

        Parameters
        ----------
        stage
            Empty stage.
        """
        gui = stage.gui
        stage.keep("legend", gui.add_markdown("", order=10))
        choice = stage.keep("choice", gui.add_dropdown("colours", self.choices, order=11))

        def recolour(_: Any) -> None:
            self.paint(stage, choice.value)

        choice.on_update(reported(recolour))
        self.paint(stage, self.choices[0])
        low, high = self.mesh.vertices_m.min(axis=0), self.mesh.vertices_m.max(axis=0)
        x, y, z = (0.5 * (low + high)).tolist()
        stage.look((x, y, z), max(float(np.linalg.norm(high - low)), 0.05))

    def paint(self, stage: Stage, choice: str) -> None:
        """Colour by one of ``choices``.

        Parameters
        ----------
        stage
            Stage on which it was drawn.
        choice
            One of ``choices``.
        """
        mesh = self.mesh
        text = f"**{markdown_text(self.title)}**: {len(mesh.vertices_m)} vertices"
        if choice == _OWN and mesh.colors is not None:
            tint = np.asarray(mesh.colors, np.uint8)
        elif choice == _PLAIN:
            tint = np.full((len(mesh.vertices_m), 3), 170, np.uint8)
        else:
            values = np.asarray(mesh.fields[choice], dtype=np.float64)
            finite = values[np.isfinite(values)]
            low, high = np.percentile(finite, [2, 98]) if finite.size else (0.0, 1.0)
            tint = scale_colours(values, float(low), float(high))
            text += f", {markdown_text(choice)} from {low:.3g} (pale) to {high:.3g} (dark red)"
        stage.get("legend").content = text
        if len(mesh.faces):
            stage.mesh("surface", mesh.vertices_m, mesh.faces, tint)
            return
        stage.drop("surface")
        size = max(float(np.ptp(mesh.vertices_m, axis=0).max()), 0.01) / 200
        points = stage.scene.add_point_cloud(
            "/view/surface", mesh.vertices_m.astype(np.float32), tint, point_size=size
        )
        stage.keep("surface", points)
