"""A complete simulated beam sensor, with the files of a real one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, UInt8

from ..core import Camera, Frame, Pose
from ..core.files import save_yaml, write_image
from ..sensing.beam import Beam, BeamSensorConfig, TrackedBeam, save_beam
from ..simulation.beam import ElasticRod, RodRenderer, RodRig, hand_held
from ..simulation.beam.rod_prints import Print, collage, print_of_image, print_of_tag
from ..simulation.rendering.effects import CameraEffects
from ..simulation.tabletop.probe_cell import ProbeCell
from ..tracking.templates.template import Template
from .foam_example import write_truth, write_video

WRENCH_COLUMNS = ("t_s", "fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
#: Templates in a typical office: uniform light with slight vignetting, sensor noise of indoor light.
_INDOOR = CameraEffects(blur_px=0.8, noise_sigma=3.0, vignetting=0.15, gradient_x=0.1)
#: Illumination of the example: less noise makes smaller files.
_DAYLIGHT = CameraEffects(blur_px=0.8, noise_sigma=1.5, vignetting=0.15, gradient_x=0.1)


@dataclass
class VirtualBeam:
    """The beam sensor of Alt 2016, Sec. 3.6.1, with a camera above it.

    Truth: ``rig`` bends a large-deflection rod that shares no code with the estimator.
    """

    rig: RodRig = field(default_factory=RodRig)
    camera: Camera = field(default_factory=lambda: Camera.simple(1600, 896, 1800.0))
    effects: CameraEffects = _INDOOR
    kind: Literal["tags", "pictures"] = "tags"
    size_m: float = 0.04  #: size of an image, or of the black border of a tag
    #: ``moving``: handheld camera; ``steady``: fixed to the base
    view: Literal["moving", "steady"] = "moving"
    beam: Beam = field(default_factory=Beam)  #: beam model of the sensor
    frame_rate_Hz: float = 30.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the templates, the reference first."""
        return (self.rig.reference, *self.rig.mounts)

    def prints(self) -> dict[str, Print]:
        """Printed templates on the rod."""
        if self.kind == "tags":
            return {name: print_of_tag(k, self.size_m) for k, name in enumerate(self.names)}
        return {name: print_of_image(collage(k), self.size_m) for k, name in enumerate(self.names)}

    def templates(self) -> list[Template]:
        """Templates for the tracker."""
        if self.kind == "tags":
            return [Template.from_tag(k, size_m=self.size_m, name=name) for k, name in enumerate(self.names)]
        return [
            Template.from_image(name, collage(k), width_m=self.size_m) for k, name in enumerate(self.names)
        ]

    def renderer(self) -> RodRenderer:
        """Renderer of the camera above this rod."""
        return RodRenderer(self.rig, self.camera, self.prints(), self.effects)

    def T_camera_sensor(self, t_s: float) -> Pose:
        """Pose of the sensor in the camera frame at a given time.

        Parameters
        ----------
        t_s
            Time [s].
        """
        return hand_held(self.rig, t_s) if self.view == "moving" else self.rig.T_camera_sensor

    def frames(
        self,
        wrenches: Iterable[Float[np.ndarray, "6"]],
        rng: np.random.Generator,
        *,
        start_s: float = 0.0,
        renderer: RodRenderer | None = None,
    ) -> Iterator[Frame]:
        """Generate one frame for each wrench at the tip.

        Parameters
        ----------
        wrenches
            Forces [N] and moments [Nm] at the tip (6).
        rng
            Noise source.
        start_s
            Time of the first frame [s].
        renderer
            Renderer to reuse.
        """
        renderer = renderer or self.renderer()
        for index, wrench in enumerate(wrenches):
            t_s = start_s + index / self.frame_rate_Hz
            state = self.rig.rod.bend(wrench[:3], wrench[3:])
            view = self.T_camera_sensor(t_s)
            yield Frame(renderer.render(state, rng=rng, T_camera_sensor=view, t_s=t_s), t_s, index)

    def write(self, folder: Path | str) -> Path:
        """Write ``sensor.yaml``, ``beam.yaml``, ``camera.yaml`` and ``templates/``; returns the first.

        Parameters
        ----------
        folder
            Output folder.
        """
        folder = Path(folder)
        (folder / "templates").mkdir(parents=True, exist_ok=True)
        self.camera.save(folder / "camera.yaml")
        save_beam(folder / "beam.yaml", self.beam)
        if self.kind == "tags":
            tags = {name: {"id": k, "size_m": self.size_m} for k, name in enumerate(self.names)}
            save_yaml(folder / "templates" / "tags.yaml", {"tags": tags})
        else:
            for k, name in enumerate(self.names):
                write_image(folder / "templates" / f"{name}.png", collage(k))
            widths = {f"{name}.png": self.size_m for name in self.names}
            save_yaml(folder / "templates" / "tags.yaml", {"widths_m": widths})
        save_yaml(
            folder / "sensor.yaml",
            {
                "kind": "beam",
                "beam": "beam.yaml",
                "camera": "camera.yaml",
                "templates_folder": "templates",
                "reference": self.rig.reference,
                "templates": [{"name": name, "xi": xi} for name, (xi, _) in self.rig.mounts.items()],
                "T_reference_sensor": self.rig.T_sensor_reference.inverse().fields,
                "view": self.view,
            },
        )
        return folder / "sensor.yaml"

    def sensor(self, folder: Path | str) -> TrackedBeam:
        """The sensor loaded from its own files; not yet zeroed.

        Parameters
        ----------
        folder
            Output folder.
        """
        path = self.write(folder)
        BeamSensorConfig.load(path)
        return TrackedBeam.load(path)


#: The rod hangs vertically from its clamp: X of the sensor points along it, down to the tip.
T_TIP_SENSOR = Pose(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))


def probe_beam() -> VirtualBeam:
    """A beam sensor with a small camera fixed to the clamp.

    At half the image width, the force error is three times as large; with one pixel less, templates are occasionally
    lost. The rod is compliant: at 3 cm/s and ten frames per second, a contact force grows by 0.27 N per frame.
    """
    return VirtualBeam(camera=Camera.simple(640, 360, 720.0), view="steady", frame_rate_Hz=10.0)


#: The hand hangs from a guided spring of this stiffness [N/m], with 5 % unknown tolerance.
WRIST_N_PER_M, WRIST_TOLERANCE = 3000.0, 0.05


def wrist_beam(rng: np.random.Generator) -> VirtualBeam:
    """The beam sensor from which a hand hangs: its weight and payload stretch the spring along X.

    The camera sees a strip of 640 x 192 pixels, 0.4 mm each: ten images resolve 1 % of a litre.

    Parameters
    ----------
    rng
        Random generator for the deviation of the spring from its data sheet.
    """
    sheet = Beam(
        diameter_m=0.003,
        spring_N_per_m=WRIST_N_PER_M,
        spring_Nm_per_rad=20.0,
        spring_tolerance=WRIST_TOLERANCE,
    )
    true_N_per_m = WRIST_N_PER_M * (1.0 + WRIST_TOLERANCE * float(rng.standard_normal()))
    rod = ElasticRod(diameter_m=sheet.diameter_m, spring_N_per_m=true_N_per_m, spring_Nm_per_rad=20.0)
    camera = Camera.simple(640, 192, 740.0)
    return VirtualBeam(RodRig(rod), camera, kind="pictures", view="steady", beam=sheet, frame_rate_Hz=20.0)


class BeamCamera:
    """Renders the rod of a beam sensor at given times.

    Parameters
    ----------
    virtual
        Rod and camera, fixed to the clamp.
    rng
        Noise source.
    """

    def __init__(self, virtual: VirtualBeam, rng: np.random.Generator) -> None:
        self.virtual, self._rng, self._renderer = virtual, rng, virtual.renderer()
        self._drawn: tuple[np.ndarray, Float32[np.ndarray, "rows columns"]] | None = None

    def frame(self, force_N: Float[np.ndarray, "3"], t_s: float, index: int = 0) -> Frame:
        """Image of the rod under a force on its tip; a static scene is rendered once, with new noise.

        Parameters
        ----------
        force_N
            Force in the sensor's frame.
        t_s, index
            Time [s] and frame number.
        """
        if self._drawn is None or not np.array_equal(self._drawn[0], force_N):
            rig = self.virtual.rig
            self._drawn = force_N, self._renderer.exact(rig.rod.bend(force_N), rig.T_camera_sensor)
        rows_s = np.full(self.virtual.camera.height, t_s)
        image = self.virtual.effects.developed(self._drawn[1][..., None], rows_s, self._rng)
        return Frame(image[..., 0], t_s, index)


def weighing_frames(camera: BeamCamera, loads: Float[np.ndarray, "n 6"]) -> Iterator[Frame]:
    """One image of the rod under each load, before time 0.

    Parameters
    ----------
    camera
        Camera of the rod.
    loads
        Forces and moments on the tip (n, 6) [N, Nm]; the moments are not applied.
    """
    for row, load in enumerate(loads):
        yield camera.frame(load[:3], (row - len(loads)) / camera.virtual.frame_rate_Hz, row)


@dataclass
class VirtualProbe(ProbeCell):
    """A ``ProbeCell`` whose frames show the rod; its spring is the transverse stiffness of the rod."""

    frame_rate_Hz: float = 10.0
    virtual: VirtualBeam = field(default_factory=probe_beam)

    def __post_init__(self) -> None:
        self.frame_rate_Hz = self.virtual.frame_rate_Hz
        # Large deflections increase the stiffness by 0.2 % at half a newton.
        half_N = np.array([0.0, 0.5, 0.0])
        self.stiffness_N_per_m = 0.5 / float(self.virtual.rig.rod.bend(half_N).points_m[-1, 1])
        self._view = BeamCamera(self.virtual, self.rng)

    @property
    def camera(self) -> Camera:
        """The camera at the clamp."""
        return self.virtual.camera

    def image(self, t_s: float) -> UInt8[np.ndarray, "rows columns"]:
        """The rod in its current bent shape.

        Parameters
        ----------
        t_s
            Simulation time [s].
        """
        force_N = (self.arm.true_pose() @ T_TIP_SENSOR).rotation.T @ self.load_N()
        return self._view.frame(force_N, t_s).image


def push_and_twist(frames: int = 90) -> Float[np.ndarray, "frames 6"]:
    """The load of the example: F_Y increasing and decreasing, then F_Z, then both with F_X and a moment about X.

    Parameters
    ----------
    frames
        Number of frames.
    """
    rise = np.sin(np.linspace(0, np.pi, frames // 3 + 1)[:-1]) ** 2
    loads = np.zeros((3, len(rise), 6))
    loads[0, :, 1] = 2.0 * rise
    loads[1, :, 2] = -1.2 * rise
    loads[2] = rise[:, None] * np.array([-2.0, 0.8, 0.6, 0.03, 0.0, 0.0])
    return loads.reshape(-1, 6)


def write_beam_example(
    folder: Path | str, *, seed: int = 1, on_message: Callable[[str], None] = lambda text: None
) -> Path:
    """Write sensor files, two videos and the truth.

    ``rest.mp4`` shows the unloaded sensor, ``push.mp4`` forces along Y and Z, then a mixed
    load, with a handheld camera. ``truth.csv`` contains the true load.

    Parameters
    ----------
    folder, seed, on_message
        As in :func:`~visuohaptic.rigs.foam_example.write_example`.
    """
    folder = Path(folder)
    virtual = VirtualBeam(effects=_DAYLIGHT)
    virtual.write(folder)
    rng = np.random.default_rng(seed)
    renderer = virtual.renderer()

    def images(wrenches: np.ndarray, start_s: float) -> Iterator[UInt8[np.ndarray, "rows columns"]]:
        for frame in virtual.frames(wrenches, rng, start_s=start_s, renderer=renderer):
            yield frame.image

    loads = push_and_twist()
    on_message("rendering rest.mp4")
    write_video(folder / "rest.mp4", images(np.zeros((30, 6)), -1.0))
    on_message("rendering push.mp4")
    write_video(folder / "push.mp4", images(loads, 0.0))
    write_truth(folder, WRENCH_COLUMNS, ((k / virtual.frame_rate_Hz, *load) for k, load in enumerate(loads)))
    return folder
