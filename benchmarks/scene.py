"""Sensing of the scene: CPU time of obstacle detection, errors of ego-motion over a metre, falls detected in simulated pushes.

python -m benchmarks.scene                prints all rows; the pushes take some minutes
python -m benchmarks.scene --count 12     twelve pushes
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace

import numpy as np
from tests.sensing import fall_pushes as pushes
from tests.sensing import scenes

from visuohaptic.core import Motion, Reason
from visuohaptic.core.camera import Camera, PlaneView, Pose
from visuohaptic.core.geometry import compose_2d
from visuohaptic.sensing.scene import FloorTracker, ObstacleDetector
from visuohaptic.simulation.foam import SensorRig
from visuohaptic.simulation.rendering import Look, Surface
from visuohaptic.tracking.points import FlowSettings, FlowStep, PointTracker

SEED = 20160606
#: Number of the first push: nothing was developed or chosen on those from here on; on 0 to 199 it was.
FIRST = 1000


def obstacles() -> list[dict[str, object]]:
    """CPU time of a frame at 640 x 480 that is compared with an earlier one; other frames are not processed."""
    from .harness import cpu_seconds

    camera, c, s = Camera.simple(640, 480, 560.0), math.cos(math.pi / 4), math.sin(math.pi / 4)
    rotation = np.array([[0, -1.0, 0], [-s, 0, -c], [c, 0, -s]])
    view = PlaneView(camera, Pose(rotation, -rotation @ np.array([-0.05, 0.0, 0.3])))
    detector, rng = ObstacleDetector(view, 0.0), np.random.default_rng(SEED)
    image, step = rng.integers(80, 160, (480, 640)).astype(np.uint8), np.array([0.01, 0.0])
    motion = Motion(0.0, True, Reason.OK, step, 0.0, np.diag([1e-8, 1e-8, 1e-8]))
    ours_s = cpu_seconds(lambda: [detector.update(image, motion) for _ in range(12)]) / 12
    return [
        {
            "name": "scene: obstacles, a frame of 640 x 480 that is compared",
            "ours": 1e3 * ours_s,
            "unit": "ms",
            "floor": 15.0,
        }
    ]


def ego_motion(floor: str, wrong: float = 0.4, step_m: float = 0.005) -> tuple[float, float, float, float]:
    """Over one metre: relative error of the distance, error of the heading [deg], CPU time per frame [ms], fraction valid."""
    rig, rng = SensorRig(), np.random.default_rng(SEED)
    render = scenes.renderer(rig, replace(Look.photo(), floor=Surface(112.0, 10.0, floor)))
    view = scenes.floor_view(rig)
    v, u = np.mgrid[0 : rig.height_px, 0 : rig.width_px].astype(np.float64)
    place = view.cast(np.stack([u, v], axis=-1))
    regions = ((place[..., 0] > 0.052) & (np.abs(place[..., 1]) > 0.07)).astype(np.uint8)
    regions[:28] = regions[:, :28] = regions[:, -28:] = 0
    points, tracker, pose = PointTracker(FlowSettings(binning=2)), FloorTracker(view), (0.0, 0.0, 0.0)
    spent, valid = [], []
    for i in range(round(1.0 / step_m) + 1):
        if i:
            pose = compose_2d(pose, (step_m, 0.0, 0.002 * math.sin(i / 10)))
        image = render.render(scenes.scene(i / 30, scenes.planar(*pose)), rng=rng)
        begin = time.process_time()
        step = points.update(image, regions)
        # Outliers over their whole life: half are static in the image, half jump randomly.
        bad = (step.ids * 2654435761 % 1000) / 1000 < wrong
        jump = np.where((step.ids % 2 == 0)[:, None], 0.0, rng.normal(0, 15, step.after_px.shape))
        after = np.where(bad[:, None], step.before_px + jump, step.after_px)
        step = FlowStep(step.ids, step.label, step.before_px, after, step.sigma_px, step.tried)
        valid.append(tracker.update(step, i / 30).valid)
        spent.append(time.process_time() - begin)
    error = tracker.pose - pose
    return (
        float(np.hypot(*error[:2])),
        abs(math.degrees(error[2])),
        1e3 * float(np.median(spent)),
        float(np.mean(valid[1:])),
    )


def falls(count: int, first: int = FIRST) -> list[dict[str, object]]:
    """Precision and recall of fall events, right within two frames."""
    found = [pushes.watch(first + i) for i in range(count)]
    score = pushes.score(found)
    turns = [abs(w.turn_error_rad) for w in found if np.isfinite(w.turn_error_rad)]
    return [
        {
            "name": f"scene: falls in {count} pushes, {name}",
            "ours": score[name],
            "unit": "1",
            "floor": 0.95,
            "aim": 0.99,
            "note": f"{score['right']} of {score['true']} falls told within 2 frames, {score['told']} told",
        }
        for name in ("precision", "recall")
    ] + [
        {
            "name": "scene: turn of pushed objects that stand, median error",
            "ours": math.degrees(float(np.median(turns))),
            "unit": "deg",
        }
    ]


def run(count: int = 200) -> list[dict[str, object]]:
    """All rows; the pushes take some minutes, ``python -m benchmarks.scene --count 12`` a few of them."""
    rows = obstacles()
    for floor in ("concrete", "carpet"):
        way, heading, ms, valid = ego_motion(floor)
        note = f"40 % wrong tracks, {100 * valid:.0f} % of the frames valid"
        rows += [
            {
                "name": f"scene: ego-motion over 1 m, way, {floor}", "ours": 100 * way, "unit": "%",
                "floor": 1.0, "aim": 0.3, "note": note,
            },
            {
                "name": f"scene: ego-motion over 1 m, heading, {floor}", "ours": heading, "unit": "deg",
                "floor": 0.5, "aim": 0.1, "note": note,
            },
            {"name": f"scene: tracks and floor motion per frame, {floor}", "ours": ms, "unit": "ms"},
        ]  # fmt: skip
    rows.append(
        {
            "name": "scene: frames on wood grain whose motion is told as valid",
            "ours": 100 * ego_motion("wood", step_m=0.02)[3], "unit": "%",
            "note": "0 is honest: there are no points that hold along the grain",
        }
    )  # fmt: skip
    return rows + (falls(count) if count else [])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    arguments = parser.parse_args()
    for row in run(arguments.count):
        print(row)
