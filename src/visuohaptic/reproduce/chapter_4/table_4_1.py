"""Haptic tags of various objects (Table 4.1).

Objects with the printed friction forces, pushed by the simulated platform: tag measured from rendered frames
next to the printed value; hatched: maximum force where no friction is printed. The strip has the
dissertation's section and a foam that can push the table. The cushion is omitted (the simulation has no soft
obstacles); so is the deformability of the stool.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.measurement import GRAVITY_M_S2
from ...core.objects import Estimate, HapticTag
from ...report.style import COLOURS, draw_axes
from ...rigs.virtual_sensor import VirtualSensor
from ...sensing.foam.sensor import FoamSensor
from ...sensing.scene.scene_tracker import SceneTracker
from ...simulation.foam import SOFT_FOAM, SensorRig, StripLaw
from ...simulation.mobile import FoamPushWorld, PlatformConfig, SimulatedSensorCamera
from ...simulation.mobile.obstacles import SimulatedObstacle, box, cylinder, door
from ...simulation.rendering.renderer import SceneRenderer
from ...tasks import ExploreSettings, ExploreStep, explore_obstacle
from ..chapter_3.figure_3_10 import FRONT_m
from ..output import Columns, Output

GAP_m = 0.012
#: Slow: the water in the vase breaks away after less than a millimetre, which has to be observed at 30 frames per second.
SPEED_m_s, PUSH_m = 0.0125, 0.04
#: The soft foam of the other figures densifies under 15 N on 20 cm; PUR of this kind supports the 15.9 N of the table.
FIRM_FOAM: StripLaw = replace(SOFT_FOAM, mu_Pa=tuple(2.5 * mu for mu in SOFT_FOAM.mu_Pa))
PRINTED_DRIFT = {
    "stool": 0.03, "paper bin": 0.03, "paper bin + content": 0.03, "table": 0.03, "door": 0.1, "vase": 0.3, "vase + water": 0.1
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One column of the printed table."""

    name: str
    obstacle: SimulatedObstacle
    static_N: float
    dynamic_N: float = math.nan
    fixed: bool = False
    falls: bool = False
    known: bool = True  #: the printed force is friction on the floor, and can be simulated


def _pushed(name: str, kind: str, size: tuple[float, float, float], static_N: float, dynamic_N: float,
            friction: float, yaw_rad: float = 0.0, aside_m: float = 0.0) -> Row:  # fmt: skip
    ratio = static_N / dynamic_N
    rest: dict[str, Any] = {"mass_kg": dynamic_N / (friction * GRAVITY_M_S2), "friction": friction, "static_ratio": ratio,
                            "yaw_rad": yaw_rad}  # fmt: skip
    ahead = FRONT_m + GAP_m + 0.5 * size[0] * abs(math.cos(yaw_rad)) + 0.5 * size[1] * abs(math.sin(yaw_rad))
    if kind == "cylinder":
        obstacle = cylinder(name, FRONT_m + GAP_m + 0.5 * size[0], aside_m, 0.5 * size[0], size[2], **rest)
    else:
        obstacle = box(name, ahead, aside_m, size, **rest)
    return Row(name, obstacle, static_N, dynamic_N)


def table_rows() -> tuple[Row, ...]:
    """The objects, in the order of the table."""
    tower = box("PC tower", FRONT_m + GAP_m + 0.225, 0.0, (0.45, 0.2, 0.45), mass_kg=25.0, friction=0.6)
    # The force is due to its inertia, not its hinge: v sqrt(k m) is about 3 N, and it keeps swinging for a while.
    wing = door(
        "door", FRONT_m + GAP_m + 0.02, -0.5, yaw_rad=0.5 * math.pi, mass_kg=12.0, hinge_friction_Nm=0.1
    )
    # Light enough to tip at the printed force, m g r / h with h the height of the foam, before it slides.
    cleaner = cylinder(
        "cleaner", FRONT_m + GAP_m + 0.035, 0.0, 0.035, 0.3, mass_kg=0.17, friction=0.9, static_ratio=1.1
    )
    return (
        Row("PC tower", tower, 15.3, fixed=True, known=False),
        _pushed("stool", "box", (0.35, 0.2, 0.3), 8.1, 7.5, 0.35),
        _pushed("paper bin", "cylinder", (0.25, 0.25, 0.3), 1.5, 1.4, 0.3, aside_m=0.01),
        _pushed("paper bin + content", "cylinder", (0.25, 0.25, 0.3), 6.5, 6.1, 0.3, aside_m=0.01),
        _pushed("table", "box", (0.3, 0.3, 0.3), 15.9, 15.9, 0.35),
        Row("door", wing, 2.8, known=False),
        _pushed("vase", "box", (0.1, 0.1, 0.12), 0.6, 0.6, 0.3, yaw_rad=0.75, aside_m=0.02),
        _pushed("vase + water", "box", (0.1, 0.1, 0.12), 0.9, 0.9, 0.3, aside_m=0.01),
        Row("cleaner", cleaner, 1.3, falls=True, known=False),
    )


def run(out: Output) -> None:
    """Explore each object with the same calibrated sensor.

    Parameters
    ----------
    out
        Receives the table ``tags``, picture ``forces``, and the comparisons; its seed and size are used.
    """
    rig, rng = SensorRig(), out.rng()
    virtual = VirtualSensor(law=FIRM_FOAM, rig=rig.half_size() if out.quick else rig)
    chosen = [row for row in table_rows() if not out.quick or row.name in ("stool", "PC tower")]
    columns = Columns(
        "object outcome max_force_N force_N printed_force_N dynamic_N true_dynamic_N printed_dynamic_N deformability "
        "deceleration_s drift printed_drift fixed printed_fixed falls printed_falls"
    )
    with tempfile.TemporaryDirectory() as folder:
        sensor = virtual.build(folder, rng)
        renderer = virtual.renderer()
        for row in chosen:
            speed_m_s = 4 * SPEED_m_s if out.quick else SPEED_m_s
            outcome, tag, largest, true_dynamic = _explored(row, sensor, renderer, out.seed, speed_m_s)
            static = _number(tag.static_friction_N) if row.known else math.nan
            dynamic = _number(tag.dynamic_friction_N) if row.known else math.nan
            columns.add(row.name, outcome, largest, static, row.static_N, dynamic, true_dynamic if row.known else math.nan,
                        row.dynamic_N, _number(tag.deformability), _number(tag.deceleration_s), _number(tag.drift),
                        PRINTED_DRIFT.get(row.name, math.nan), bool(tag.fixed), row.fixed, bool(tag.falls), row.falls)  # fmt: skip
    out.table("tags", columns)
    out.picture("forces", draw_axes(1, 1, lambda axes: _draw(axes, columns), size=(9.0, 4.6)))
    for name, ours, printed in (("static friction", "force_N", "printed_force_N"),
                                ("dynamic friction", "dynamic_N", "printed_dynamic_N"),
                                ("dynamic friction against the simulation's own", "dynamic_N", "true_dynamic_N")):  # fmt: skip
        known = np.array([row.known for row in chosen])
        a, b = np.array(columns[ours], dtype=float)[known], np.array(columns[printed], dtype=float)[known]
        good = np.isfinite(a) & np.isfinite(b)
        if good.any():
            off = 100 * np.abs(a[good] / b[good] - 1)
            out.compare(f"{name}: largest error", float(off.max()), "%",
                        note=f"{int(good.sum())} of {int(np.isfinite(b).sum())} objects with a value")  # fmt: skip
            out.compare(f"{name}: median error", float(np.median(off)), "%")
    for row, largest, drift in zip(chosen, columns["max_force_N"], columns["drift"], strict=True):
        if not row.known and math.isfinite(largest):
            out.compare(f"{row.name}: largest force", largest, "N", dissertation=row.static_N,
                        note="what the platform pushes with at most" if row.fixed else "")  # fmt: skip
        if row.name == "vase" and math.isfinite(drift):
            out.compare("vase, touched at a corner: drift", drift, "m/m", dissertation=PRINTED_DRIFT["vase"])
    for name, ours, printed in (("fixed", "fixed", "printed_fixed"), ("falls", "falls", "printed_falls")):
        right = sum(a == b for a, b in zip(columns[ours], columns[printed], strict=True))
        out.compare(f'flag "{name}" right', right, f"of {len(chosen)}", dissertation=len(chosen))


def _explored(
    row: Row, sensor: FoamSensor, renderer: SceneRenderer, seed: int, speed_m_s: float
) -> tuple[str, HapticTag, float, float]:
    """Outcome, tag, maximum force, and the mean simulated load while it moved [N]."""
    world = FoamPushWorld([row.obstacle], PlatformConfig(), FIRM_FOAM, seed=seed)
    source = SimulatedSensorCamera(world, renderer, duration_s=40.0, seed=seed)
    loads: list[float] = []

    def watch(step: ExploreStep) -> None:
        body = world.truth.bodies[0] if world.truth.bodies else None
        if step.phase == "push" and body is not None and abs(body.velocity_m_s[0]) > 0.5 * speed_m_s:
            loads.append(world.truth.load_N)

    sensor.reset()
    settings = ExploreSettings(push_m_s=speed_m_s, approach_m_s=speed_m_s, push_m=PUSH_m, back_off_m=0.01)
    scene = SceneTracker.of_sensor(sensor.setup, world.config.floor_below_m)
    found = explore_obstacle(world.base, source, sensor, settings, scene=scene, on_step=watch)
    largest = max((p.force_N for p in found.profiles if p.valid), default=math.nan)
    # As in the tag: without the first frames, where inertia adds to friction.
    dynamic = float(np.mean(loads[3:])) if len(loads) > 3 else math.nan
    return str(found.outcome), found.tag, float(largest), dynamic


def _number(value: Estimate | None) -> float:
    return float("nan") if value is None else float(value.value)


def _draw(axes: Any, columns: dict[str, list[Any]]) -> None:
    at = np.arange(len(columns["object"]))
    column = {key: np.array(columns[key], dtype=float) for key in columns if key.endswith("_N")}
    known = np.isfinite(column["printed_dynamic_N"])
    for shift, key, shown, colour, label in (
        (-0.3, "force_N", known, "blue", "static, read"),
        (-0.3, "max_force_N", ~known, "blue", "largest, read"),
        (-0.1, "printed_force_N", known | ~known, "grey", "static or largest, printed"),
        (0.1, "dynamic_N", known, "green", "dynamic, read"),
        (0.3, "printed_dynamic_N", known, "sky", "dynamic, printed"),
    ):
        style = {"hatch": "///", "alpha": 0.6} if key == "max_force_N" else {}
        axes.bar(
            at[shown] + shift,
            np.nan_to_num(column[key][shown]),
            0.19,
            color=COLOURS[colour],
            label=label,
            **style,
        )
    names = [f"{name}\n{'fixed' if fixed else ''}{'falls' if falls else ''}"
             for name, fixed, falls in zip(columns["object"], columns["fixed"], columns["falls"], strict=True)]  # fmt: skip
    axes.set_xticks(at, names, fontsize=8, rotation=15)
    axes.set(ylabel="force [N]")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5, fontsize=8)
