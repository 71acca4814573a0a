"""Presses of rigid bodies into the standard foam, simulated once and kept."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import astuple, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from .foam_mechanics import Foam, Press, Shape, bar, cylinder, press, together
from .foam_scene import FRAME_S

__all__ = ["BODIES", "POOL", "STEP_M", "Pushed", "calibration_plate", "pushed"]

#: ``end`` is a plate near or beyond an end of the strip, ``two`` are cylinders whose impressions merge,
#: ``box`` is a plate with sharp edges that goes no deeper than 5 mm.
BODIES = ("cylinder", "plate", "tilted", "end", "two", "box")
#: Presses that are simulated for each kind and parity of the seed; further ones are scaled in stiffness.
POOL = 8
#: Depth of one step of the simulation [m]: 10 mm/s at 30 frames a second.
STEP_M = 0.01 * FRAME_S
_DEPTHS_M = STEP_M * np.arange(1, 28)


@dataclass(frozen=True, eq=False)
class Pushed:
    """A body pressed into the strip of the standard foam, step by step."""

    shape: Shape
    side_m: tuple[float, float]  #: first and last y of the body
    steps: tuple[Press, ...]
    about: dict

    def at(self, depth_m: float) -> Press:
        """State at a depth between the steps (monotone cubic of every place and of the force)."""
        table = _splines(self)
        first = self.steps[0]
        values = table(min(depth_m, self.max_depth_m))
        parts = np.split(values, np.cumsum([1, 2, first.y_m.size, first.y_m.size, first.end_low_m.size]))
        force, touch, y, delta, low, high = parts
        return Press(depth_m, float(force[0]), y, delta, low, high, (float(touch[0]), float(touch[1])))

    @property
    def max_depth_m(self) -> float:
        """Depth of the last step."""
        return self.steps[-1].depth_m


@cache
def _splines(pushed: Pushed) -> PchipInterpolator:
    first = pushed.steps[0]
    faces = (np.full(first.end_low_m.size, y) for y in (first.y_m[0], first.y_m[-1]))
    middle = np.full(2, np.mean(first.pressed_m))
    rest = np.concatenate([[0.0], middle, first.y_m, 0 * first.delta_m, *faces])
    rows = [
        np.concatenate([[s.force_N], s.pressed_m, s.y_m, s.delta_m, s.end_low_m, s.end_high_m])
        for s in pushed.steps
    ]
    return PchipInterpolator([0.0, *(s.depth_m for s in pushed.steps)], np.array([rest, *rows]))


@cache
def pushed(kind: str, number: int) -> Pushed:
    """A simulated press of a ``kind`` of :data:`BODIES`; ``number`` is even for open seeds and odd for closed ones."""
    rng = np.random.default_rng([19, number, *kind.encode()])
    foam = Foam()
    side = float(rng.choice([-1, 1]))
    if kind == "cylinder":
        radius, y = float(np.exp(rng.uniform(np.log(0.015), np.log(0.08)))), float(rng.uniform(-0.08, 0.08))
        shape, half = cylinder(radius, y), 0.95 * min(radius, 0.04)
        reach = min(half, float(np.sqrt(2 * radius * _DEPTHS_M[-1])))
        spans = [(y - reach, y + reach)]
        about = {"radius_m": radius}
    elif kind in ("plate", "tilted", "end", "box"):
        half = float(rng.uniform(0.008, 0.03))
        edge = 0.0008 if kind == "box" else float(rng.uniform(0.002, 0.004))
        tilt = float(side * np.deg2rad(rng.uniform(1, 6))) if kind == "tilted" else 0.0
        y = float(rng.uniform(-0.07, 0.07))
        if kind == "end":
            half = 0.03 - edge if rng.random() < 0.5 else half
            # Some millimetres of free foam beside it, which bulge; or it overhangs by up to a third.
            inside = -(half + edge) - rng.uniform(0.003, 0.022)
            y = side * (
                0.5 * foam.length_m + (inside if rng.random() < 0.6 else -(half + edge) * rng.uniform(0.4, 1))
            )
        shape = bar(half, edge, y, tilt)
        spans = [(y + e - 0.004, y + e + 0.004) for e in (-half, half)]
        if tilt:  # the contact grows from one edge to the other
            spans = [(spans[0][0], spans[1][1])]
        about = {"half_m": half + edge, "edge_m": edge, "tilt_rad": tilt}
        half += edge
    else:
        apart, offset = float(rng.uniform(0.02, 0.05)), float(rng.uniform(0.0, 0.001))
        radii, y = rng.uniform(0.008, 0.02, 2), float(rng.uniform(-0.06, 0.06))
        places = (y - 0.5 * apart, y + 0.5 * apart)
        shape = together(*((cylinder(r, p), o) for r, p, o in zip(radii, places, (0.0, offset), strict=True)))
        half, spans = 0.5 * apart + 0.012, [(places[0] - 0.012, places[1] + 0.012)]
        about = {"apart_m": apart, "offset_m": offset}
    limit = 0.5 * foam.length_m
    spans = [(a, b) for a, b in spans if b > -limit and a < limit]
    fine, depths = (4e-4, _DEPTHS_M[:15]) if kind == "box" else (9e-4, _DEPTHS_M)
    steps = _kept(f"{kind}{number}", lambda: press(foam, shape, depths, spans_m=spans, fine_m=fine))
    return Pushed(shape, (y - half, y + half), tuple(steps), {"body": kind, "y_m": y, **about})


def calibration_plate() -> list[Press]:
    """A plate of 4 cm in the standard foam, at depths at which its user would weigh it."""
    shape, spans = bar(0.017, 0.003), [(-0.024, -0.014), (0.014, 0.024)]
    depths = np.array([0.0015, 0.003, 0.005, 0.0075])
    return _kept("weighed", lambda: press(Foam(), shape, depths, spans_m=spans, fine_m=1.2e-3, layers=4))


def _kept(name: str, solve: Callable[[], list[Press]]) -> list[Press]:
    """States of a press, in a file of the machine's temporary folder that belongs to this very source."""
    source = "".join(
        Path(__file__).with_name(f).read_text("utf-8") for f in ("foam_mechanics.py", "foam_presses.py")
    )
    digest = hashlib.sha256(source.encode()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"foam_presses_{digest}" / f"{name}.npz"
    if not path.exists():
        states = solve()
        path.parent.mkdir(exist_ok=True)
        columns = (np.array(column) for column in zip(*map(astuple, states), strict=True))
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npz", delete=False) as stream:
            np.savez(stream, *columns)
        Path(stream.name).replace(path)
    with np.load(path) as stored:
        columns = [stored[name] for name in stored.files]
    return [
        Press(float(row[0]), float(row[1]), *row[2:6], (float(row[6][0]), float(row[6][1])))
        for row in zip(*columns, strict=True)
    ]
