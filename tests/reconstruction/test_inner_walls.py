"""A label on a bottle is a tube with an inner side; glass above closes it, and nothing else in the scene is touched."""

from __future__ import annotations

import numpy as np

from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import HoleRegion, remove_back_sides

from .test_sight import wall

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)])


def label():
    """Outer side of a label and its inner side, read 12 mm too near to the axis; sizes of both in triangles."""
    outer, inner = wall(0.04, True, high_m=0.05), wall(0.028, False, high_m=0.045)
    return outer.joined(inner), len(outer.faces), len(inner.faces)


def square(half_m, z_m, at=(0.0, 0.0), count=24):
    """A level square, facing up."""
    line = np.linspace(-half_m, half_m, count)
    x, y = (part.ravel() for part in np.meshgrid(line + at[0], line + at[1], indexing="ij"))
    i, j = (part.ravel() for part in np.mgrid[0 : count - 1, 0 : count - 1])
    a, b = i * count + j, (i + 1) * count + j
    faces = np.concatenate([np.column_stack([a, b, b + 1]), np.column_stack([a, b + 1, a + 1])])
    return SurfaceMesh(np.column_stack([x, y, np.full(len(x), z_m)]), faces)


def test_the_inner_side_of_a_label_is_dropped_and_its_outer_side_is_kept():
    mesh, outer, inner = label()
    # As detected: it begins 2 cm above the label, and is a bit narrower than the bottle, which stands on a table.
    glass = HoleRegion.of_points(CUBE * [0.035, 0.035, 0.08] + [0, 0, 0.07])
    kept = remove_back_sides(mesh.joined(square(0.2, -0.001)), glass)
    middle = kept.vertices_m[kept.faces].mean(axis=1)
    rho = np.hypot(*middle[:, :2].T)
    above = middle[:, 2] > 0
    assert (above & (rho > 0.035)).sum() == outer
    assert (above & (rho < 0.035)).sum() < 0.02 * inner


def test_an_open_cup_keeps_its_inside_and_the_scene_stays():
    mesh, _, _ = label()
    elsewhere = HoleRegion.of_points(CUBE * [0.03, 0.03, 0.08] + [0.12, 0, 0.0])
    rows = remove_back_sides(mesh, elsewhere)
    # Glass beside it closes nothing: what is seen through the open ends stays.
    assert len(rows.faces) > 0.95 * len(mesh.faces)
    glass = HoleRegion.of_points(CUBE * [0.035, 0.035, 0.08] + [0, 0, 0.07])
    table, box = square(0.2, -0.001), square(0.03, 0.06, at=(0.1, 0.0))
    whole = remove_back_sides(mesh.joined(table).joined(box), glass)
    far = np.hypot(*whole.vertices_m[whole.faces].mean(axis=1)[:, :2].T) > 0.05
    both = np.concatenate([part.vertices_m[part.faces].mean(axis=1) for part in (table, box)])
    assert far.sum() == (np.hypot(*both[:, :2].T) > 0.05).sum()


def test_a_bottle_without_a_label_is_returned_as_it_is():
    shoulder = wall(0.04, True, high_m=0.05)
    cone = shoulder.vertices_m.copy()
    # A flat shoulder under the region drawn out looks up, and nothing stands before it.
    cone[:, :2] *= (1 - 0.9 * cone[:, 2:] / 0.05) * 1.0
    cone[:, 2] = 0.06 + 0.1 * cone[:, 2]
    mesh = shoulder.joined(SurfaceMesh(cone, shoulder.faces))
    glass = HoleRegion.of_points(CUBE * [0.035, 0.035, 0.08] + [0, 0, 0.07])
    assert remove_back_sides(mesh, glass) is mesh


def test_walls_that_all_look_outwards_are_kept():
    outer = wall(0.04, True, high_m=0.05)
    glass = HoleRegion.of_points(CUBE * [0.035, 0.035, 0.08] + [0, 0, 0.05])
    assert remove_back_sides(outer, glass) is outer


def test_an_outer_wall_that_looks_down_a_little_is_kept():
    """Walls of a fused surface are rough: some triangles of an outside look down by 20 degrees, n_z = -0.34."""
    outer, inner = wall(0.04, True, high_m=0.05), wall(0.028, False, high_m=0.045)
    leaning = outer.vertices_m.copy()
    leaning[:, :2] *= 1 + np.tan(np.radians(20)) * leaning[:, 2:] / 0.04
    mesh = SurfaceMesh(leaning, outer.faces).joined(inner)
    glass = HoleRegion.of_points(CUBE * [0.045, 0.045, 0.08] + [0, 0, 0.03])
    kept = remove_back_sides(mesh, glass)
    rho = np.hypot(*kept.vertices_m[kept.faces].mean(axis=1)[:, :2].T)
    assert (rho > 0.035).sum() == len(outer.faces)
