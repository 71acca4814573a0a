"""Expected deformation of the wall in a planned grasp, and its standard deviation, against an independent shell code.

Round containers as they stand on the tables of houses, with walls of degenerated solids (``tests/worlds/shells.py``) that vary
by 10 % along the height, and a modulus of .75 to 1.3 times that of PET. The outline has an error of up to 2.5 mm and is squeezed gently at
two heights and firmly at one, all at random; the grasp is planned elsewhere.

    python -m benchmarks.grasp_walls --seeds open --count 30
    python -m benchmarks.grasp_walls --oval         opaque containers that are not round, on the map of their outline
    python -m benchmarks.grasp_walls --fit          most probable constants of ``recognition.touch.refinement`` for a measured outline
    python -m benchmarks.grasp_walls --fit --oval   the same for a map of a class
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize
from tests.worlds.shells import Revolution

from visuohaptic.core.measurement import AIR_PA
from visuohaptic.core.resources import one_blas_thread
from visuohaptic.deformation import mesh_container, object_map
from visuohaptic.deformation.shapes import ContainerDescription, load_container
from visuohaptic.deformation.shapes.variants import nearest_variant
from visuohaptic.deformation.shells.shell_material import IsotropicMaterial
from visuohaptic.demo import hand_chapters
from visuohaptic.demo.bottle import (
    GROUPS,
    NECK_M,
    WALL_M,
    TableBottle,
    container_of_class,
    container_of_outline,
    other_table_container,
    random_table_bottle,
)  # fmt: skip
from visuohaptic.demo.story import Known
from visuohaptic.recognition import UNKNOWN
from visuohaptic.recognition.touch import stiffness_samples
from visuohaptic.recognition.touch.contents import wall_from_stiffness
from visuohaptic.recognition.touch.refinement import CLASS, OUTLINE
from visuohaptic.simulation.tabletop import OvalContainer
from visuohaptic.simulation.tabletop.deformable import DeformableContainer
from visuohaptic.tasks import Place
from visuohaptic.tasks.fetch import ContainerBelief
from visuohaptic.tasks.memory import HEIGHT_SIGMA_M

from ._seeds import add_seeds, seeds_of
from .table_bottles import LEVELS_N, SMOOTH_M, seen_outline, squeezed

#: Fractions of the height at which walls are compared with their prior; rounding of both, by interpolation between rings.
HEIGHTS, ROUND = np.linspace(0.12, 0.85, 40), 0.02
#: Spread of the wall's thickness and its length along the wall [m]; levels of a firm squeeze [N]; probability of the true lid.
THICK, THICK_M, FIRM_N, LID = 0.1, 0.03, (1.0, 3.0, 6.0, 10.0, 15.0, 20.0), 0.98


def other_wall(bottle: TableBottle, rng: np.random.Generator) -> DeformableContainer:
    """Force-deformation curve of the same outline by another shell code, with another wall."""
    z = np.linspace(0.0, bottle.height_m, 61)
    r = np.interp(z, bottle.outline_m[:, 1], bottle.outline_m[:, 0])
    middle = 0.5 * (z[1:] + z[:-1])
    near = np.exp(-0.5 * ((middle[:, None] - middle) / THICK_M) ** 2) + 1e-9 * np.eye(60)
    thick = bottle.wall_m * np.exp(THICK * np.linalg.cholesky(near) @ rng.standard_normal(60))
    thick = np.where(middle > 0.9 * z[-1], np.maximum(NECK_M, thick), thick)
    material = IsotropicMaterial.of("PET")
    young = material.youngs_modulus_Pa * float(rng.uniform(0.75, 1.3))
    top = (0, 1, 2) if bottle.closed else ()
    shell = Revolution(np.column_stack([r, z]), thick, young, material.poisson_ratio, top=top)
    levels = np.arange(2, 59)
    depth = 0.01 * np.linspace(0.0, 1.0, 25) ** 2
    force = np.asarray(shell.pinch_stiffness(z[levels]))[:, None] * depth
    if bottle.closed:
        air_m3 = max(1.0 - bottle.fill, 0.01) * shell.enclosed_m3
        force = force + AIR_PA * (3.0 * math.pi * r[levels, None]) ** 2 * depth**3 / air_m3
    return DeformableContainer("other", z[levels], r[levels], depth, force, bottle.container.mass_kg)


def explored(seed: int, oval: bool = False) -> tuple[TableBottle, Known]:
    """A container, and what a robot knows of it after its squeezes."""
    rng, known = np.random.default_rng([seed, 52]), Known()
    if oval:
        found = (
            other_table_container(*(np.random.default_rng([seed, part, n]) for part in (53, 54)))
            for n in itertools.count()
        )
        bottle = next(one for one in found if isinstance(one.container, OvalContainer))
        assert isinstance(bottle.container, OvalContainer)
        known.squash = float(bottle.container.across.radius_m[0] / bottle.container.along.radius_m[0])
        known.wide_rad = 0.5 * math.pi + bottle.container.yaw_rad
    else:
        bottle = random_table_bottle(*(np.random.default_rng([seed, part]) for part in (50, 51)))
        bottle = replace(bottle, container=other_wall(bottle, rng))
    known.bottle_at_m = np.zeros(2)
    # Opaque, the outline is measured by the camera.
    known.outline_m, known.outline_sigma_m = seen_outline(bottle.outline_m, rng, 0.001 if oval else 0.0025)
    radius_m, height_m = known.outline_m.T
    near = np.exp(-0.5 * ((height_m[:, None] - height_m) / SMOOTH_M) ** 2)
    known.outline_errors = known.outline_sigma_m**2 * near / np.outer(radius_m, radius_m)
    turns = known.wide_rad + 0.5 * math.pi * (rng.integers(2, size=3) if oval else np.zeros(3))
    places = [
        Place(float(h) * bottle.height_m, float(turn))
        for h, turn in zip(rng.uniform(0.15, 0.8, 3), turns, strict=True)
    ]
    known.curves = tuple(squeezed(bottle, place, rng, LEVELS_N) for place in places[:2])
    known.mass_kg = bottle.container.mass_kg
    known.mass_sigma_kg = 0.01 * known.mass_kg
    known.class_name = bottle.name
    known.class_model = container_of_class(bottle.name, known.outline_m, known.squash)
    if oval:  # its lid stays unknown, and its filling is that of its mass
        known.fill = bottle.fill
        return bottle, known
    known.firm_curves = (squeezed(bottle, places[2], rng, FIRM_N),)
    known.wall_m = wall_from_stiffness(
        known.outline_m, [(one.place.height_m, one.stiffness_N_per_m) for one in known.curves], WALL_M
    )
    known.closed, known.fill = bottle.closed, bottle.fill
    known.belief = ContainerBelief(transparent=1.0, closed=LID if bottle.closed else 1.0 - LID)
    return bottle, known


@one_blas_thread()
def grasped(seed: int, oval: bool = False) -> dict[str, Any] | None:
    """Expected, declared and true deformation of one side at the planned grasp [m]; ``None``: no grasp is offered."""
    bottle, known = explored(seed, oval)
    plan, scale = hand_chapters._planned(known)
    if not plan.grasps:
        return None
    best = plan.grasps[0]
    depth = np.linspace(0.0, 0.02, 4000)
    height = float(best.first_m[2]) / scale
    felt = bottle.container.turned(known.wide_rad + math.atan2(best.direction[1], best.direction[0]))
    force = [felt.force_at(height, float(d)) for d in depth]
    return {
        "seed": seed, "kind": bottle.name, "height": height / bottle.height_m, "force_N": best.force_N,
        "expected_m": best.deformation_m, "sigma_m": best.deformation_sigma_m,
        "true_m": float(np.interp(best.force_N, force, depth)), "limit_m": plan.task.parameters.max_deformation_m,
    }  # fmt: skip


@one_blas_thread()
def profile(seed: int, oval: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights [m] and logarithms of true to prior stiffness there (sides, n), and the prior's deviations (s, n)."""
    bottle, known = explored(seed, oval)
    z = HEIGHTS * bottle.height_m
    felt = [
        bottle.container.turned(known.wide_rad + turn) for turn in ((0.0, 0.5 * math.pi) if oval else (0.0,))
    ]
    true = np.log([[one.force_at(float(h), 1e-4) / 1e-4 for h in z] for one in felt])
    if not oval:
        assert known.outline_errors is not None
        widths = [(one.place.height_m, one.surface_m) for one in (*known.curves, *known.firm_curves)]
        at, logs = stiffness_samples(
            known.outline_m, known.outline_errors, known.wall_m, known.belief.closed, height_sigma_m=HEIGHT_SIGMA_M, widths_m=widths
        )  # fmt: skip
        several = np.array([np.interp(z, at, one) for one in logs])
        return z, true - several.mean(axis=0), several - several.mean(axis=0)
    model = mesh_container(class_shape(bottle.name, known), around=32)
    k, (x, y, height) = object_map(model, band=False).stiffness_N_per_m, model.mesh.vertices_m.T
    turns = np.round(np.arctan2(y, x) % math.pi, 6)
    prior = []
    for turn in (0.0, 0.5 * math.pi):
        ring = np.isfinite(k) & (
            np.abs(np.arctan2(np.sin(2 * (turns - turn)), np.cos(2 * (turns - turn)))) < 1e-3
        )
        order = np.argsort(height[ring])
        scaled = z * model.height_m / float(known.outline_m[-1, 1])
        prior.append(np.interp(scaled, height[ring][order], np.log(k[ring][order])))
    return z, true - np.array(prior), np.zeros((2, len(z)))


def class_shape(name: str, known: Known) -> ContainerDescription:
    """The member of a class that is nearest to the measured outline; of none, the outline itself."""
    if name == UNKNOWN:
        return container_of_outline(known.outline_m, known.squash)
    return nearest_variant(load_container(GROUPS[name][0]), known.outline_m)


def most_probable(
    profiles: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], start: Sequence[float]
) -> tuple[float, ...]:
    """Standard deviations of the common and of the local part, and its correlation length [m], by maximum likelihood."""

    def cost(logs: np.ndarray) -> float:
        common, local, reach_m = np.exp(logs)
        out = 0.0
        for z, away, deviations in profiles:
            near = local**2 * np.exp(-0.5 * ((z[:, None] - z) / reach_m) ** 2) + ROUND**2 * np.eye(len(z))
            near = near + deviations.T @ deviations / (len(deviations) - 1)
            covariance = np.kron(np.eye(len(away)), near) + common**2
            size = np.linalg.slogdet(covariance)[1]
            out += 0.5 * float(size + away.ravel() @ np.linalg.solve(covariance, away.ravel()))
        return out

    found = minimize(cost, np.log(start), method="Nelder-Mead", options={"xatol": 0.01, "fatol": 0.05})
    return tuple(float(one) for one in np.exp(found.x))


def figures(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Errors over standard deviations of the logarithm, which is Gaussian, and how many 90 % intervals hold the truth."""
    spread = np.array([row["sigma_m"] / row["expected_m"] for row in rows])
    off = np.array([math.log(row["expected_m"] / row["true_m"]) for row in rows])
    z, softer = off / spread, sum(row["true_m"] > row["limit_m"] for row in rows)
    note = f"{len(rows)} grasps, median declared {np.median(spread):.2f}, {softer} over the limit"
    values = (
        ("rms z", float(np.sqrt(np.mean(z**2)))),
        ("90 % interval holds", float(np.mean(np.abs(z) < 1.645))),
        ("rms error of the logarithm", float(np.sqrt(np.mean(off**2)))),
        ("mean error of the logarithm", float(np.mean(off))),
    )
    return [{"name": f"wall at the grasp: {name}", "ours": value, "unit": "1", "floor": None, "aim": None, "note": note}
            for name, value in values]  # fmt: skip


def run(seeds: Sequence[int] = range(0, 8, 2)) -> list[dict[str, Any]]:
    """A slice of four containers."""
    return figures([row for seed in seeds if (row := grasped(seed)) is not None])


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 30, "containers")
    parser.add_argument("--oval", action="store_true", help="containers that are not round")
    parser.add_argument("--fit", action="store_true", help="print the most probable constants")
    args = parser.parse_args()
    seeds = seeds_of(args.seeds, args.count, args.first)
    if args.fit:
        start = CLASS if args.oval else OUTLINE
        common, local, reach_m = most_probable([profile(seed, args.oval) for seed in seeds], start)
        print(f"common {common:.3f}, local {local:.3f}, over {1e3 * reach_m:.1f} mm; now {start}")
        return
    rows = []
    for seed in seeds:
        row = grasped(seed, args.oval)
        if row is None:
            print(f"{seed}: no grasp")
            continue
        rows.append(row)
        print(
            f"{seed} {row['kind']:8s} at {row['height']:.2f} of the height, {row['force_N']:.1f} N: "
            f"{1e3 * row['expected_m']:.2f} ± {1e3 * row['sigma_m']:.2f} mm, true {1e3 * row['true_m']:.2f}",
            flush=True,
        )
    for one in figures(rows):
        print(f"{one['name']:45s} {one['ours']:6.3f}  {one['note']}")


if __name__ == "__main__":
    main()
