"""``visuohaptic complete``: touches that cannot belong to the object are refused before anything is computed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.simulation.tabletop import random_bottle


@pytest.fixture
def bottle(tmp_path: Path) -> Path:
    """The lower and upper part of a bottle, and the region between."""
    shape = random_bottle(np.random.default_rng(4), "elliptic")
    low, high = 0.3 * shape.height_m, 0.7 * shape.height_m
    visible = SurfaceMesh(*shape.mesh(0.0, low)).joined(SurfaceMesh(*shape.mesh(high, shape.height_m)))
    visible.save(tmp_path / "surface.ply")
    hidden, _ = shape.mesh(low, high, caps=False)
    (tmp_path / "regions.json").write_text(json.dumps({"clusters": [{"hull": hidden.tolist()}]}))
    return tmp_path


def test_touches_in_millimetres_are_refused(bottle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (bottle / "touches.csv").write_text("x_m,y_m,z_m\n35.0,0.0,100.0\n")
    words = [str(bottle / "surface.ply"), "--region", str(bottle / "regions.json")]
    code = main(
        ["complete", *words, "--touches", str(bottle / "touches.csv"), "--out", str(bottle / "c.ply"), "-q"]
    )
    said = capsys.readouterr().err
    assert code == 2
    assert "touch 1: found a contact 1" in said
    assert "expected at most 0." in said
    assert not (bottle / "c.ply").exists()


def test_the_back_of_an_opaque_object_is_completed_in_a_box(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of an upright elliptic cylinder the side y < 0 and the lid are seen; planned lines meet the other side."""
    half, top = np.array([0.04, 0.03]), 0.12
    theta, z = np.meshgrid(np.linspace(0, 2 * np.pi, 97), np.linspace(0, top, 25), indexing="ij")
    points = np.column_stack([half[0] * np.cos(theta).ravel(), half[1] * np.sin(theta).ravel(), z.ravel()])
    k = (np.arange(96)[:, None] * 25 + np.arange(24)).ravel()
    faces = np.vstack([np.column_stack([k, k + 25, k + 26]), np.column_stack([k, k + 26, k + 1])])
    rim = np.arange(97) * 25 + 24
    lid = np.column_stack([rim[:-1], rim[1:], np.full(96, len(points))])
    whole = SurfaceMesh(np.vstack([points, [0.0, 0.0, top]]), np.vstack([faces, lid]))
    seen = (whole.face_normals[:, 1] < 0.1) | (whole.face_normals[:, 2] > 0.9)
    whole.submesh(np.flatnonzero(seen)).save(tmp_path / "surface.ply")
    words = ["complete", str(tmp_path / "surface.ply"), "--out", str(tmp_path / "c.ply"), "--next", "--json"]
    box = ["--hidden", "-4e-2", "0.005", "0.005", "0.04", "0.032", "0.115"]
    rows, found, rms_m = ["x_m,y_m,z_m,start_x_m,start_y_m,start_z_m"], [], []
    for number in range(5):
        (tmp_path / "touches.csv").write_text("\n".join(rows) + "\n")
        assert main([*words, *box, *(["--touches", str(tmp_path / "touches.csv")] if number else [])]) == 0
        found.append(json.loads(capsys.readouterr().out))
        wall = SurfaceMesh.load(tmp_path / "c.ply").vertices_m
        wall = wall[(wall[:, 1] > 0.005) & (wall[:, 2] > 0.01) & (wall[:, 2] < 0.11)]
        # Distance from the ellipse along its normal, to first order.
        level = np.hypot(*(wall[:, :2] / half).T)
        slope = np.hypot(*(wall[:, :2] / half**2).T) / level
        rms_m.append(float(np.sqrt(np.mean(((level - 1) / slope) ** 2))))
        start, way = np.array(found[-1]["next"]["start_m"]), np.array(found[-1]["next"]["direction"])
        a = ((way[:2] / half) ** 2).sum()
        b = (start[:2] * way[:2] / half**2).sum()
        met = start + (-b - np.sqrt(b**2 - a * (((start[:2] / half) ** 2).sum() - 1))) / a * way
        rows.append(",".join(f"{value:.6f}" for value in (*met, *start)))
    # The side that is seen tells the other one to the declared deviation; four touches halve what is left.
    assert rms_m[0] < 2 * found[0]["expected_error_m"] < 0.005
    assert rms_m[-1] < 0.5 * rms_m[0]
    assert found[-1]["expected_error_m"] < found[0]["expected_error_m"]
    assert main([*words, "--hidden", *["-1e9"] * 3, *["1e9"] * 3]) == 2
    assert "region of 2e+09 m, expected at most" in capsys.readouterr().err
    assert main([*words, *box, "--region", "regions.json"]) == 2
    assert "expected one of them" in capsys.readouterr().err
