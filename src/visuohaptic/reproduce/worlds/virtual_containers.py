"""Containers unknown to the classifier, simulated with another element than the training data.

Walls are MITC4 shells with transverse shear instead of Kirchhoff triangles. Each sample has its own
wall, modulus and shape; the gripper's pose has errors. The result is the stiffness at each
finger, from which noisy closing curves are generated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core import InputError, parse_yaml
from ...core.geometry import so3_exp, vertex_normals
from ...deformation import ContainerDescription, IsotropicMaterial, draw_variant, load_container
from ...deformation.shapes.mesher import STIFF_CAP_M, mesh_container
from ...recognition.data.places import HEIGHTS
from .mitc4 import mitc4_factor, mitc4_stiffness

#: The elliptic bottles of Table 6.2 are one class, as there.
GROUPS = {"elliptic": ("elliptic", "isana", "cien", "cleaner", "palmo"), "cup": ("cup", "cut-bottle")}
#: The nine objects of Table 6.2 -> their classes.
REAL = {
    "cup": "cup",
    "cup-rim": "cup-rim",
    "cut-bottle": "cup",
    "bottle": "bottle",
    "smoothie": "smoothie",
    "isana": "elliptic",
    "cien": "elliptic",
    "cleaner": "elliptic",
    "palmo": "elliptic",
}
#: Closing: speed [m/s], rate [Hz], maximum force [N] and deformation [m] (Alt 2016, Sec. 6.4.2).
SPEED_m_per_s, RATE_Hz, MAX_N, MAX_m = 0.005, 30.0, 20.0, 0.003
NOISE_N, NOISE_m = 0.1, 0.0001
POSE_m, POSE_rad = 0.002, np.deg2rad(3.0)
#: Maximum relative change of the wall's thickness, of each length and of Young's modulus.
WALL_ERROR, SHAPE_ERROR, MODULUS_ERROR = 0.1, 0.02, 0.1
#: Elements around a container.
AROUND = 72

#: A cut bottle is a cup in Table 6.2; the shipped cups widen upwards, so it is trained together with them.
CUT_BOTTLE = """
base: {shape: circle, radius: [30 mm, 40 mm]}
sections:
  - {height: [40 mm, 70 mm], bulge: [0 mm, 2 mm]}
  - {height: [30 mm, 55 mm], bulge: [-4 mm, 0 mm]}
blend: 10 mm
wall: [0.3 mm, 0.6 mm]
material: PET
"""

#: Containers of classes that are not trained.
UNKNOWN = {
    "can": "base: {shape: circle, radius: [30 mm, 36 mm]}\n"
    "sections: [{height: [105 mm, 130 mm]}]\ntop: {kind: closed, wall: 0.3 mm}\n"
    "wall: [0.10 mm, 0.15 mm]\nmaterial: aluminium\n",
    "jar": "base: {shape: circle, radius: [32 mm, 42 mm]}\n"
    "sections: [{height: [70 mm, 90 mm]}, {height: 15 mm, radius: 28 mm}]\nblend: 8 mm\n"
    "wall: [2 mm, 3 mm]\nmaterial: glass\n",
    "mug": "base: {shape: circle, radius: [36 mm, 42 mm]}\n"
    "sections: [{height: [85 mm, 100 mm], bulge: [0 mm, 2 mm]}]\n"
    "wall: [3 mm, 4 mm]\nmaterial: glass\n",
    "canister": "base: {shape: flattened, radius: [70 mm, 80 mm], radius_y: [45 mm, 52 mm], flatness: 60 %}\n"
    "sections: [{height: [150 mm, 180 mm]}, {height: 40 mm, radius: 20 mm, radius_y: 20 mm, flatness: 0 %}]\n"
    "blend: 20 mm\ntop: {kind: stiff}\nwall: [1.0 mm, 1.4 mm]\nmaterial: HDPE\n",
    "goblet": "base: {shape: circle, radius: [32 mm, 38 mm]}\n"
    "sections: [{height: [50 mm, 60 mm], radius: 14 mm}, {height: [60 mm, 70 mm], radius: [35 mm, 40 mm]}]\n"
    "blend: 12 mm\nwall: [0.8 mm, 1.1 mm]\nmaterial: PS\n",
    "tube": "base: {shape: circle, radius: [18 mm, 22 mm]}\nsections: [{height: [130 mm, 160 mm]}]\n"
    "wall: [0.5 mm, 0.8 mm]\nmaterial: LDPE\ntop: {kind: stiff}\n",
    "pot": "base: {shape: circle, radius: [40 mm, 50 mm]}\n"
    "sections: [{height: [45 mm, 60 mm], radius: [48 mm, 56 mm]}]\nrim: {height: 4 mm, wall: 3 mm}\n"
    "wall: [0.25 mm, 0.35 mm]\nmaterial: PS\n",
    "funnel": "base: {shape: circle, radius: [45 mm, 52 mm]}\n"
    "sections: [{height: [110 mm, 130 mm], radius: [20 mm, 26 mm]}]\nwall: [0.8 mm, 1.2 mm]\nmaterial: PP\n",
}


@dataclass(frozen=True, slots=True, eq=False)
class RealObject:
    """Readings of the fingers and the gripper at each touch of one sample."""

    name: str
    stiffness_N_per_m: np.ndarray  #: (16, 4), by side
    width_m: np.ndarray  #: (16, 2), opening at contact, across x and across y
    height_m: float  #: as observed


def description(name: str) -> ContainerDescription:
    """A container class, shipped or defined here, with its ranges.

    Parameters
    ----------
    name
        Name of the class.
    """
    text = CUT_BOTTLE if name == "cut-bottle" else UNKNOWN.get(name)
    if text is None:
        return load_container(name)
    return ContainerDescription.model_validate({"name": name, **parse_yaml(text, name)})


def sample_real_object(name: str, draw: int, seed: int, *, varied: bool = False) -> RealObject:
    """One sample of an unseen object: for the nine objects, the same container with perturbations, unless varied.

    Parameters
    ----------
    name
        Name of the object.
    draw
        Number of the sample.
    seed
        Seed of all samples.
    varied
        Whether the container differs between samples.
    """
    key = sorted({*REAL, *UNKNOWN, "elliptic"}).index(name)
    base = draw_variant(description(name), draw if varied or name in UNKNOWN else 0, seed)
    for attempt in range(20):
        rng = np.random.default_rng([seed, key, draw, attempt])
        try:
            return real_object(perturbed(base, rng), rng)
        except InputError:
            continue  # a wall that would intersect itself
    raise RuntimeError(f"{name}: no valid draw")


def perturbed(container: ContainerDescription, rng: np.random.Generator) -> ContainerDescription:
    """Scale every length by its own factor, all walls by a common one.

    Parameters
    ----------
    container
        Nominal shape.
    rng
        Source of randomness.
    """
    common = 1 + rng.uniform(-WALL_ERROR, WALL_ERROR)

    def changed(part: Any, key: str = "") -> Any:
        if isinstance(part, dict):
            return {name: changed(value, name) for name, value in part.items()}
        if isinstance(part, (list, tuple)):
            if len(part) == 2 and all(isinstance(value, float) for value in part):
                if key == "wall":
                    return tuple(value * common for value in part)
                lengths = {"radius", "radius_y", "height", "bulge", "shift", "depth", "width", "z", "blend"}
                factor = 1 + rng.uniform(-SHAPE_ERROR, SHAPE_ERROR)
                return tuple(value * factor for value in part) if key in lengths else tuple(part)
            return [changed(value, key) for value in part]
        return part

    return ContainerDescription.model_validate(changed(container.model_dump(exclude_none=True)))


def real_object(container: ContainerDescription, rng: np.random.Generator) -> RealObject:
    """Measured stiffness of one container with errors of the gripper's pose.

    Parameters
    ----------
    container
        Shape and material.
    rng
        Source of the errors.
    """
    around = AROUND
    specimen = mesh_container(container, around=around, even=True)
    capped = container.top.kind != "open"
    steps = max(2, round(around / 12))
    rings = (len(specimen.mesh.vertices_m) - ((steps - 1) * around + 1 if capped else 0)) // around
    wall = specimen.mesh.vertices_m[: rings * around]
    thickness = np.asarray(specimen.mesh.thickness_m)[: 4 * around * (rings - 1)].reshape(rings - 1, -1)[:, 0]
    plastic = IsotropicMaterial(
        specimen.material.youngs_modulus_Pa * (1 + rng.uniform(-MODULUS_ERROR, MODULUS_ERROR)),
        specimen.material.poisson_ratio,
    )
    row, column = (part.ravel() for part in np.mgrid[: rings - 1, :around])
    a, b = row * around + column, row * around + (column + 1) % around
    quads = np.stack([a, b, b + around, a + around], axis=1)
    vertices, parts = wall, []
    normals = vertex_normals(wall, quads)
    for band in np.unique(thickness):
        some = np.repeat(thickness, around) == band
        parts.append((quads[some], mitc4_stiffness(wall, quads[some], normals, float(band), plastic)))
    if capped:
        top = wall[-around:]
        inner = top.mean(axis=0) + np.linspace(1, 0.15, steps)[1:, None, None] * (top - top.mean(axis=0))
        vertices = np.concatenate([wall, inner.reshape(-1, 3)])
        row, column = (part.ravel() for part in np.mgrid[: steps - 1, :around])
        start = (rings - 1) * around
        a, b = start + row * around + column, start + row * around + (column + 1) % around
        lid = np.stack([a, b, b + around, a + around], axis=1)
        up = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
        default = container.wall[0] if container.top.kind == "closed" else STIFF_CAP_M
        cap = container.top.wall[0] if container.top.wall else default
        parts.append((lid, mitc4_stiffness(vertices, lid, up, cap, plastic)))
    fixed = np.zeros((len(vertices), 6), dtype=bool)
    fixed[:around] = True
    order = np.concatenate([part[0] for part in parts])
    factor = mitc4_factor(vertices, order, np.concatenate([part[1] for part in parts]), fixed)
    return _felt(specimen.name, wall, quads, specimen.height_m, factor, fixed, len(vertices), rng)


def draw_curve(stiffness_N_per_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Deformation [m] and force [N] of one finger while the gripper closes.

    Parameters
    ----------
    stiffness_N_per_m
        Stiffness of the object [N/m].
    rng
        Source of noise.
    """
    step = min(SPEED_m_per_s / RATE_Hz, MAX_N / stiffness_N_per_m / 6)
    last = min(MAX_m, MAX_N / stiffness_N_per_m)
    deformation = np.arange(1, int(last / step + 1e-9) + 1) * step
    return (
        deformation + rng.normal(0, NOISE_m, len(deformation)),
        stiffness_N_per_m * deformation + rng.normal(0, NOISE_N, len(deformation)),
    )


def explore_container(specimen: RealObject, rng: np.random.Generator) -> Any:
    """A function (height, axis) -> touch of this object, with noise of both sensors.

    Parameters
    ----------
    specimen
        Object.
    rng
        Source of noise.
    """
    from ...recognition.data.readings import TouchReading, fit_curve

    def touch(height: int, axis: str) -> TouchReading:
        column = 0 if axis == "x" else 2
        sides = [
            fit_curve(
                *draw_curve(float(specimen.stiffness_N_per_m[height - 1, column + k]), rng), from_contact=True
            )
            for k in (0, 1)
        ]
        width = float(specimen.width_m[height - 1, column // 2]) + rng.normal(0, np.sqrt(2) * NOISE_m)
        return TouchReading(height, axis, (sides[0], sides[1]), width, specimen.height_m)

    return touch


def both_sides(touch: Any) -> Any:
    """The same touch as a pair of stiffnesses, as input of trees.

    Parameters
    ----------
    touch
        Reading of one side.
    """

    def pair(height: int, axis: str) -> tuple[float, float]:
        first, second = touch(height, axis).sides
        return first.i_N_per_m, second.i_N_per_m

    return pair


def _felt(
    name: str,
    wall: np.ndarray,
    quads: np.ndarray,
    height_m: float,
    factor: Any,
    fixed: np.ndarray,
    nodes: int,
    rng: np.random.Generator,
) -> RealObject:
    from scipy.sparse import coo_array

    offset = rng.normal(0, POSE_m, 3)
    turn = so3_exp(rng.normal(0, POSE_rad, 3))
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    rows, columns, values = [], [], []
    width = np.zeros((HEIGHTS, 2))
    for level in range(HEIGHTS):
        centre = offset + np.array([0.0, 0.0, (level + 0.5) / HEIGHTS * height_m])
        centre[2] = np.clip(centre[2], 1e-3, height_m - 1e-4)
        for axis in range(2):
            along, across, up = turn[:, axis], turn[:, 1 - axis], turn[:, 2]
            local = (wall - centre) @ np.stack([across, up, along], axis=1)
            reach = []
            for sign in (1.0, -1.0):
                weights, corners, out = _hit(local, triangles, sign)
                reach.append(out)
                column = 4 * level + 2 * axis + (0 if sign > 0 else 1)
                for weight, corner in zip(weights, corners, strict=True):
                    for k in range(3):
                        if not fixed[corner, k]:
                            rows.append(6 * corner + k)
                            columns.append(column)
                            values.append(-sign * weight * along[k])
            width[level, axis] = reach[0] + reach[1]
    loads = coo_array((values, (rows, columns)), shape=(6 * nodes, 4 * HEIGHTS)).tocsc()
    coupling = factor.coupling(loads)
    pair = np.arange(4 * HEIGHTS) ^ 1
    own = np.diag(coupling) + coupling[np.arange(4 * HEIGHTS), pair]
    # A tip on the clamped foot does not move.
    return RealObject(
        name, 1 / np.maximum(own, 1e-9).reshape(HEIGHTS, 4), width, height_m + rng.normal(0, POSE_m)
    )


def _hit(local: np.ndarray, triangles: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray, float]:
    a, b, c = (local[triangles[:, k], :2] for k in range(3))
    areas = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((b, c), (c, a), (a, b))], axis=1)
    total = areas.sum(axis=1, keepdims=True)
    fraction = areas / np.where(total == 0, 1e-30, total)
    out = sign * np.einsum("tk,tk->t", fraction, local[triangles, 2])
    inside = (fraction >= -1e-9).all(axis=1) & (out > 0)
    if not inside.any():
        # Above a tilted mouth: the nearest corner is touched.
        corner = np.argmin(np.hypot(local[:, 0], local[:, 1]) + np.where(sign * local[:, 2] > 0, 0, 1e3))
        return np.ones(1), np.array([corner]), float(sign * local[corner, 2])
    best = int(np.argmax(np.where(inside, out, -np.inf)))
    return fraction[best], triangles[best], float(out[best])
