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
