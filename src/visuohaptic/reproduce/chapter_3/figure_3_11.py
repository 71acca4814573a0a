"""A room mapped by touch (Fig. 3.11).

Fixed obstacles in red, free space in green, movable objects in blue; stronger colours mean higher confidence.
Thin black lines are ground truth, with the movable objects at their initial poses; crosses are the contacts
(simulated room, foam and drifting odometry).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core import PrimitiveKind, rotation_2d
from ...report.style import COLOURS, draw_axes
from ...rigs.virtual_touch_map import RoomTrial, map_virtual_room
from ..output import Output

CONTACTS = 22


def run(out: Output) -> None:
    """Map one room as in the figure, then several others for the statistics.

    Parameters
    ----------
    out
        Receives the tables ``contacts`` and ``cells``, picture ``haptic_map``, and the comparisons; its seed and size are used.
    """
    rooms = 1 if out.quick else 3
    trials = [map_virtual_room(out.seed + k, 6 if out.quick else CONTACTS) for k in range(rooms)]
    first = trials[0]
    out.picture("haptic_map", draw_axes(1, 1, lambda axes: _draw(axes, first), size=(7.5, 6.0)))
    contacts = first.mapping.contacts
    out.table(
        "contacts",
        {
            "x_m": [c.T_map_foam[0] for c in contacts],
            "y_m": [c.T_map_foam[1] for c in contacts],
            "yaw_rad": [c.T_map_foam[2] for c in contacts],
            "primitive": [str(c.primitive.kind) for c in contacts],
            "confidence": [c.confidence for c in contacts],
            "movable": [c.movable for c in contacts],
            "touched": [name for name, _, _ in first.touched],
        },
    )
    haptic = first.mapping.haptic_map
    rows, columns = np.nonzero((haptic.static != 0) | (haptic.movable != 0))
    out.table(
        "cells",
        {
            "x_m": haptic.origin_m[0] + (columns + 0.5) * haptic.resolution_m,
            "y_m": haptic.origin_m[1] + (rows + 0.5) * haptic.resolution_m,
            "fixed": haptic.static[rows, columns],
            "movable": haptic.movable[rows, columns],
        },
    )
    scores = [trial.score for trial in trials]
    out.compare("contacts", len(contacts), dissertation=CONTACTS)
    conditions = f"{rooms} rooms, cells within 0.3 m of a contact"
    out.compare("IoU of occupied space, median", float(np.median([s.occupied_iou for s in scores])),
                note=f"{conditions}; the dissertation shows a picture only")  # fmt: skip
    out.compare("IoU of free space, median", float(np.median([s.free_iou for s in scores])), note=conditions)
    right, count = sum(s.correct_flags for s in scores), sum(s.contacts for s in scores)
    out.compare("contacts rightly called movable or fixed", 100 * right / max(count, 1), "%")
    out.compare("movable things in the layer of the fixed ones", sum(s.mixed for s in scores))
    kinds = [c.primitive.kind for c in contacts]
    out.compare("contacts read as lines or segments",
                sum(k in (PrimitiveKind.LINE, PrimitiveKind.SEGMENT) for k in kinds))  # fmt: skip


def _draw(axes: Any, trial: RoomTrial) -> None:
    haptic = trial.mapping.haptic_map
    fixed, movable = np.clip(haptic.static, -1, 1), np.clip(haptic.movable, 0, 1)
    rgb = np.ones((*fixed.shape, 3))
    for weight, colour in (
        (np.clip(-fixed, 0, 1), (0.0, 0.62, 0.3)),
        (np.clip(fixed, 0, 1), (0.85, 0.1, 0.05)),
        (movable, (0.05, 0.3, 0.85)),
    ):
        fraction = np.sqrt(weight)[..., None]
        rgb = rgb * (1 - fraction) + fraction * np.array(colour)
    x, y = haptic.origin_m
    rows, columns = fixed.shape
    extent = (x, x + columns * haptic.resolution_m, y, y + rows * haptic.resolution_m)
    axes.imshow(rgb, origin="lower", extent=extent, interpolation="nearest")
    for obstacle in trial.room.obstacles:
        for part in obstacle.outlines:
            outline = part.polygon_m() @ rotation_2d(obstacle.yaw_rad).T + (obstacle.x_m, obstacle.y_m)
            axes.plot(*np.vstack([outline, outline[:1]]).T, color=COLOURS["ink"], lw=0.8)
        if obstacle.movable:
            axes.annotate(obstacle.name, (obstacle.x_m, obstacle.y_m), xytext=(8, 4), fontsize=8,
                          textcoords="offset points")  # fmt: skip
    places = np.array([c.T_map_foam[:2] for c in trial.mapping.contacts])
    axes.plot(*places.T, "x", color=COLOURS["ink"], ms=5, mew=1.2)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.grid(visible=False)
