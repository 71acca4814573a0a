"""A deformable object: stiffness map, response of a point to force, and grasps."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import StiffnessMap, VisuohapticError
from ..core.files import ramp_colours
from ..deformation import Contents, ShellObject, object_map
from ..deformation.maps.map_file import colours
from ..grasping import GraspTask, confirm_grasp, grasp_scores, predicted_shape
from ..grasping.planner import GraspPlan, plan_grasps, plan_map
from .access_control import reported
from .server import markdown_text
from .stage import Stage, hit_face

_SHADES = ("stiffness", "grasp score", "contact", "curvature", "height", "deformation")
_PICK = "Click a point of the surface to see its force-deformation curve."


@dataclass(frozen=True, slots=True, eq=False)
class Picked:
    """Properties of a selected surface point."""

    vertex: int
    point_m: Float[np.ndarray, "3"]
    stiffness_N_per_m: float
    sigma_N_per_m: float
    score: float  #: grasp score at the force
    curve_m: Float[np.ndarray, "k"]  #: deformation of one side
    curve_N: Float[np.ndarray, "k"]  #: force of one finger
    shape_m: Float[np.ndarray, "v 3"] | None  #: deformed vertices at the force; None for a map without object
    nonlinear: bool  #: curve and shape come from the nonlinear simulation
    note: str = ""  #: remark on the result


class ObjectView:
    """A container, or only a stiffness map.

    Parameters
    ----------
    title
        Name on the page.
    surface
        Stiffness map.
    container
        The object; without it, there are no shapes and no nonlinear curves.
    task
        State, hand and limits; its force is the initial value of the slider.
    """

    def __init__(
        self,
        title: str,
        surface: StiffnessMap,
        *,
        container: ShellObject | None = None,
        task: GraspTask | None = None,
    ) -> None:
        self.title = title
        self.surface = surface
        self.container = container
        self.task = task or GraspTask(force_N=10.0)
        if self.task.force_N is None:
            self.task = replace(self.task, force_N=10.0)
        self._stage: Stage | None = None
        self._lock = threading.RLock()

    @classmethod
    def of_object(cls, container: ShellObject, task: GraspTask | None = None) -> ObjectView:
        """Compute and display the map of an object.

        Parameters
        ----------
        container
            Container as a shell.
        task
            Force, state and hand; 10 N by default.
        """
        task = task or GraspTask(force_N=10.0)
        contents = Contents(fill=task.fill) if task.closed else None
        return cls(container.name, object_map(container, contents), container=container, task=task)

    @property
    def force_N(self) -> float:
        """Force of each finger, set by the slider."""
        return float(self.task.force_N or 10.0)

    # -- Computation ----------------------------------------------------------------------

    def pick(self, vertex: int, *, nonlinear: bool = False) -> Picked:
        """Curve and shape of one surface point.

        Parameters
        ----------
        vertex
            Index of the surface vertex.
        nonlinear
            Simulate large deformations, which takes seconds.
        """
        k = float(self.surface.stiffness_N_per_m[vertex])
        sigma = float(self.surface.stiffness_sigma_N_per_m[vertex])
        score = float(self._scores().pair[vertex])
        force = np.linspace(0.0, self.force_N, 9)
        # Where the wall is held, the stiffness is infinite; without an opposite wall, it is unknown.
        curve = force / k if k > 0 else np.zeros_like(force)
        picked = Picked(vertex, self.surface.vertices_m[vertex], k, sigma, score, curve, force, None, False)
        if self.container is None or not (np.isfinite(k) and k > 0):
            return picked
        contents = Contents(fill=self.task.fill) if self.task.closed else None
        if not nonlinear:
            shape = predicted_shape(self.container, vertex, self.force_N, contents)
            return replace(picked, shape_m=shape.points_m)
        limit = self.task.parameters.max_deformation_m
        confirmation = confirm_grasp(
            self.container, vertex, self.force_N, contents=contents, max_deformation_m=limit
        )
        return replace(
            picked,
            curve_m=confirmation.curve_m,
            curve_N=confirmation.curve_N,
            shape_m=confirmation.shape_m,
            nonlinear=True,
            note=confirmation.reason,
        )

    def rank(self, count: int = 5) -> GraspPlan:
        """Rank grasps at the current force.

        Parameters
        ----------
        count
            Maximum number of grasps.
        """
        if self.container is None:
            return plan_map(self.surface, replace(self.task, fill=0.0), count=count)
        return plan_grasps(self.container, self.task, count=count, confirm=False, surface=self.surface)

    def _scores(self) -> Any:
        axis = None if self.container is None else self.container.axis_point_m
        return grasp_scores(self.surface, self.force_N, self.task.parameters, axis_point_m=axis)

    # -- Drawing -------------------------------------------------------------------------

    def draw(self, stage: Stage) -> None:
        """Draw the mesh, sliders, and fields for the results of a click.

        Parameters
        ----------
        stage
            Empty stage, which keeps mesh and sliders.
        """
        self._stage = stage
        gui = stage.gui
        stage.keep("legend", gui.add_markdown("", order=10))
        shade = stage.keep("shade", gui.add_dropdown("colours", _SHADES, order=11))
        low_N, max_N = min(0.5, self.force_N), max(30.0, 2 * self.force_N)
        force = stage.keep(
            "force",
            gui.add_slider("force [N]", low_N, max_N, low_N, self.force_N, order=12),
        )
        deep = stage.keep(
            "deep",
            gui.add_checkbox("nonlinear (takes seconds)", False, order=13, disabled=self.container is None),
        )
        ranked = stage.keep("rank", gui.add_button("rank grasps", order=14))
        stage.keep("picked", gui.add_markdown(_PICK, order=15))
        stage.keep("grasps", gui.add_markdown("", order=17))

        def recolour(_: Any) -> None:
            with self._lock:
                self.task = replace(self.task, force_N=float(force.value))
                stage.drop("shape")
                self.paint(shade.value)

        def rank(_: Any) -> None:
            with self._lock:
                self.show_grasps()

        shade.on_update(reported(recolour))
        force.on_update(reported(recolour))
        ranked.on_click(reported(rank))
        self._deep = deep
        self.paint(_SHADES[0])
        used = self.surface.vertices_m[np.unique(self.surface.faces)]
        low, high = used.min(axis=0), used.max(axis=0)
        x, y, z = (0.5 * (low + high)).tolist()
        stage.look((x, y, z), float(np.linalg.norm(high - low)))

    def paint(self, shade: str) -> None:
        """Colour the mesh.

        Parameters
        ----------
        shade
            ``stiffness``, ``grasp score``, or one of its factors.
        """
        assert self._stage is not None
        values = self.surface.stiffness_N_per_m
        if shade == "stiffness":
            finite = values[np.isfinite(values)]
            low, high = np.percentile(finite, [2, 98]) / 1e3 if finite.size else (0.0, 0.0)
            text = f"stiffness from {low:.3g} (dark) to {high:.3g} N/mm (yellow)"
            tint = colours(values)
        else:
            scores = self._scores()
            found = scores.pair if shade == "grasp score" else getattr(scores, shade)
            text = f"{shade} from 0 (dark) to 1 (yellow) at {self.force_N:g} N; best {found.max():.2f}"
            tint = ramp_colours(found)
        self._stage.get("legend").content = f"**{markdown_text(self.title)}**: {text}"
        self._stage.mesh("object", self.surface.vertices_m, self.surface.faces, tint, self._clicked)

    def _clicked(self, origin_m: np.ndarray, direction: np.ndarray) -> None:
        found = hit_face(self.surface.vertices_m, self.surface.faces, origin_m, direction)
        if found is None or self._stage is None:
            return
        face, place = found
        corners = self.surface.faces[face]
        vertex = int(corners[np.argmin(np.linalg.norm(self.surface.vertices_m[corners] - place, axis=1))])
        with self._lock:
            self.show_point(vertex, nonlinear=bool(self._deep.value))

    def show_point(self, vertex: int, *, nonlinear: bool = False) -> None:
        """Show curve, numbers and deformed shape of one point.

        Parameters
        ----------
        vertex, nonlinear
            As in :meth:`pick`.
        """
        stage = self._stage
        assert stage is not None
        stage.get("picked").content = "Computing ..."
        try:
            picked = self.pick(vertex, nonlinear=nonlinear)
        except VisuohapticError as error:
            stage.get("picked").content = markdown_text(str(error))
            return
        stage.get("picked").content = _picked_text(picked, self.force_N)
        self._draw_curve(picked)
        stage.drop("mark")
        stage.keep(
            "mark",
            stage.scene.add_icosphere(
                "/view/mark", 0.003, (20, 20, 20), position=tuple(picked.point_m.tolist())
            ),
        )
        stage.drop("shape")
        if picked.shape_m is not None:
            stage.keep(
                "shape",
                stage.scene.add_mesh_simple(
                    "/view/shape",
                    picked.shape_m.astype(np.float32),
                    np.asarray(self.surface.faces).astype(np.uint32),
                    color=(40, 40, 40),
                    wireframe=True,
                ),
            )

    def _draw_curve(self, picked: Picked) -> None:
        from viser import uplot

        assert self._stage is not None
        name = "nonlinear" if picked.nonlinear else "linear"
        deformation_mm = 1e3 * np.asarray(picked.curve_m, dtype=np.float64)
        if not (np.diff(deformation_mm) > 0).all():
            self._stage.drop("curve")
            return
        k = picked.stiffness_N_per_m
        data = (deformation_mm, np.asarray(picked.curve_N, dtype=np.float64), 1e-3 * deformation_mm * k)
        self._stage.keep(
            "curve",
            self._stage.gui.add_uplot(
                data,
                (
                    uplot.Series(label="deformation [mm]"),
                    uplot.Series(label=name, stroke="#0072b2", width=2),
                    uplot.Series(label="map", stroke="#d55e00", width=1, dash=(5, 3)),
                ),
                scales={"x": uplot.Scale(time=False)},
                title="force [N] over deformation of one side [mm]",
                aspect=1.7,
                order=16,
            ),
        )

    def show_grasps(self) -> None:
        """Rank grasps and draw them as arrows, the best in red."""
        stage = self._stage
        assert stage is not None
        try:
            plan = self.rank()
        except VisuohapticError as error:
            stage.get("grasps").content = markdown_text(str(error))
            return
        stage.drop("arrows")
        if not plan.grasps:
            stage.get("grasps").content = f"No grasp: {markdown_text(plan.reason)}."
            return
        lines = ["| | score | height [mm] | needs [N] | deforms [mm] |", "|---|---|---|---|---|"]
        arrows, tints = [], []
        for rank, grasp in enumerate(plan.grasps, 1):
            lines.append(
                f"| {rank}{', rim' * grasp.rim} | {grasp.score:.2f} | {1e3 * grasp.first_m[2]:.0f} | {grasp.needed_N:.1f} "
                f"| {1e3 * grasp.deformation_m:.1f} ± {1e3 * grasp.deformation_sigma_m:.1f} |"
            )
            for place, push in ((grasp.first_m, grasp.direction), (grasp.second_m, -grasp.direction)):
                arrows.append(np.stack([place - 0.04 * push, place]))
                tints.append((200, 30, 45) if rank == 1 else (120, 120, 120))
        stage.get("grasps").content = "\n".join(lines)
        stage.keep(
            "arrows",
            stage.scene.add_arrows(
                "/view/arrows",
                np.stack(arrows).astype(np.float32),
                # One colour for both ends of each arrow.
                np.array(tints, np.uint8),
                shaft_radius=0.0015,
                head_radius=0.004,
                head_length=0.01,
            ),
        )


def _picked_text(picked: Picked, force_N: float) -> str:
    x, y, z = (1e3 * picked.point_m).tolist()
    k = picked.stiffness_N_per_m
    lines = [f"Point ({x:.0f}, {y:.0f}, {z:.0f}) mm, grasp score {picked.score:.2f}"]
    if np.isnan(k):
        lines.append("There is no opposite point: it cannot be pinched.")
    elif k <= 0:
        lines.append("The map has no stiffness here.")
    elif np.isinf(k):
        lines.append("The wall is clamped here and does not deform.")
    else:
        sigma = f" ± {picked.sigma_N_per_m / 1e3:.2f}" if np.isfinite(picked.sigma_N_per_m) else ""
        lines.append(
            f"Stiffness **{k / 1e3:.2f}{sigma} N/mm**: {1e3 * force_N / k:.2f} mm at {force_N:g} N on the map"
        )
    if picked.note:
        lines.append(f"Nonlinear: {markdown_text(picked.note)}.")
    elif picked.nonlinear:
        at = np.interp(force_N, picked.curve_N, picked.curve_m)
        lines.append(f"Nonlinear: {1e3 * at:.2f} mm.")
    return "  \n".join(lines)
