"""Containers on the table, of known and of unknown classes: claims after some squeezes, without the rest of a mission.

Outlines have smooth errors over the height of up to 2.5 mm and heights of 0.4 mm, walls are up to 30 % stiffer than the class,
and the contents are arbitrary. Squeezes return the truth with the noise of the fingers: rendering of foam and rod, which
takes most of a mission's time, is left out, so that hundreds of objects take seconds.

    python -m benchmarks.table_bottles --seeds open --count 100    prints correct and wrong claims by kind
    python -m benchmarks.table_bottles --oval                      objects that are not round, seen to be so
    python -m benchmarks.table_bottles --outside 0.3               members of the classes whose ranges are all 30 % wider at each end
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks._seeds import add_seeds, seeds_of
from visuohaptic.core.objects import HEIGHTS
from visuohaptic.core.resources import one_blas_thread
from visuohaptic.deformation.shapes import ContainerDescription, draw_variant, load_container
from visuohaptic.deformation.shapes.variants import container_outline
from visuohaptic.demo.bottle import (
    GROUPS,
    ROUND,
    TableBottle,
    filled_container,
    mission_classes,
    other_table_container,
    random_table_bottle,
)
from visuohaptic.demo.hand_chapters import CONFIDENCE, MAX_SQUEEZES, MIN_SQUEEZES, NO_ROUND
from visuohaptic.demo.probe_chapters import seen_errors
from visuohaptic.recognition import UNKNOWN
from visuohaptic.recognition.touch import HapticModel, with_outline
from visuohaptic.simulation.tabletop import OvalContainer
from visuohaptic.tasks.manipulation import BayesSqueezer, Place, SqueezeCurve

#: Noise of a level's force [N], deformation and place of the wall [m]; error of the height, and over which it is smooth [m].
FORCE_N, DEFORMATION_M, SURFACE_M, TALL_M, SMOOTH_M = 0.03, 1.5e-5, 5e-5, 4e-4, 0.015
LEVELS_N = (0.5, 1.0, 2.0, 4.0, 8.0)


def table_objects(kind: str, seeds: Sequence[int]) -> list[tuple[int, TableBottle]]:
    """For every seed, the first object of a class that is generated for the tables of houses."""
    found = []
    for seed in seeds:
        number = 0
        while True:
            rng, today = (np.random.default_rng([seed, part, number]) for part in (40, 41))
            # The class is the first random draw.
            likely = (*(0.85 / len(ROUND) for _ in ROUND), 0.15)
            drawn = str(np.random.default_rng([seed, 40, number]).choice((*ROUND, UNKNOWN), p=likely))
            if drawn == kind:
                found.append((seed, random_table_bottle(rng, today)))
                break
            number += 1
    return found


def oval_objects(kind: str, seeds: Sequence[int]) -> list[tuple[int, TableBottle]]:
    """For every seed, the first object of a class that is generated for the other places of a table, and is not round."""
    found = []
    for seed in seeds:
        for number in itertools.count():
            one = other_table_container(*(np.random.default_rng([seed, part, number]) for part in (45, 46)))
            if one.name == kind and isinstance(one.container, OvalContainer):
                found.append((seed, one))
                break
    return found


def moved_outside(bottle: TableBottle, seed: int, outside: float) -> TableBottle:
    """Another member of its class, drawn from ranges that are wider at both ends by a fraction of their width."""
    rng = np.random.default_rng([seed, 44])
    wider = ContainerDescription.model_validate(
        _wider(load_container(bottle.name).model_dump(exclude_none=True), outside)
    )
    drawn = draw_variant(wider, int(rng.integers(200)), int(rng.integers(1000)))
    outline_m, wall_m = container_outline(drawn), float(drawn.wall[0])
    stiffer = float(rng.uniform(0.75, 1.3))
    container = filled_container(outline_m, wall_m, closed=bottle.closed, fill=bottle.fill, stiffer=stiffer)
    return replace(bottle, outline_m=outline_m, wall_m=wall_m, container=container)


def _wider(node: Any, outside: float) -> Any:
    if isinstance(node, dict):
        return {name: _wider(value, outside) for name, value in node.items()}
    if isinstance(node, list):
        return [_wider(value, outside) for value in node]
    if isinstance(node, tuple) and all(isinstance(value, float) for value in node):
        return node[0] - outside * (node[1] - node[0]), node[1] + outside * (node[1] - node[0])
    return node


def seen_outline(
    outline_m: np.ndarray, rng: np.random.Generator, worst_m: float = 0.0025
) -> tuple[np.ndarray, float]:
    """An outline as returned by a completion, and its declared error: a quarter larger than the true one."""
    sigma_m, height_m = float(rng.uniform(0.4 * worst_m, worst_m)), float(outline_m[-1, 1])
    z = np.linspace(0.0, height_m, 25)
    near = np.exp(-0.5 * ((z[:, None] - z) / SMOOTH_M) ** 2) + 1e-9 * np.eye(len(z))
    error = 0.8 * sigma_m * np.linalg.cholesky(near) @ rng.standard_normal(len(z))
    radius = np.interp(z, outline_m[:, 1], outline_m[:, 0]) + error
    return np.column_stack([radius, z * (1.0 + TALL_M / height_m * rng.standard_normal())]), sigma_m


def squeezed(
    bottle: TableBottle, place: Place, rng: np.random.Generator, levels_N: Sequence[float] = LEVELS_N
) -> SqueezeCurve:
    """A squeeze, by default a gentle one."""
    depth, felt = np.linspace(0.0, 0.008, 200), bottle.container.turned(place.angle_rad)
    force = np.array([felt.force_at(place.height_m, float(d)) for d in depth])
    levels = np.array([level for level in levels_N if level < force[-1]])
    if len(levels) < 2:
        levels = np.linspace(0.3, 0.9, 4) * force[-1]
    noise = rng.standard_normal((2, len(levels)))
    wall_m = felt.radius_at(place.height_m)
    return SqueezeCurve(
        place, levels + FORCE_N * noise[0], np.interp(levels, force, depth) + DEFORMATION_M * noise[1],
        np.full(len(levels), SURFACE_M), wall_m + SURFACE_M * float(rng.standard_normal()),
    )  # fmt: skip


@one_blas_thread()
def claimed(classes: HapticModel, bottle: TableBottle, seed: int) -> tuple[str, float, int]:
    """Most probable class, its probability, and the squeezes."""
    rng = np.random.default_rng([seed, 42])
    oval = isinstance(bottle.container, OvalContainer)
    wide_rad = (
        0.5 * math.pi + bottle.container.yaw_rad if isinstance(bottle.container, OvalContainer) else 0.0
    )
    # Opaque, the outline is measured by the camera.
    outline_m, sigma_m = seen_outline(bottle.outline_m, rng, 0.001 if oval else 0.0025)
    gap = (outline_m[:, 1, None] - outline_m[:, 1]) / SMOOTH_M
    errors = sigma_m**2 * np.exp(-0.5 * gap**2) / np.outer(outline_m[:, 0], outline_m[:, 0])
    model = with_outline(classes, outline_m, seen_errors(outline_m) if oval else errors)
    squeezer = BayesSqueezer(
        model, float(outline_m[-1, 1]), HEIGHTS, np.random.default_rng([seed, 43]),
        odds=NO_ROUND if oval else {}, yaw_rad=wide_rad,
    )  # fmt: skip
    for count in range(1, MAX_SQUEEZES + 1):
        place = squeezer.next_place()
        assert place is not None
        squeezer.update(squeezed(bottle, place, rng))
        belief = squeezer.belief()
        best = max(belief, key=lambda name: belief[name])
        if count >= MIN_SQUEEZES and belief[best] >= CONFIDENCE:
            break
    return best, belief[best], count


def run(
    seeds: Sequence[int] = range(0, 20, 2), outside: float = 0.0, *, oval: bool = False
) -> list[dict[str, Any]]:
    """Rows of the table; a slice of ten objects of each kind by default. Objects outside the ranges are of the classes only."""
    classes, rows = mission_classes(), []
    for kind in (*GROUPS, UNKNOWN) if oval else ROUND if outside else (*ROUND, UNKNOWN):
        objects = (oval_objects if oval else table_objects)(kind, seeds)
        if outside:
            objects = [(seed, moved_outside(one, seed, outside)) for seed, one in objects]
        told = [(seed, *claimed(classes, one, seed)) for seed, one in objects]
        sure = [one for one in told if one[2] >= CONFIDENCE]
        wrong = [one for one in sure if one[1] != kind]
        right, touches = len(sure) - len(wrong), float(np.mean([one[3] for one in told]))
        note = f"{len(told)} objects, {touches:.2f} squeezes; " + ", ".join(
            f"seed {seed} as {name} {sure:.3f}" for seed, name, sure, _ in wrong
        )
        rows += [
            {"name": f"{kind}: claimed and right", "ours": right / len(told), "unit": "1", "floor": 0.95, "aim": 0.99, "note": note},
            {"name": f"{kind}: claimed and wrong", "ours": len(wrong) / len(told), "unit": "1", "floor": 0.02, "aim": 0.01, "higher_is_better": False, "note": ""},
        ]  # fmt: skip
    return rows


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 100, "objects of each class, and of none")
    parser.add_argument(
        "--outside", type=float, default=0.0, help="fraction by which all ranges are wider at each end"
    )
    parser.add_argument("--oval", action="store_true", help="objects that are not round")
    args = parser.parse_args()
    for row in run(seeds_of(args.seeds, args.count, args.first), args.outside, oval=args.oval):
        print(f"{row['name']:30s} {row['ours']:6.3f}  floor {row['floor']}, aim {row['aim']}  {row['note']}")


if __name__ == "__main__":
    main()
