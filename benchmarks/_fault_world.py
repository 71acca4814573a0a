"""Seeded presses into the foam with one fault each, and the ground truth of every frame.

The surroundings (texture, light, lens, noise, shape, place, path) and the fault are drawn
from the seed. This module does not depend on the estimator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from visuohaptic.core.camera import Frame, Pose
from visuohaptic.rigs import rest_scene
from visuohaptic.sensing.foam import FoamSensor
from visuohaptic.simulation.foam import (
    SOFT_FOAM,
    FoamStrip,
    FoamStripGeometry,
    PressShape,
    SensorRig,
    press_outline,
)
from visuohaptic.simulation.rendering import (
    CameraEffects,
    FoamScene,
    Look,
    Occluder,
    SceneObject,
    SceneRenderer,
    Surface,
)

__all__ = ["KINDS", "Delivery", "Trial", "make_trial"]

FRAME_S = 1.0 / 30.0
#: Maximum motion of the foam in one step [m].
STEP_M = 2e-4
OCCLUDERS = ("hand over the front", "hand over the top", "hand over the base", "hand over everything")
LIGHT = ("light off", "light step", "flicker", "gradient", "hot spot", "shadow")
STREAM = ("dropped frames", "late, double and mixed frames")
CAMERA = ("bump", "bump in depth", "vibration", "defocus")
FOAM = ("saturated", "unloading", "zero drift")
OBJECT = ("textured object", "object as grey as foam", "specular spot")
KINDS = OCCLUDERS + LIGHT + STREAM + CAMERA + FOAM + OBJECT
MATERIALS = ("plain", "concrete", "wood", "planks", "cardboard", "metal", "carpet")


@dataclass(frozen=True, slots=True)
class Delivery:
    """A frame as it reaches the sensor."""

    frame: Frame
    truth_N: float  #: integral of the foam's pressure at the frame's time
    fault: bool  #: whether the fault is on
    strain: float  #: largest of the foam


@dataclass(slots=True)
class Trial:
    """One seeded sequence."""

    seed: int
    kinds: tuple[str, ...]
    geometry: FoamStripGeometry
    rig: SensorRig
    look: Look
    effects: CameraEffects
    shapes: list[tuple[PressShape, float, float]]  #: shape, centre [m], yaw [rad]
    depths_m: np.ndarray  #: one per frame
    slide_m: np.ndarray
    bodies: list[dict]
    window: tuple[int, int]  #: first and last frame of the fault
    occluders: list[Occluder] = field(default_factory=list)
    shade: Callable[[int], np.ndarray | None] = lambda i: None  #: factor on the light per pixel
    gloss: Callable[[int], np.ndarray | None] = lambda i: None  #: light that is added per pixel
    shake: Callable[[float], Pose] | None = None
    blur_px: float | None = None  #: during the fault
    creep_m: np.ndarray | None = None  #: that the free foam has grown thinner, per frame

    def sensor(self, folder: Path) -> FoamSensor:
        """The sensor of this trial, zeroed; ``folder`` holds ``foam.yaml``."""
        bent = np.isfinite(self.geometry.radius_m)
        path = self.rig.write(
            folder,
            length_m=self.geometry.length_m,
            radius_m=self.geometry.radius_m if bent else None,
            zero=f"zero-{self.seed}.yaml",
        )
        sensor = FoamSensor.load(path)
        sensor.zero(self.zero_frames(), limit=10)
        return sensor

    def zero_frames(self) -> list[Frame]:
        """Ten frames of the untouched strip, before time zero."""
        rng, scene, light = (
            np.random.default_rng([self.seed, 1]),
            rest_scene(self.geometry),
            self.effects.light,
        )
        renderer = SceneRenderer(self.rig.camera, self.rig.T_camera_foam, self.look, self.effects)
        times_s = [i * FRAME_S for i in range(-10, 0)]
        if light is None:  # as rendered one by one, in a third of the time
            images = renderer.repeated(scene, 10, rng=rng)
        else:
            images = (renderer.render(scene, rng=rng, t_s=t_s) for t_s in times_s)
        return [Frame(image, t_s, i) for i, (image, t_s) in enumerate(zip(images, times_s, strict=True), -10)]

    def deliveries(self) -> Iterator[Delivery]:
        """All frames in the order in which they reach the sensor."""
        rng = np.random.default_rng([self.seed, 2])
        made = list(self._frames(rng))
        first, last = self.window
        if "dropped frames" in self.kinds:
            made = made[:first] + made[last + 1 :]
        if "late, double and mixed frames" in self.kinds:
            made = _mixed(made, first, last, rng)
        return iter(made)

    def _frames(self, rng: np.random.Generator) -> Iterator[Delivery]:
        strip = FoamStrip(self.geometry, SOFT_FOAM)
        pose = self.rig.T_camera_foam
        sharp = SceneRenderer(self.rig.camera, pose, self.look, self.effects)
        dull = None
        if self.blur_px is not None:
            effects = replace(self.effects, blur_px=self.blur_px)
            dull = SceneRenderer(self.rig.camera, pose, self.look, effects)
        depth = 0.0
        for i, target in enumerate(self.depths_m):
            state, outlines = self._press(strip, depth, float(target), i)
            depth = float(target)
            fault = self.window[0] <= i <= self.window[1]
            renderer = dull if dull is not None and fault else sharp
            front = state.front_m
            if self.creep_m is not None:
                normal = self.geometry.normals(strip.s_m)
                free = np.clip(1.0 - state.delta_m / 1e-3, 0.0, 1.0)  # pressed foam follows the object
                front = front - (self.creep_m[i] * free)[:, None] * normal
            objects = tuple(
                SceneObject(outline.polygon_m(), **body)
                for outline, body in zip(outlines, self.bodies, strict=True)
                if depth > -0.05
            )
            scene = FoamScene(i * FRAME_S, strip.geometry.back_m(strip.s_m), front, objects)
            exact = renderer.render_exact(
                scene, camera_shake=self.shake if self._moves(i) else None, occluders=self.occluders
            )
            shade, gloss = self.shade(i), self.gloss(i)
            if shade is not None:
                exact *= shade
            if gloss is not None:
                exact += gloss
            rows = self.rig.camera.row_time_s(i * FRAME_S, np.arange(self.rig.camera.height))
            image = renderer.effects.developed(exact[..., None], rows, rng)[..., 0]
            yield Delivery(
                Frame(image, i * FRAME_S, i),
                state.load_N,
                fault,
                float(state.delta_m.max() / self.geometry.width_m),
            )

    def _moves(self, i: int) -> bool:
        return self.shake is not None and self.window[0] <= i <= self.window[1]

    def _press(self, strip: FoamStrip, now: float, target: float, i: int):
        slide = [self.slide_m[max(i - 1, 0)], self.slide_m[i]]
        count = max(1, int(np.ceil(abs(target - now) / STEP_M)))
        for part in np.linspace(0.0, 1.0, count + 1)[1:]:
            outlines = [
                press_outline(
                    shape,
                    now + part * (target - now),
                    width_m=self.geometry.width_m,
                    centre_m=0.0,
                    yaw_rad=yaw,
                )
                for shape, _, yaw in self.shapes
            ]
            shift = slide[0] + part * (slide[1] - slide[0])
            outlines = [
                _onto(self.geometry, outline, centre + shift)
                for outline, (_, centre, _) in zip(outlines, self.shapes, strict=True)
            ]
            state = strip.press(outlines, FRAME_S / count)
        return state, outlines


def _onto(geometry: FoamStripGeometry, outline, centre_m: float):
    """An outline that was defined for the middle, moved along the strip."""
    if np.isinf(geometry.radius_m):
        return outline.moved(0.0, centre_m)
    angle = centre_m / geometry.radius_m
    return outline.moved(geometry.radius_m, 0.0).moved(0.0, 0.0, angle).moved(-geometry.radius_m, 0.0)


def _mixed(made: list[Delivery], first: int, last: int, rng: np.random.Generator) -> list[Delivery]:
    """Some frames come twice, too late, or again with a new time stamp.

    A late picture that comes for the first time, with a new time stamp, is not among them: nothing in
    it tells its age.
    """
    result = list(made[:first])
    for i in range(first, min(last + 1, len(made))):  # frames may have been dropped before
        kind = rng.integers(5)
        if kind == 0:
            result.append(made[i])
        elif kind == 1:  # twice
            result += [made[i], made[i]]
        elif kind == 2:  # out of order
            result += [made[i], made[i - 2]]
        elif kind == 3:  # an old frame with a new time stamp: the camera's buffers are mixed up
            old = result[-min(int(rng.integers(1, 4)), len(result))].frame
            result.append(replace(made[i], frame=Frame(old.image, made[i].frame.t_s, made[i].frame.index)))
        # 4: lost
    return result + made[last + 1 :]


def make_trial(seed: int, kinds: tuple[str, ...] | None = None) -> Trial:
    """A trial from its seed; ``kinds`` replaces the drawn faults, ``()`` for none."""
    rng = np.random.default_rng([seed, 0])
    drawn = (KINDS[seed % len(KINDS)],)
    if rng.random() < 0.2:
        drawn += (KINDS[int(rng.integers(len(KINDS)))],)
    kinds = drawn if kinds is None else kinds
    bent = rng.random() < 0.3
    geometry = FoamStripGeometry(
        length_m=0.2 if bent else 0.25, radius_m=0.25 if bent else np.inf, spacing_m=0.001
    )
    vibrates = "vibration" in kinds
    rig = SensorRig(
        distortion=(float(rng.uniform(-0.12, 0.08)), float(rng.uniform(-0.05, 0.05)), 0.0, 0.0, 0.0),
        row_delay_s=2e-5 if vibrates or rng.random() < 0.3 else 0.0,
        look_ahead_m=0.0 if bent else 0.03,
    )
    foam = float(rng.uniform(150, 200))
    look = Look(
        foam=Surface(foam, float(rng.uniform(0, 6)), "foam", seed=seed),
        body=Surface(float(rng.uniform(35, 75)), 3.0, "metal", seed=seed),
        floor=Surface(
            float(rng.uniform(60, foam - 45)),
            float(rng.uniform(0, 14)),
            str(rng.choice(MATERIALS)),
            seed=seed,
        ),
        face_contrast=float(rng.uniform(0, 0.35)),
        shadow=float(rng.uniform(0, 0.55)),
    )
    effects = CameraEffects(
        blur_px=float(rng.uniform(0.7, 2.0)),
        noise_sigma=float(rng.uniform(2, 8)),
        vignetting=float(rng.uniform(0, 0.3)),
        gradient_x=float(rng.uniform(-0.2, 0.2)),
    )
    shapes = [(_shape(rng), float(rng.uniform(-0.06, 0.06)), float(rng.uniform(-0.12, 0.12)))]
    if rng.random() < 0.3 and shapes[0][0] in (PressShape.CYLINDER_4CM, PressShape.PLATE_4CM):
        side = -np.sign(shapes[0][1]) or 1.0
        shapes[0] = (shapes[0][0], -side * 0.05, shapes[0][2])
        shapes.append((PressShape.CYLINDER_4CM, side * 0.05, 0.0))
    bodies = [
        {
            "top_m": float(rng.uniform(0.005, 0.015)),
            "grey": float(rng.uniform(40, foam - 50)),
            "texture": float(rng.uniform(0, 8)),
            "material": str(rng.choice(MATERIALS)),
            "seed": int(rng.integers(1000)),
        }
        for _ in shapes
    ]
    deepest = float(rng.uniform(0.002, 0.010))
    if shapes[0][0] is PressShape.LARGE_PLATE:
        shapes[0] = (shapes[0][0], shapes[0][1], float(rng.uniform(-0.02, 0.02)))
    depths = _path(rng, deepest, runs=2 if "unloading" in kinds else 1)
    slide = np.zeros(len(depths))
    if rng.random() < 0.3:
        slide = float(rng.uniform(-0.01, 0.01)) * np.linspace(0, 1, len(depths)) ** 2
    first = int(rng.integers(4, 18))
    trial = Trial(
        seed, kinds, geometry, rig, look, effects, shapes, depths, slide, bodies,
        (first, first + int(rng.integers(3, 10))),
    )  # fmt: skip
    for kind in kinds:
        _switch_on(trial, kind, rng)
    return trial


def _shape(rng: np.random.Generator) -> PressShape:
    return list(PressShape)[int(rng.integers(4))]


def _path(rng: np.random.Generator, deepest: float, runs: int) -> np.ndarray:
    """Free, loading, hold, (partial release and reloading,) unloading, free."""
    parts = [np.full(3, -0.1), np.linspace(-0.001, deepest, 9), np.full(4, deepest)]
    for _ in range(runs - 1):
        parts += [np.linspace(0.4 * deepest, deepest, 4), np.full(2, deepest)]
    return np.concatenate([*parts, np.linspace(0.8 * deepest, -0.001, 6), np.full(8, -0.1)])


def _switch_on(trial: Trial, kind: str, rng: np.random.Generator) -> None:
    """Add a fault to the trial."""
    camera, (first, last) = trial.rig.camera, trial.window
    begin, end = first * FRAME_S, last * FRAME_S + 1e-3
    pixel_x, pixel_y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    place = _place_px(trial, float(rng.uniform(-0.09, 0.09)), 0.01)
    strength = float(rng.uniform(0.0, 1.0))

    def during(value: Callable[[int], np.ndarray]) -> Callable[[int], np.ndarray | None]:
        return lambda i: value(i).astype(np.float32) if first <= i <= last else None

    if kind in OCCLUDERS:
        across = {
            "hand over the front": (0.016, 0.045),
            "hand over the top": (0.003, 0.017),
            "hand over the base": (-0.03, 0.004),
            "hand over everything": (-0.05, 0.08),
        }[kind]
        trial.occluders.append(_occluder(trial, across, begin, end, rng))
    elif kind == "light off":
        gain = float(rng.choice([0.0, 0.02, 0.1, 0.25]))
        trial.effects = replace(
            trial.effects, light=lambda t: gain if begin - 1e-6 <= t <= end + 0.02 else 1.0
        )
    elif kind == "light step":
        gain = float(rng.choice([rng.uniform(0.4, 0.8), rng.uniform(1.2, 2.0)]))
        trial.effects = replace(
            trial.effects, light=lambda t: gain if begin - 1e-6 <= t <= end + 0.02 else 1.0
        )
    elif kind == "flicker":
        depth, rate = float(rng.uniform(0.1, 0.5)), float(rng.uniform(3, 100))
        trial.effects = replace(trial.effects, light=lambda t: 1 + depth * np.sin(2 * np.pi * rate * t))
    elif kind == "gradient":
        slope = float(rng.uniform(-0.8, 0.8))
        trial.shade = during(lambda i: 1 + slope * (pixel_x / camera.width - 0.5))
    elif kind in ("hot spot", "shadow"):
        radius, speed = float(rng.uniform(30, 200)), rng.uniform(-15, 15, 2)
        factor = 0.2 + 0.8 * strength if kind == "hot spot" else -0.7 * strength
        hard = rng.random() < 0.5

        def spot(i: int) -> np.ndarray:
            away = np.hypot(*(np.array([pixel_x, pixel_y]) - (place + speed * (i - first))[:, None, None]))
            edge = (1 / (1 + np.exp(np.clip((away - radius) / 2.0, -50, 50)))) if hard else None
            return 1 + factor * (edge if edge is not None else np.exp(-0.5 * (away / radius) ** 2))

        trial.shade = during(spot)
    elif kind in ("bump", "bump in depth"):
        if kind == "bump":
            shift = rng.standard_normal(3)
            shift *= 10 ** rng.uniform(-4, -2) / np.linalg.norm(shift)
            turn = rng.standard_normal(3) * 10 ** rng.uniform(-3.5, -2) * (rng.random() < 0.7)
        else:
            shift, turn = np.array([0.0, 0.0, 10 ** rng.uniform(-3, -1.7) * rng.choice([-1, 1])]), np.zeros(3)
        pose = Pose.from_rotation_vector(turn, shift)
        trial.shake = lambda t: pose
        if rng.random() < 0.5:
            trial.window = (first, len(trial.depths_m))
    elif kind == "vibration":
        size, rate = 10 ** rng.uniform(-4, -3), float(rng.uniform(8, 60))
        axis, turn = rng.standard_normal(3), rng.standard_normal(3) * 10 ** rng.uniform(-4, -3)
        trial.shake = lambda t: Pose.from_rotation_vector(
            turn * np.sin(2 * np.pi * rate * t), size * axis * np.sin(2 * np.pi * rate * t + 1.0)
        )
    elif kind == "defocus":
        trial.blur_px = float(rng.uniform(2.0, 5.0))
    elif kind == "saturated":
        trial.depths_m = trial.depths_m * (float(rng.uniform(0.012, 0.0165)) / trial.depths_m.max())
        trial.depths_m[trial.depths_m < -0.01] = -0.1
    elif kind == "zero drift":
        total = float(rng.uniform(-2.5e-4, 2.5e-4))
        trial.creep_m = total * np.linspace(0, 1, len(trial.depths_m))
    elif kind == "textured object":
        for body in trial.bodies:
            body.update(texture=float(rng.uniform(20, 45)), material=str(rng.choice(MATERIALS)))
    elif kind == "object as grey as foam":
        for body in trial.bodies:
            body.update(
                grey=trial.look.foam.grey + float(rng.uniform(-12, 12)), texture=float(rng.uniform(0, 6))
            )
    elif kind == "specular spot":
        spot_px = _place_px(trial, float(rng.uniform(-0.07, 0.07)), float(rng.uniform(0.0, 0.03)))
        sizes = rng.uniform(4, 40, 2)
        trial.gloss = during(
            lambda i: (
                400.0
                * np.exp(
                    -0.5 * ((pixel_x - spot_px[0]) / sizes[0]) ** 2
                    - 0.5 * ((pixel_y - spot_px[1]) / sizes[1]) ** 2
                )
            )
        )
    elif kind == "dropped frames":
        trial.window = (first, min(first + int(rng.integers(0, 30)), len(trial.depths_m) - 6))


def _place_px(trial: Trial, s_m: float, x_m: float) -> np.ndarray:
    """Pixel of a point ``x_m`` in front of the back contour at ``s_m``."""
    s = np.array([s_m])
    point = trial.geometry.back_m(s) + x_m * trial.geometry.normals(s)
    foam = np.column_stack([point, np.zeros(1)])
    return trial.rig.camera.project(trial.rig.T_camera_foam.apply(foam))[0]


def _occluder(
    trial: Trial, across: tuple[float, float], begin: float, end: float, rng: np.random.Generator
) -> Occluder:
    """A blob or a cable with a random outline between two distances from the back contour."""
    middle = float(rng.uniform(-0.09, 0.09))
    half = 0.5 * float(rng.choice([rng.uniform(0.003, 0.01), rng.uniform(0.02, 0.08), 0.3]))
    low, high = sorted(rng.uniform(*across, 2)) if rng.random() < 0.5 else across
    high = max(high, low + 0.003)
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    wobble = 1 + 0.15 * np.cumsum(rng.standard_normal(24)) / 5
    square = np.clip(1.3 * np.column_stack([np.cos(angle), np.sin(angle)]), -1, 1) * wobble[:, None]
    limit = 0.5 * trial.geometry.length_m
    outline = np.array(
        [
            _place_px(
                trial,
                float(np.clip(middle + half * a, -limit, limit)),
                0.5 * (low + high) + 0.5 * (high - low) * b,
            )
            for a, b in square
        ]
    )
    grey = float(rng.choice([rng.uniform(10, 240), trial.look.foam.grey, trial.look.floor.grey]))
    surface = Surface(grey, float(rng.choice([0.0, rng.uniform(0, 25)])), str(rng.choice(MATERIALS)))
    velocity = rng.uniform(-400, 400, 2) * (rng.random() < 0.6)
    if rng.random() < 0.4:
        # Comes in from ahead of the strip, 0.1 to 0.5 m/s; a camera cannot distinguish slower ones from a push.
        velocity = np.array([rng.uniform(-300, 300), 10 ** rng.uniform(2.8, 3.5)])
        outline = outline - velocity * min(0.1, 300.0 / velocity[1])
    moving = (float(velocity[0]), float(velocity[1]))
    return Occluder(outline, None, surface, begin - 1e-3, end + 0.02, moving)
