"""Ground truth of the bottle on the table: one shape for camera, probe and gripper.

Its force-deformation curve comes from a Fourier series of a shell of revolution, while the
classifier was trained with triangle shells: ground truth and classifier share no element type.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core import Camera, Pose
from ..core.objects import HEIGHTS
from ..deformation.shapes.container import Base, ContainerDescription, WallSection, load_container
from ..deformation.shapes.variants import container_outline, nearest_variant
from ..deformation.shells.fourier_shell import RevolutionShell
from ..deformation.shells.shell_material import IsotropicMaterial
from ..recognition import UNKNOWN, FeatureSet, load_feature_set
from ..recognition.touch.haptic_model import HapticModel, fit_model
from ..recognition.touch.nuisances import ModelSettings
from ..simulation.tabletop import PET, Band, Bottle, Box, RefractingScene, Revolution, random_bottle
from ..simulation.tabletop.deformable import GRAIN_FILL, WATER_FILL, BulkFill, DeformableContainer
from ..simulation.tabletop.oval import OvalContainer, oval_container
from ..tasks.memory import HEIGHT_SIGMA_M

#: Class of the bottle on the table, to be recognised by the robot.
CLASS = "bottle"
#: Round classes known to the robot, of PET.
ROUND = ("bottle", "smoothie")
#: All classes of containers; the first four are round, of which cups have neither lid nor neck.
ALL, CUPS = (
    ("bottle", "smoothie", "cup", "cup-rim", "elliptic", "isana", "cien", "cleaner", "palmo"),
    ("cup", "cup-rim"),
)
#: Those of ``containers.npz``, which the robot has been taught.
TAUGHT = ("bottle", "smoothie", "cup", "cup-rim", "elliptic")
#: The elliptic bottles share one name, as in Table 6.2.
GROUPS = {"elliptic": ("elliptic", "isana")}
#: The table's frame in the base of the arm.
PLACE = Pose(np.eye(3), np.array([0.5, 0.0, 0.0]))
#: Density of PET [kg/m^3], and the thickness of the neck with its thread [m].
DENSITY, NECK_M = 1380.0, 0.0012
#: A free mouth instead of a held one lowers the simulated stiffness of bottles and smoothie bottles at the highest place by
#: a factor of exp(2.2) (root mean square); training has held ones, half of the objects on the table are open: 2.2 / sqrt(2).
MOUTH = 1.55
#: What a lid and the air under it, with any filling, add against the flattening of ovals, half of which are open: root mean square
#: over 12 members of both classes (0.08 of the one with a shoulder, 0.37 of the one with a waist), of their Koiter shells.
FLATTENING = 0.27
#: Thickness of the wall of a container of no class, before it is squeezed [m].
WALL_M = 4e-4


@dataclass(frozen=True, slots=True, eq=False)
class TableBottle:
    """Ground truth of the object on the table."""

    name: str  #: class; ``unknown`` if the robot does not know it
    closed: bool
    fill: float  #: fraction of the volume that is filled
    outline_m: Float[np.ndarray, "k 2"]  #: (radius, height) from the foot up
    foot_m: tuple[float, float]  #: position of the axis on the table
    container: DeformableContainer | OvalContainer
    wall_m: float
    scene: RefractingScene
    transparent: bool = True

    @property
    def height_m(self) -> float:
        """Height above the table."""
        return float(self.outline_m[-1, 1])

    def outline_error_m(self, outline_m: Float[np.ndarray, "k 2"]) -> float:
        """Root mean square error of the radius over the height [m].

        Parameters
        ----------
        outline_m
            (radius, height) from the foot up.
        """
        z = np.linspace(0.01, 0.9 * self.height_m, 60)
        found, true = (np.interp(z, one[:, 1], one[:, 0]) for one in (outline_m, self.outline_m))
        return float(np.sqrt(np.mean((found - true) ** 2)))

    def probed(self) -> Bottle:
        """The same shape as a target of the probe."""
        z, r = self.outline_m[:, 1], self.outline_m[:, 0]
        return Bottle("round", self.height_m, z, r, np.zeros(len(z) - 1), 1.0, 10.0)

    @property
    def T_base_bottle(self) -> Pose:
        """Pose in the base of the arm."""
        return PLACE @ Pose(np.eye(3), np.array([*self.foot_m, 0.0]))


def training_objects() -> FeatureSet:
    """Features of 100 variants of six classes: ``objects build`` with seed 0, no bands, open."""
    return load_feature_set(Path(__file__).with_name("containers.npz"))


def mission_classes() -> HapticModel:
    """Prior knowledge of the classes, for a calibrated arm and measured heights."""
    settings = ModelSettings(
        pose_m=HEIGHT_SIGMA_M, poses=(1.0,), mouth=MOUTH, flattening=FLATTENING, simulate_unknown=False
    )
    return fit_model(training_objects(), GROUPS, settings=settings)


def filled_container(
    outline_m: Float[np.ndarray, "k 2"],
    wall_m: float,
    *,
    closed: bool,
    fill: float = 0.0,
    stiffer: float = 1.0,
    filling: BulkFill = WATER_FILL,
    material: str = "PET",
    neck_m: float = NECK_M,
) -> DeformableContainer:
    """Force-deformation curve of a round bottle with the given outline.

    Parameters
    ----------
    outline_m
        Radius and height (k, 2) [m].
    wall_m
        Thickness of the wall [m].
    closed
        The contents cannot escape.
    fill
        Fraction of the volume that is filled.
    stiffer
        Factor of the modulus.
    filling
        Filling.
    material
        Name of its material.
    neck_m
        Thickness of the uppermost tenth, where it is larger than that of the wall [m].
    """
    wall, mass = _wall(outline_m, max(neck_m, wall_m), wall_m)
    r, z, thickness = wall.T
    # A relative change of the modulus changes the force equally: represented by the thickness, by its third power.
    shell = RevolutionShell(r, z, thickness * stiffer ** (1 / 3), rim_held=closed)
    return DeformableContainer.of_revolution(
        "closed" if closed else "open", shell, material, closed=closed, fill=fill, mass_kg=mass, max_m=0.01,
        filling=filling,
    )  # fmt: skip


def _wall(
    outline_m: Float[np.ndarray, "k 2"], neck_m: float, wall_m: float, squash: float = 1.0
) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Radius, height and thickness from the foot up [m], and the mass [kg]; oval, the radius is the larger half-axis."""
    z = np.linspace(outline_m[0, 1], outline_m[-1, 1], 81)
    r = np.interp(z, outline_m[:, 1], outline_m[:, 0])
    thickness, mean = np.where(z > 0.9 * z[-1], neck_m, wall_m), (0.5 + 0.5 * squash) * r
    step = np.hypot(np.diff(mean), np.diff(z))
    area = 2 * math.pi * 0.5 * (mean[1:] + mean[:-1]) * step
    mass = DENSITY * float((area * 0.5 * (thickness[1:] + thickness[:-1])).sum())
    return np.column_stack([r, z, thickness]), mass


def container_of_outline(
    outline_m: Float[np.ndarray, "k 2"], squash: float = 1.0, like: ContainerDescription | None = None
) -> ContainerDescription:
    """A container as measured, of a neck with the thickness of a thread.

    Parameters
    ----------
    outline_m
        Radius and height [m], upwards; the half-axis along x if it is not round.
    squash
        Ratio of the half-axes along y and x.
    like
        Container of its class, for wall and material; by default PET as thick as that of no class.
    """
    wall_m = WALL_M if like is None else float(like.wall[0])
    z = np.linspace(outline_m[0, 1], outline_m[-1, 1], HEIGHTS + 1)
    radii = [(float(r), float(r)) for r in np.interp(z, outline_m[:, 1], outline_m[:, 0])]
    across = None if squash == 1.0 else (squash * radii[0][0], squash * radii[0][0])
    step = float(z[1] - z[0])
    return ContainerDescription(
        name=UNKNOWN,
        base=Base(shape="ellipse" if across else "circle", radius=radii[0], radius_y=across),
        sections=[
            WallSection(
                height=(step, step),
                radius=radius,
                wall=(max(NECK_M, wall_m),) * 2 if low >= 0.9 * z[-1] else None,
            )
            for low, radius in zip(z[:-1], radii[1:], strict=True)
        ],
        wall=(wall_m, wall_m),
        material="PET" if like is None else like.material,
    )


def container_of_class(name: str, outline_m: Float[np.ndarray, "k 2"], squash: float) -> ContainerDescription:
    """The nearest variant of a class, or the outline itself if that is unknown or not round.

    Parameters
    ----------
    name
        Class, or ``UNKNOWN``.
    outline_m, squash
        As of :func:`container_of_outline`.
    """
    variant = None
    if name != UNKNOWN:
        variant = nearest_variant(load_container(GROUPS.get(name, (name,))[0]), outline_m)
    return container_of_outline(outline_m, squash, variant) if variant is None or squash < 1.0 else variant


def table_bottle(rng: np.random.Generator) -> TableBottle:
    """A bottle unknown to the classifier at a random position on the table, open or closed, empty or with any
    amount of water.

    Parameters
    ----------
    rng
        Source of variant, lid, water and position.
    """
    outline, wall, _ = _variant(CLASS, rng)
    closed, wet = rng.random(2) < 0.5
    fill = float(rng.uniform(0.05, 0.95)) if wet else 0.0
    foot = (float(rng.uniform(-0.02, 0.02)), float(rng.uniform(-0.02, 0.02)))
    container = filled_container(outline, wall, closed=bool(closed), fill=fill)
    return _on_the_table(CLASS, (outline, wall), (bool(closed), fill), container, (foot, rng))


def random_table_bottle(rng: np.random.Generator, today: np.random.Generator) -> TableBottle:
    """A round transparent container of any class, or of none, with a random modulus and any contents.

    Parameters
    ----------
    rng
        Source of class, variant, wall, modulus and position.
    today
        Source of lid and contents.
    """
    return _random_container((*ROUND, UNKNOWN), (*(0.85 / len(ROUND) for _ in ROUND), 0.15), rng, today)


def other_table_container(rng: np.random.Generator, today: np.random.Generator) -> TableBottle:
    """One of those of :func:`random_table_bottle`, or as probably an opaque container of any class or of none.

    All sections of one that is not round are similar ellipses.

    Parameters
    ----------
    rng, today
        As in :func:`random_table_bottle`.
    """
    if rng.random() < 0.5:
        return random_table_bottle(rng, today)
    names = (*ALL, UNKNOWN)
    return _random_container(names, (1.0 / len(names),) * len(names), rng, today, opaque=True)


def _random_container(
    names: tuple[str, ...],
    probability: tuple[float, ...],
    rng: np.random.Generator,
    today: np.random.Generator,
    *,
    opaque: bool = False,
) -> TableBottle:
    name, squash = str(rng.choice(names, p=probability)), 1.0
    if name == UNKNOWN:
        shape = random_bottle(rng, "round")
        z = np.linspace(0.0, shape.height_m, 60)
        outline, wall = np.column_stack([shape.radius_m(np.zeros(60), z), z]), float(rng.uniform(3e-4, 7e-4))
    else:
        outline, wall, squash = _variant(name, rng)
    stiffer, foot = (
        float(rng.uniform(0.75, 1.3)),
        (float(rng.uniform(-0.05, 0.05)), float(rng.uniform(-0.05, 0.05))),
    )
    closed, wet, dry = today.random(3) < (0.0 if name in CUPS else 0.5, 0.65, 0.25)
    fill = float(today.uniform(0.02, 1.0)) if wet else 0.0
    turn = float(rng.uniform(0, math.pi)) if opaque else 0.0
    filling = GRAIN_FILL if dry else WATER_FILL
    material = "PET" if name == UNKNOWN else load_container(name).material
    neck = 0.0 if name in CUPS else NECK_M
    container: DeformableContainer | OvalContainer
    if squash == 1.0:
        container = filled_container(
            outline, wall, closed=bool(closed), fill=fill, stiffer=stiffer, filling=filling,
            material=material, neck_m=neck,
        )  # fmt: skip
    else:
        oval, mass = _wall(outline, neck, wall, squash)
        elastic = IsotropicMaterial.of(material).stiffer(stiffer)
        container = oval_container(
            oval, (squash, turn), elastic, closed=bool(closed), fill=fill, filling=filling, mass_kg=mass
        )
    name = next((group for group, members in GROUPS.items() if name in members), name)
    return _on_the_table(
        name if name in TAUGHT else UNKNOWN,
        (outline, wall),
        (bool(closed), fill),
        container,
        (foot, rng),
        opaque=(squash, turn) if opaque else None,
    )


def _variant(name: str, rng: np.random.Generator) -> tuple[Float[np.ndarray, "k 2"], float, float]:
    """Outline and wall [m] of a member of a class not used in training, and the ratio of its widths."""
    from ..deformation.shapes.variants import draw_variant

    description = draw_variant(load_container(name), int(rng.integers(200)), 1000 + int(rng.integers(1000)))
    radius, radius_y = description.base.radius, description.base.radius_y
    squash = 1.0 if radius_y is None else float(radius_y[0] / radius[0])
    return container_outline(description), float(description.wall[0]), squash


def _on_the_table(
    name: str,
    shape: tuple[Float[np.ndarray, "k 2"], float],
    state: tuple[bool, float],
    container: DeformableContainer | OvalContainer,
    place: tuple[tuple[float, float], np.random.Generator],
    *,
    opaque: tuple[float, float] | None = None,
) -> TableBottle:
    """A bottle between a box and a can, in front of walls; an opaque one with the ratio of its widths, and its yaw [rad]."""
    (outline, wall), (closed, fill), (foot, rng) = shape, state, place
    height = float(outline[-1, 1])
    body = Revolution(
        (*foot, 0.0),
        outline,
        "glass",
        wall_m=0.0006,  # refraction by thinner walls is below the resolution of this camera
        index=PET,
        fill=fill,
        # The cap lies on the glass by as much as the label beside it.
        bands=(Band(0.02, 0.3 * height), Band(height - 0.018, height + 2e-4, albedo=0.6)),
    )
    if opaque is not None:
        squash, turn = opaque
        body = Revolution((*foot, 0.0), outline, "opaque", yaw_rad=turn, squash=squash)
    albedo = rng.uniform(0.4, 0.8, 2)
    side = float(rng.uniform(0, 2 * math.pi))
    boxes = [
        Box((0, 0, -0.02), (1.2, 1.2, 0.04), albedo=float(albedo[0])),
        Box((0, 0, -0.75), (8, 8, 0.02), albedo=0.4),
        *(
            Box((1.9 * math.cos(turn), 1.9 * math.sin(turn), 0.5), (0.05, 5.0, 2.6), yaw_rad=turn)
            for turn in side + np.arange(4) * math.pi / 2
        ),
        Box(
            (0.2 * math.cos(side), 0.2 * math.sin(side), 0.05),
            (0.08, 0.07, 0.1),
            yaw_rad=side,
            albedo=float(albedo[1]),
        ),
    ]
    can = Revolution(
        (-0.2 * math.cos(side), -0.2 * math.sin(side), 0.0),
        np.array([[0.033, 0.0], [0.033, 0.11]]),
        "opaque",
    )
    return TableBottle(
        name,
        closed,
        fill,
        outline,
        foot,
        container,
        wall,
        RefractingScene((body, can), tuple(boxes)),
        opaque is None,
    )


def table_views(views: int, rng: np.random.Generator) -> list[Pose]:
    """Views on a circle towards the centre of the table.

    Parameters
    ----------
    views
        Number of views.
    rng
        Source of radius, height and first angle.
    """
    first = float(rng.uniform(0, 2 * math.pi))
    radius, height = float(rng.uniform(0.72, 0.82)), float(rng.uniform(0.42, 0.52))
    return [
        Camera.pose_of_view((radius * math.cos(a), radius * math.sin(a), height), (0.0, 0.0, 0.08))
        for a in first + np.linspace(0, 2 * math.pi, views, endpoint=False)
    ]
