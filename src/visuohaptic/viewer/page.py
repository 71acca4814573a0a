"""Live browser page of a run: camera, force, strip, obstacles, map, tags."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int8, UInt8

from ..core import POSITIVE, ForceProfile, HapticTag, InputError, Pose, check_numbers
from .map_layer import draw_map
from .meshes import columns, pressure_colours, prism
from .server import Page, markdown_text

#: Width of the camera image on the page [px].
PICTURE_WIDTH = 800
#: Points of the force plot; older points are thinned out.
HISTORY = 1200

_OBSTACLE_RGB = {True: (70, 78, 90), False: (222, 130, 62), None: (160, 160, 160)}  #: fixed, movable, unknown
_PLATFORM_RGB = (62, 98, 150)
#: Body of the platform behind the foam, and default foam without a contour [m]; pressure shown in full red [Pa].
_PLATFORM_M = (0.35, 0.3, 0.18)
_STRIP_WIDTH_M, _STRIP_HEIGHT_M = 0.04, 0.05
_FULL_PRESSURE_PA = 6000.0


class LivePage(Page):
    """Live page, served on localhost only.

    It also works without a connected browser: :meth:`update` then only copies
    the numbers. The redraw rate is limited to ``rate_hz``; all forces are still kept for the
    plot. The page loads nothing from the internet, and viser's sharing
    through an external server is disabled.

    Parameters
    ----------
    port
        TCP port on 127.0.0.1; if it is in use, the next free one.
    title
        Headline of the page.
    rate_hz
        Maximum redraw rate.

    Raises
    ------
    MissingExtraError
        viser is not installed.
    InputError
        The port or the rate is out of range.
    DeviceError
        No port could be opened.

    Examples
    --------
    >>> with LivePage(title="a run") as page:
    ...     _ = page.update(0.0, note="nothing touched yet")
    ...     page.url.startswith("http://127.0.0.1:")
    True
    """

    def __init__(self, port: int = 8080, *, title: str = "visuohaptic", rate_hz: float = 10.0) -> None:
        check_numbers("LivePage", POSITIVE, rate_hz=rate_hz)
        super().__init__(port, title)
        self._period_s = 1.0 / rate_hz
        self._drawn_s = -np.inf
        self._forces: deque[tuple[float, float, float, float]] = deque(maxlen=HISTORY)
        self._obstacles: dict[str, Any] = {}
        self._strip: Any = None
        self._plot: Any = None
        server = self._server
        gui, scene = server.gui, server.scene
        self._status = gui.add_markdown("Waiting for the first frame.", order=0)
        blank = np.full((PICTURE_WIDTH * 9 // 16, PICTURE_WIDTH, 3), 230, np.uint8)
        self._picture = gui.add_image(blank, label="camera", format="jpeg", jpeg_quality=80, order=1)
        self._tags = gui.add_markdown("No object has been touched yet.", order=3)
        scene.add_grid("/floor", 20.0, 20.0, cell_size=0.5, position=(0.0, 0.0, -0.002))
        server.initial_camera.position = (0.45, -0.7, 0.6)
        server.initial_camera.look_at = (0.05, 0.0, 0.0)
        self._foam = scene.add_frame("/foam", show_axes=False, visible=False)
        length_m, _, height_m = _PLATFORM_M
        place_m = (-0.5 * length_m, 0.0, 0.5 * height_m - _STRIP_HEIGHT_M)
        scene.add_box("/foam/platform", _PLATFORM_RGB, _PLATFORM_M, position=place_m)

    def set_map(
        self,
        cells: Int8[np.ndarray, "rows columns"],
        resolution_m: float,
        origin_world_m: tuple[float, float, float] | tuple[float, float],
    ) -> None:
        """Draw a map on the floor: -1 unknown, 0 free, 100 occupied; row 0 at the smallest y.

        ``origin_world_m`` is the position of its lower left corner, with optional yaw [rad].

        Parameters
        ----------
        cells, resolution_m, origin_world_m
            As in :func:`.draw_map`.
        """
        _, centre_m, reach_m = draw_map(self._server.scene, cells, resolution_m, origin_world_m)
        self._server.initial_camera.look_at = centre_m
        self._server.initial_camera.position = (
            centre_m[0] - 0.35 * reach_m,
            centre_m[1] - 0.75 * reach_m,
            0.75 * reach_m,
        )

    def set_obstacle(
        self,
        name: str,
        outline_m: Float[np.ndarray, "n 2"],
        T_world_object: Pose,
        *,
        height_m: float = 0.3,
        fixed: bool | None = None,
    ) -> None:
        """Show an obstacle, or move an existing one.

        ``outline_m`` is its outline on the floor in its own frame, whose pose
        is ``T_world_object``.

        Parameters
        ----------
        name
            Name of the obstacle.
        outline_m
            Outline on the floor, in the obstacle's frame [m].
        T_world_object
            Pose of that frame in the world.
        height_m
            Displayed height [m].
        fixed
            Determines the colour: fixed, movable, or unknown (``None``, which keeps that of an existing one).
        """
        position, wxyz = T_world_object.translation_m, np.roll(T_world_object.quaternion_xyzw, 1)
        if (handle := self._obstacles.get(name)) is not None:
            handle.position, handle.wxyz = position, wxyz
            if fixed is not None:
                handle.color = _OBSTACLE_RGB[fixed]
            return
        vertices, faces = prism(outline_m, height_m)
        scene = self._server.scene
        number = len(self._obstacles)
        path = f"/obstacles/{number}"
        self._obstacles[name] = scene.add_mesh_simple(
            path,
            vertices.astype(np.float32),
            faces.astype(np.uint32),
            color=_OBSTACLE_RGB[fixed],
            flat_shading=True,
            side="double",
            position=position,
            wxyz=wxyz,
        )
        # Labels of neighbours are at different heights, so that they do not overlap.
        scene.add_label(f"{path}/name", name, position=(0.0, 0.0, height_m + 0.05 + 0.2 * (number % 3)))

    def set_tags(self, tags: Mapping[str, str | HapticTag]) -> None:
        """List the tag of each object, or a text.

        Parameters
        ----------
        tags
            Haptic tag or text by object name.
        """
        lines = ["| object | haptic tag |", "|---|---|"]
        lines += [
            f"| {markdown_text(name)} | {markdown_text(_tag_line(tag))} |" for name, tag in tags.items()
        ]
        self._tags.content = "\n".join(lines)

    def update(
        self,
        t_s: float | None = None,
        *,
        frame_bgr: UInt8[np.ndarray, "rows columns *colour"] | None = None,
        profile: ForceProfile | None = None,
        truth_N: float | None = None,
        T_world_foam: Pose | None = None,
        contours_foam_m: tuple[Float[np.ndarray, "K 2"], Float[np.ndarray, "K 2"]] | None = None,
        note: str = "",
    ) -> bool:
        """Show the latest state.

        Parameters
        ----------
        t_s
            Time of the frame; that of the profile by default.
        frame_bgr
            Camera image, BGR or grey, annotated or not.
        profile
            Measurement of the sensor.
        truth_N
            True force, if known.
        T_world_foam
            Pose of the sensor's frame F: moves the platform and the strip.
        contours_foam_m
            Back and front contour in F, one point per point of the profile;
            without them, a straight strip is drawn from the deflections.
        note
            Short text after the force, for example the latest event.

        Returns
        -------
        bool
            Whether the page was redrawn; ``False`` if the period since the last redraw has not elapsed.
        """
        if t_s is None:
            t_s = profile.t_s if profile is not None else 0.0
        if profile is not None:
            measured_N = profile.force_N if profile.valid else float("nan")
            true_N = float("nan") if truth_N is None else truth_N
            if self._forces and t_s < self._forces[-1][0]:
                self._forces.clear()  # a source that starts again; the plot would connect its end with its start
            self._forces.append((t_s, measured_N, profile.force_sigma_N, true_N))
        now_s = time.monotonic()
        if now_s - self._drawn_s < self._period_s:
            return False
        self._drawn_s = now_s
        with self._server.atomic():
            if frame_bgr is not None:
                self._picture.image = _small_rgb(frame_bgr)
            if T_world_foam is not None:
                self._foam.position = tuple(T_world_foam.translation_m)
                self._foam.wxyz = np.roll(T_world_foam.quaternion_xyzw, 1)
                self._foam.visible = True
            if profile is not None:
                self._status.content = _status_line(t_s, profile, truth_N, note)
                self._draw_forces()
                self._draw_strip(profile, contours_foam_m)
        return True

    def _draw_forces(self) -> None:
        t_s, measured_N, sigma_N, true_N = np.array(self._forces, dtype=np.float64).T
        if len(t_s) < 2:
            return
        # The plot cannot have gaps: where the force is invalid, the last valid one is held
        # and shaded, to show that it is not a measurement.
        known = np.isfinite(measured_N)
        held = np.maximum.accumulate(np.where(known, np.arange(len(t_s)), 0))
        shown_N = np.nan_to_num(measured_N[held])
        band_N = 2 * np.nan_to_num(np.where(known, sigma_N, 0.0))
        shade_N = np.where(known, 0.0, max(float(shown_N.max()), 0.1))
        data = [t_s, shown_N + band_N, shown_N - band_N, shown_N, shade_N]
        with_truth = bool(np.isfinite(true_N).any())
        if with_truth:
            data.append(np.where(np.isfinite(true_N), true_N, shown_N))
        if self._plot is None or len(self._plot.data) != len(data):
            self._add_plot(tuple(data), with_truth)
        else:
            self._plot.data = tuple(data)

    def _add_plot(self, data: tuple[np.ndarray, ...], with_truth: bool) -> None:
        from viser import uplot

        if self._plot is not None:
            self._plot.remove()
        series = [
            uplot.Series(label="time [s]"),
            uplot.Series(label="+2 sigma", stroke="rgba(0,114,178,0.25)", width=0.5),
            uplot.Series(label="-2 sigma", stroke="rgba(0,114,178,0.25)", width=0.5),
            uplot.Series(label="measured", stroke="#0072b2", width=2),
            uplot.Series(label="invalid", stroke="rgba(213,94,0,0.3)", fill="rgba(213,94,0,0.3)", width=0),
        ]
        if with_truth:
            series.append(uplot.Series(label="true", stroke="#1c2430", width=1.2, dash=(5, 3)))
        self._plot = self._server.gui.add_uplot(
            data,
            tuple(series),
            bands=(uplot.Band(series=(1, 2), fill="rgba(0,114,178,0.18)"),),
            scales={"x": uplot.Scale(time=False)},
            title="force [N] over time [s]",
            aspect=1.9,
            order=2,
        )

    def _draw_strip(self, profile: ForceProfile, contours: tuple[np.ndarray, np.ndarray] | None) -> None:
        if contours is None:
            back_m = np.column_stack([np.zeros_like(profile.s_m), profile.s_m])
            front_m = np.column_stack([_STRIP_WIDTH_M - np.nan_to_num(profile.delta_m), profile.s_m])
        else:
            back_m, front_m = contours
        if len(front_m) != len(profile.pressure_Pa):
            raise InputError(
                "LivePage.update",
                f"found {len(front_m)} points, expected {len(profile.pressure_Pa)} as in the profile",
                field="contours_foam_m",
            )
        positions_m, quaternions, sizes_m = columns(back_m, front_m, _STRIP_HEIGHT_M)
        pressure_Pa = np.where(profile.point_valid, profile.pressure_Pa, np.nan)
        colours = pressure_colours(pressure_Pa, _FULL_PRESSURE_PA)
        if self._strip is None or len(self._strip.batched_positions) != len(positions_m):
            corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
            vertices, faces = prism(corners, 1.0)
            self._strip = self._server.scene.add_batched_meshes_simple(
                "/foam/strip",
                vertices.astype(np.float32),
                faces.astype(np.uint32),
                quaternions.astype(np.float32),
                positions_m.astype(np.float32),
                batched_scales=sizes_m.astype(np.float32),
                batched_colors=colours,
                lod="off",
                flat_shading=True,
                side="double",
            )
            return
        self._strip.batched_wxyzs = quaternions.astype(np.float32)
        self._strip.batched_positions = positions_m.astype(np.float32)
        self._strip.batched_scales = sizes_m.astype(np.float32)
        self._strip.batched_colors = colours


def _small_rgb(frame: UInt8[np.ndarray, "rows columns *colour"]) -> UInt8[np.ndarray, "rows columns 3"]:
    import cv2

    scale = PICTURE_WIDTH / frame.shape[1]
    small = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else frame
    return cv2.cvtColor(small, cv2.COLOR_GRAY2RGB if small.ndim == 2 else cv2.COLOR_BGR2RGB)


def _status_line(t_s: float, profile: ForceProfile, truth_N: float | None, note: str) -> str:
    parts = [f"**{t_s:.2f} s**"]
    if profile.valid:
        parts.append(f"**{profile.force_N:.2f} ± {profile.force_sigma_N:.2f} N**")
    else:
        parts.append(f"invalid: {profile.reason}")
    if truth_N is not None:
        parts.append(f"true {truth_N:.2f} N")
    parts.append(f"contacts {len(profile.contacts)}")
    return " · ".join([*parts, markdown_text(note)] if note else parts)


def _tag_line(tag: str | HapticTag) -> str:
    if isinstance(tag, str):
        return tag
    parts = ["fixed" if tag.fixed else "movable"] if tag.fixed is not None else []
    if tag.dynamic_friction_N is not None:
        parts.append(f"friction {tag.dynamic_friction_N.value:.2f} ± {tag.dynamic_friction_N.sigma:.2f} N")
    if tag.min_static_friction_N is not None:
        parts.append(f"friction more than {tag.min_static_friction_N:.0f} N")
    if tag.primitive is not None:
        parts.append(str(tag.primitive.kind))
    if tag.falls:
        parts.append("falls")
    return ", ".join(parts) or "nothing observed"
