"""The beam sensor end to end: rendered images of a bending rod, tracked and converted; and the Cramer-Rao bound.

The bound is that of the images: derivatives of the renderer's exact image with respect to all six
parameters of every template's pose, gain and bias unknown, noise independent in every pixel. It does not
use the tracker.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace

import numpy as np

from visuohaptic.core.camera import Camera, Frame, Pose
from visuohaptic.sensing.beam import BeamSensor, BeamSetup, TemplateMeasurement, TrackedBeam
from visuohaptic.simulation.beam import RodRig, RodState
from visuohaptic.simulation.rendering import CameraEffects

__all__ = ["Noise", "Steps", "noise", "steps", "template_noise"]

_NOISE = 5.0


def _virtual(kind: str, rig: RodRig, view: str):
    from visuohaptic.rigs import VirtualBeam

    return VirtualBeam(
        rig,
        Camera.simple(1600, 896, 1800.0),
        CameraEffects(blur_px=0.8, noise_sigma=_NOISE),
        kind,
        view=view,
    )


def _vector(reading) -> np.ndarray:
    return np.concatenate([reading.wrench.force_N, reading.wrench.moment_Nm])


@dataclass(frozen=True)
class Noise:
    """Scatter of single frames."""

    scatter: np.ndarray  #: (6,) [N, Nm]
    bound: np.ndarray  #: (6,) the same with poses at their Cramer-Rao bound
    declared: float  #: declared by true, root mean square over the axes
    valid: float  #: share of the frames


def noise(
    kind: str,
    distance_m: float = 0.3,
    *,
    tilt_deg: float = 0.0,
    frames: int = 120,
    held: bool = False,
    view: str = "moving",
) -> Noise:
    """Noise of an unloaded sensor whose reference is tracked anew in each frame.

    ``held``: a hand moves the camera, so that every frame has other sub-pixel positions; otherwise
    only the noise of the pixels is new.
    """
    rig = RodRig(distance_m=distance_m, tilt_rad=np.deg2rad(tilt_deg))
    virtual = _virtual(kind, rig, view)
    hand = replace(virtual, view="moving" if held else "steady")
    rng = np.random.default_rng(2016)
    with tempfile.TemporaryDirectory() as folder:
        sensor = virtual.sensor(folder)
    renderer, rest = virtual.renderer(), rig.rod.bend(np.zeros(3))
    exact = None if held else renderer.exact(rest)[..., None]

    def frame(k: int) -> Frame:
        t_s = k / 30
        if exact is None:
            image = renderer.render(rest, rng=rng, T_camera_sensor=hand.T_camera_sensor(t_s))
        else:
            image = renderer.effects.developed(exact, np.zeros(len(exact)), rng)[..., 0]
        return Frame(image, t_s, k)

    zero_frames = frames // 2
    sensor.zero(frame(k) for k in range(zero_frames))
    readings = [sensor.read(frame(zero_frames + k)).reading for k in range(frames)]
    good = [reading for reading in readings if reading.wrench.valid]
    found = np.array([_vector(reading) for reading in good])
    scatter = found.std(axis=0, ddof=1)
    declared = np.mean([np.diag(reading.noise) for reading in good], axis=0)
    return Noise(
        scatter,
        _bound(virtual, renderer, rest),
        float(np.sqrt(np.mean(declared / scatter**2))),
        len(good) / len(readings),
    )


def pose_bounds(renderer, state: RodState) -> dict[str, np.ndarray]:
    """Cramer-Rao bound (6, 6) of the pose of each template: position and rotation in the camera [m, rad]."""
    rig = renderer.rig
    poses = rig.poses(state)
    found = {}
    for name, pose in poses.items():
        image = np.zeros((renderer.camera.height, renderer.camera.width), np.float32)

        def drawn(moved: Pose, name: str = name, image: np.ndarray = image) -> np.ndarray:
            canvas = np.full_like(image, 128.0)
            window, fraction, paint = renderer._patch(renderer.prints[name], moved)
            canvas[window] = canvas[window] * (1.0 - fraction) + paint
            return canvas.astype(np.float64)

        step = 0.02 * pose.translation_m[2] / renderer.camera.focal_px  # a fiftieth of a pixel
        columns = []
        for k in range(6):
            # Depth and tilt move pixels less than a shift does.
            size = step * (1.0 if k < 2 else 10.0) if k < 3 else 0.02 * step / 2e-5 * 1e-3
            change = np.eye(6)[k] * size
            sides = [
                drawn(
                    Pose(
                        Pose.from_rotation_vector(sign * change[3:], np.zeros(3)).rotation @ pose.rotation,
                        pose.translation_m + sign * change[:3],
                    )
                )
                for sign in (1, -1)
            ]
            columns.append(((sides[0] - sides[1]) / (2 * size)).ravel())
        inside = _inside(renderer, renderer.prints[name], pose)
        jacobian = np.column_stack([*columns, drawn(pose).ravel(), np.ones(image.size)])[inside.ravel()]
        scale = np.linalg.norm(jacobian, axis=0)
        information = (jacobian / scale).T @ (jacobian / scale) / _NOISE**2
        found[name] = np.linalg.inv(information)[:6, :6] / np.outer(scale[:6], scale[:6])
    return found


def _inside(renderer, drawn, pose: Pose) -> np.ndarray:
    """Pixels of the print itself; its edge against the background is not part of the template."""
    import cv2

    rows, columns = drawn.levels.shape
    half = 0.5 * drawn.pixel_m * np.array([columns, rows])
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 0.0]
    pixels = renderer.camera.project(pose.apply(corners))
    mask = np.zeros((renderer.camera.height, renderer.camera.width), np.uint8)
    cv2.fillConvexPoly(mask, np.round(pixels).astype(np.int32), 1)
    return cv2.erode(mask, np.ones((5, 5), np.uint8), borderValue=0) > 0


def _bound(virtual, renderer, state: RodState) -> np.ndarray:
    """Noise of the wrench when every pose has its bound as covariance."""
    rig = virtual.rig
    setup = BeamSetup(
        {name: xi for name, (xi, _) in rig.mounts.items()},
        rig.T_sensor_reference.inverse(),
        virtual.beam,
        reference=rig.reference,
        view=virtual.view,
    )
    bounds = pose_bounds(renderer, state)
    poses = rig.poses(state)
    seen = [TemplateMeasurement(name, poses[name], 0.5 * (bounds[name] + bounds[name].T)) for name in poses]
    sensor = BeamSensor(setup)
    sensor.zero((k / 30, seen) for k in range(200))
    reading = None
    for k in range(200):
        reading = sensor.read(10 + k / 30, seen)
    assert reading is not None
    return np.sqrt(np.diag(reading.noise))


@dataclass(frozen=True)
class Steps:
    """Figure 3.8: F_Y stepped up and down."""

    error: float  #: largest error of F_Y, mean of the frames of a step, by full scale
    crosstalk: float  #: largest of any other axis, mean of the frames of a step, by its full scale
    slope: float  #: largest part of F_Y that any other axis shows in the mean of all frames, by full scales
    noise: float  #: of the noisiest other axis, standard deviation of the mean of a step, by its full scale
    valid: float  #: share of the frames


def steps(kind: str, distance_m: float, top_N: float, *, count: int = 5, frames: int = 6) -> Steps:
    """Forces of 0 ... ``top_N`` ... 0 along Y, read from images of a hand-held camera."""
    rig = RodRig(distance_m=distance_m)
    virtual = _virtual(kind, rig, "moving")
    rng = np.random.default_rng(38)
    with tempfile.TemporaryDirectory() as folder:
        sensor = virtual.sensor(folder)
    renderer = virtual.renderer()
    sensor.zero(virtual.frames(np.zeros((40, 6)), rng, start_s=-2.0, renderer=renderer))
    forces = np.repeat([*np.linspace(0, top_N, count), *np.linspace(top_N, 0, count)], frames)
    loads = np.zeros((len(forces), 6))
    loads[:, 1] = forces
    readings = [sensor.read(frame).reading for frame in virtual.frames(loads, rng, renderer=renderer)]
    valid = np.array([reading.wrench.valid for reading in readings])
    full = np.minimum(virtual.beam.full_scale, top_N * np.array([1, 1, 1, 0.12, 0.12, 0.12]))
    off = (np.array([_vector(reading) for reading in readings]) - loads) / full
    off[~valid] = np.nan
    of_step = off.reshape(2 * count, frames, 6)
    mean = np.abs(np.nanmean(of_step, axis=1)).max(axis=0)
    noise = np.nanstd(of_step, axis=1, ddof=1).mean(axis=0) / np.sqrt(frames)
    fraction = forces[valid] / top_N
    slope = np.linalg.lstsq(np.column_stack([fraction, np.ones_like(fraction)]), off[valid], rcond=None)[0][0]
    others = [0, 2, 3, 4, 5]
    return Steps(
        float(mean[1]),
        float(mean[others].max()),
        float(np.abs(slope[others]).max()),
        float(noise[others].max()),
        float(valid.mean()),
    )


def template_noise(
    kind: str, distance_m: float, *, tilt_deg: float = 30.0, frames: int = 100
) -> dict[str, np.ndarray]:
    """Scatter and declared sigma (6,) of the pose of the middle template: position and rotation [m, rad]."""
    from visuohaptic.tracking.pose import pose_difference

    rig = RodRig(distance_m=distance_m, tilt_rad=np.deg2rad(tilt_deg))
    virtual = _virtual(kind, rig, "steady")
    rng = np.random.default_rng(2017)
    renderer, rest = virtual.renderer(), rig.rod.bend(np.zeros(3))
    with tempfile.TemporaryDirectory() as folder:
        sensor: TrackedBeam = virtual.sensor(folder)
    true = rig.poses(rest)["middle"]
    exact = renderer.exact(rest)[..., None]
    off, declared = [], []
    for k in range(frames):
        image = renderer.effects.developed(exact, np.zeros(len(exact)), rng)[..., 0]
        pose = next(one for one in sensor.track(Frame(image, k / 30, k)) if one.name == "middle")
        if pose.valid and pose.T_camera_template is not None and k >= 5:
            off.append(pose_difference(true, pose.T_camera_template))
            declared.append(np.diag(pose.covariance))
    return {
        "scatter": np.std(off, axis=0, ddof=1),
        "bias": np.mean(off, axis=0),
        "declared": np.sqrt(np.mean(declared, axis=0)),
        "bound": np.sqrt(np.diag(pose_bounds(renderer, rest)["middle"])),
    }
