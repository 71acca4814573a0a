"""Open or closed: lids of containers from firm squeezes and their mass, against a wall and a gas of another model.

The wall is a mesh of triangles with a free mouth or a cap (the model of the contents has a Fourier series with a rim that is
free or held); the volume that a pinch displaces is that of an ellipse of constant perimeter, integrated and differentiated
numerically, over a length of 0.9 to 1.1 diameters. With ``--walls shells``, the mesh bends with large rotations, so that the wall
dents, softens to as little as a quarter of its stiffness, and stiffens again. Outlines, heights, walls, readings and masses have errors, fillings are
nothing, liquid or grain at any level. The robot squeezes as :func:`visuohaptic.tasks.manipulation.identify_contents`
does. An answer is the more probable of open and closed; it is claimed from the probability that the task requires.

    python -m benchmarks.lids_evidence --seeds open --count 50 --report lids.jsonl    50 of each class and of none; continues
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ellipe

from visuohaptic.core.resources import one_blas_thread
from visuohaptic.deformation.nonlinear import contained_curve
from visuohaptic.deformation.shapes import (
    ContainerDescription,
    ShellObject,
    draw_variant,
    load_container,
    mesh_container,
)
from visuohaptic.deformation.shapes.variants import container_outline
from visuohaptic.deformation.shells import dual_tip_compliance, opposing_points
from visuohaptic.recognition import UNKNOWN
from visuohaptic.recognition.touch.contents import (
    FORCES_N,
    MAX_DEFORMATION_M,
    ContentsModel,
    SqueezeSamples,
    wall_from_stiffness,
)
from visuohaptic.tasks.manipulation.contents_task import CONFIDENCE, MAX_SQUEEZES, MIN_LEVELS

from ._journal import Journal
from ._seeds import add_seeds, seeds_of
from .table_bottles import DEFORMATION_M, FORCE_N, seen_outline

KINDS = ("bottle", "smoothie", UNKNOWN)
WALLS = ("linear", "shells")
RINGS, AROUND = 16, 64
#: Of a wall with large rotations: triangles around it, and the depths that are computed [m].
BENT_AROUND, BENT_M = 24, (5e-4, 1e-3, 1.5e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3, 7e-3)
#: Neck: height of its lower end by the container's, wall [m]; a cap [kg]; a filling [kg/m^3], and its fraction that is no air.
NECK, NECK_M, CAP_KG = 0.9, 0.0012, 0.0025
FILLINGS = {"empty": (0.0, 0.0), "liquid": (1000.0, 1.0), "grain": (870.0, 0.6)}
#: Force that the foam of a finger reads near the rim, and anywhere [N]; standard deviation of a mass [kg].
RIM_N, READ_N, MASS_KG = 42.0, 54.0, 0.002
MODULUS_Pa, DENSITY, AIR_Pa, GRAVITY = 2.5e9, 1380.0, 101325.0, 9.81
#: Range of the modulus, by its mean; heights at which volumes are summed, by the container's.
STIFFER, FRACTIONS = (0.75, 1.3), np.linspace(0.0, 1.0, 400)


class Container:
    """Truth: outline, stiffness of the wall by height, contents.

    Parameters
    ----------
    kind
        One of ``KINDS``.
    seed
        Of everything.
    walls
        One of ``WALLS``.
    """

    def __init__(self, kind: str, seed: int, walls: str = "linear") -> None:
        rng = np.random.default_rng([seed, 60, KINDS.index(kind)])
        if kind == UNKNOWN:
            z = np.linspace(0.0, rng.uniform(0.12, 0.26), RINGS + 1)
            waves = sum(
                rng.uniform(-0.12, 0.12) / k * np.cos(k * np.pi * z / z[-1] + rng.uniform(0, 6))
                for k in (1, 2, 3)
            )
            r = rng.uniform(0.025, 0.04) * (1.0 + waves)
            one = ContainerDescription.model_validate({
                "base": {"radius": r[0]}, "wall": rng.uniform(3e-4, 7e-4),
                "sections": [{"height": z[1], "radius": radius} for radius in r[1:]],
            })  # fmt: skip
        else:
            one = draw_variant(load_container(kind), int(rng.integers(200)), 5000 + seed)
        self.outline_m, self.wall_m = container_outline(one), float(one.wall[0])
        self.closed = bool(rng.random() < 0.5)
        filling = str(rng.choice(list(FILLINGS), p=(0.35, 0.5, 0.15)))
        self.fill = float(rng.uniform(0.02, 1.0)) if filling != "empty" else 0.0
        self.kg_per_m3, self.solid = FILLINGS[filling]
        self.length = float(rng.uniform(0.9, 1.1))  # of the displaced volume, in diameters
        z, r = self._at(FRACTIONS)
        self.below_m3 = np.append(0.0, np.cumsum(np.pi * (0.5 * (r[1:] + r[:-1])) ** 2 * np.diff(z)))
        thick = np.where(z > NECK * z[-1], max(NECK_M, self.wall_m), self.wall_m)
        area = 2.0 * np.pi * np.trapezoid(r * thick * np.hypot(np.gradient(r, z), 1.0), z)
        self.mass_kg = DENSITY * area + self.closed * CAP_KG + self.kg_per_m3 * self.fill * self.below_m3[-1]
        self.wall_kg = DENSITY * area
        self.stiffer = float(rng.uniform(*STIFFER))
        self._description = self._described(one, MODULUS_Pa * self.stiffer)
        self._bent: dict[float, np.ndarray] = {}
        self.stiffness = self.wall_of(self.closed) if walls == "linear" else None

    def _at(self, fraction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Heights and radii at fractions of the height [m]."""
        z = fraction * self.outline_m[-1, 1]
        return z, np.interp(z, self.outline_m[:, 1], self.outline_m[:, 0])

    def _described(self, one: ContainerDescription, modulus_Pa: float) -> ContainerDescription:
        return ContainerDescription.model_validate({
            **one.model_dump(exclude_none=True), "youngs_modulus": modulus_Pa,
            "rim": {"height": (1.0 - NECK) * float(self.outline_m[-1, 1]), "wall": max(NECK_M, self.wall_m)},
            "top": {"kind": "closed", "wall": NECK_M} if self.closed else {"kind": "open"},
        })  # fmt: skip

    def wall_of(self, closed: bool) -> tuple[np.ndarray, np.ndarray]:
        """Heights [m], and the stiffness of one side [N/m] there, of a mesh of triangles with a cap or a free mouth."""
        top = {"kind": "closed", "wall": NECK_M} if closed else {"kind": "open"}
        described = {**self._description.model_dump(exclude_none=True), "top": top}
        thing = mesh_container(ContainerDescription.model_validate(described), around=AROUND, levels=RINGS)
        tips = _tips(thing, (np.arange(RINGS) + 0.5) / RINGS * self.outline_m[-1, 1])
        approach = dual_tip_compliance(thing.model(), opposing_points(thing.mesh, tips))
        return thing.mesh.vertices_m[tips, 2], 2.0 / approach

    def _wall_N(self, height_m: float, depth_m: np.ndarray) -> np.ndarray:
        """Force of the wall alone; infinite beyond the depth that the mesh reaches."""
        if self.stiffness is not None:
            at_m, k = self.stiffness
            return float(np.exp(np.interp(height_m, at_m, np.log(k)))) * depth_m
        thing = mesh_container(self._description, around=BENT_AROUND, levels=RINGS)
        tips = _tips(thing, np.array([height_m]))
        ring_m = float(thing.mesh.vertices_m[tips[0], 2])
        if ring_m not in self._bent:
            pair = opposing_points(thing.mesh, tips)
            path = contained_curve(thing, thing.model(), pair, 0, BENT_M, until_load=READ_N + 5.0)
            self._bent[ring_m] = np.append(0.0, path.load)
        force_N = self._bent[ring_m]
        return np.interp(depth_m, (0.0, *BENT_M)[: len(force_N)], force_N, right=np.inf)

    def force_N(self, height_m: float, depth_m: np.ndarray) -> np.ndarray:
        """Force of one finger: wall, liquid behind it, and enclosed air."""
        state = (self.closed, self.kg_per_m3, self.solid, self.fill)
        # Two fingers: 2 F dd = p dV.
        return self._wall_N(height_m, depth_m) + self.contents_N(state, height_m, depth_m)

    def contents_N(
        self, state: tuple[bool, float, float, float], height_m: float, depth_m: np.ndarray
    ) -> np.ndarray:
        """Force on one finger of liquid and enclosed air, of a lid, a density, its fraction that is no air, and a fill level."""
        closed, kg_per_m3, solid, fill = state
        radius = float(np.interp(height_m, self.outline_m[:, 1], self.outline_m[:, 0]))
        lost = 2.0 * self.length * radius * _lost_area(radius, depth_m)
        head_m = float(np.interp(fill * self.below_m3[-1], self.below_m3, self._at(FRACTIONS)[0]))
        pressure = (solid == 1.0) * kg_per_m3 * GRAVITY * max(head_m - height_m, 0.0)
        if closed:
            # Fingers do not reach the last thousandth of the air.
            air_m3 = max(1.0 - solid * fill, 0.01) * self.below_m3[-1]
            pressure = pressure + AIR_Pa * (1.0 / np.maximum(1.0 - lost / air_m3, 1e-3) - 1.0)
        return 0.5 * pressure * np.gradient(lost, depth_m)


def _tips(thing: ShellObject, heights_m: np.ndarray) -> np.ndarray:
    """Vertices on the positive x axis nearest to the heights."""
    points = thing.mesh.vertices_m
    off = (np.abs(points[:, 1]) >= 1e-6) | (points[:, 0] <= 0)
    return np.array([int(np.argmin(np.abs(points[:, 2] - one) + off)) for one in heights_m])


def _lost_area(radius_m: float, depth_m: np.ndarray) -> np.ndarray:
    """Of a circle that becomes an ellipse of the same perimeter, with a half-axis shorter by the depth [m^2]."""
    short = radius_m - depth_m
    low, high = np.full_like(short, radius_m), np.full_like(short, 2.0 * radius_m)
    for _ in range(60):
        long = 0.5 * (low + high)
        over = 4.0 * long * ellipe(1.0 - (short / long) ** 2) > 2.0 * np.pi * radius_m
        low, high = np.where(over, low, long), np.where(over, long, high)
    return np.pi * (radius_m**2 - short * long)


def squeezed(
    one: Container, z: float, levels_N: Sequence[float], limit_N: float, rng: np.random.Generator
) -> SqueezeSamples:
    """Readings of a squeeze at a height, up to a force."""
    depth = np.linspace(0.0, MAX_DEFORMATION_M, 300)
    force = one.force_N(z, depth)
    depth, force = depth[np.isfinite(force)], force[np.isfinite(force)]
    # The fingers close until the force is reached for the first time.
    force = np.maximum.accumulate(force) + 1e-9 * np.arange(len(force))
    levels = np.array([level for level in levels_N if level < min(force[-1], limit_N)])
    noise = rng.standard_normal((2, len(levels)))
    return SqueezeSamples(
        z, np.interp(levels, force, depth) + DEFORMATION_M * noise[0], levels + FORCE_N * noise[1]
    )


@one_blas_thread()
def answer(kind: str, seed: int, walls: str = "linear") -> dict[str, Any]:
    """Squeezes and the belief after them.

    Parameters
    ----------
    kind
        One of ``KINDS``.
    seed
        Of truth and errors.
    walls
        One of ``WALLS``.
    """
    one, rng = Container(kind, seed, walls), np.random.default_rng([seed, 61])
    outline_m, sigma_m = seen_outline(one.outline_m, rng)
    gentle = [
        squeezed(one, float(part * outline_m[-1, 1]), (0.3, 0.6, 1.0, 1.5), READ_N, rng)
        for part in rng.uniform(0.15, 0.75, 3)
    ]
    slopes = [
        (s.height_m, float(s.deformation_m @ s.force_N / (s.deformation_m @ s.deformation_m)))
        for s in gentle
        if len(s.force_N)
    ]
    model = ContentsModel(outline_m, wall_from_stiffness(outline_m, slopes, 4e-4), outline_sigma_m=sigma_m)
    mass = one.mass_kg + MASS_KG * float(rng.standard_normal()), MASS_KG
    heights, felt, found = model.heights_m(), [], model.posterior([], mass)
    for z in heights[:MAX_SQUEEZES]:
        limit_N = RIM_N if z > 0.7 * outline_m[-1, 1] else READ_N + 1.0
        curve = squeezed(one, z, FORCES_N, limit_N, rng)
        if len(curve.force_N) < MIN_LEVELS:
            continue
        felt.append(curve)
        found = model.posterior(felt, mass)
        if _sure(found.belief()):
            break
    truth = "closed" if one.closed else "open"
    said = {"truth": truth, "belief": found.belief(), "squeezes": len(felt)}
    return {**said, "fill": one.fill, "found": found.fill_of()[0]}


def _sure(belief: dict[str, float]) -> bool:
    return max(belief["open"], belief["closed"]) >= CONFIDENCE


def run(
    seeds: Sequence[int] = range(0, 4, 2), report: Path | None = None, walls: str = "linear"
) -> list[dict[str, Any]]:
    """Rows of the table; two containers of each kind by default.

    Parameters
    ----------
    seeds
        Of containers and errors.
    report
        Keeps the answers; a stopped campaign continues there.
    walls
        One of ``WALLS``.
    """
    kept = Journal(report, {"campaign": "lids", "walls": walls})
    keys = {f"{kind} {seed}": (kind, seed) for kind in KINDS for seed in seeds}
    for key, (kind, seed) in keys.items():
        if key not in kept:
            kept.put(key, answer(kind, seed, walls))
    rows = [kept.rows[key] for key in keys]
    claimed = [row for row in rows if _sure(row["belief"])]
    wrong = [row for row in claimed if row["belief"][row["truth"]] < CONFIDENCE]
    own = np.array([row["belief"][row["truth"]] for row in rows])
    likely = own >= [max(row["belief"].values()) for row in rows]
    squeezes = np.mean([row["squeezes"] for row in rows])
    logs = float(np.log(np.maximum(own, 1e-6)).mean())
    off = np.array([row["found"] - row["fill"] for row in rows])
    names = ", ".join(key for key in keys if kept.rows[key] in wrong)
    return [
        _row("claimed", 100 * len(claimed) / len(rows), "%", 95, 99, f"{len(rows)} containers, {squeezes:.2f} squeezes"),
        _row("claims that are wrong", len(wrong), "", 0, 0, f"of {len(claimed)}: {names}"),
        _row("the more probable one is right", 100 * float(likely.mean()), "%", 95, 99, f"mean log probability of the truth {logs:.3f}"),
        _row("fill, rms error", float(np.sqrt((off**2).mean())), "", 0.1, 0.05, "claimed or not"),
    ]  # fmt: skip


def _row(name: str, ours: float, unit: str, floor: float, aim: float, note: str) -> dict[str, Any]:
    return {"name": name, "ours": ours, "unit": unit, "floor": floor, "aim": aim, "higher_is_better": bool(unit), "note": note}  # fmt: skip


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 50, "containers of each class, and of none", resumes=True)
    parser.add_argument("--walls", choices=WALLS, default=WALLS[0], help="how they bend")
    args = parser.parse_args()
    for row in run(seeds_of(args.seeds, args.count, args.first), args.report, args.walls):
        print(
            f"{row['name']:32s} {row['ours']:6.3g} {row['unit']:2s} floor {row['floor']}, aim {row['aim']}  {row['note']}"
        )


if __name__ == "__main__":
    main()
