"""Files that older versions wrote are read, and say what was put into them.

``tests/golden/VERSION`` was written by ``python -m benchmarks.golden`` at that version and is never written again.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks import golden
from visuohaptic.core import EventKind
from visuohaptic.core.camera import Camera
from visuohaptic.io import DepthEncoding, McapFile, OccupancyMap, read_depth, read_force_table, recover
from visuohaptic.io.depth import DepthSequence
from visuohaptic.io.sinks import read_wrench_table

VERSIONS = sorted(path.name for path in Path(__file__).with_name("golden").iterdir() if path.is_dir())


@pytest.fixture(params=VERSIONS)
def old(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy: opening a database may write."""
    return Path(shutil.copytree(Path(__file__).with_name("golden") / request.param, tmp_path / "old"))


def test_cameras_maps_and_depth(old: Path) -> None:
    camera = Camera.load(old / "camera.yaml")
    assert (camera.width, camera.height) == (64, 48)
    grid = OccupancyMap.load(old / "map.yaml")
    assert grid.shape == (9, 12)
    assert grid.origin == pytest.approx((1.0, 2.0, 0.1))
    assert (int(grid.occupied.sum()), int(grid.unknown.sum())) == (12, 12)
    # As `benchmarks.hostile_files` drew them, to half of a millimetre, the unit of the file.
    depth_m = np.random.default_rng(0).uniform(0.5, 3.0, (30, 40))
    np.testing.assert_allclose(read_depth(old / "depth.png", DepthEncoding(1e-3)), depth_m, atol=0.51e-3)
    frames = list(DepthSequence(old / "scan"))
    assert [round(frame.T_world_camera.translation_m[0], 6) for frame in frames] == [0.0, 0.01, 0.02]
    np.testing.assert_allclose(frames[1].depth_m, 0.8, atol=0.51e-4)


def test_tables_and_recordings(old: Path) -> None:
    for name in ("forces.csv", "forces.parquet"):
        table = read_force_table(old / name)
        assert table.force_N.tolist() == [0.0, 1.0, 2.0, 3.0]
        assert table.valid.all()
    assert [len(row["s_m"]) for row in table.profiles] == [9] * 4
    topics = {topic.name: topic.messages for topic in McapFile(old / "run.mcap").topics()}
    assert topics["/beam/wrench"] == 6
    assert topics["/foam/event"] == 6
    events = [m.data for m in McapFile(old / "run.mcap").messages({"/foam/event"})]
    assert all(str(EventKind.CONTACT).encode() in data for data in events)
    whole = recover(old / "wrenches.parquet.part")
    assert [wrench.force_N.tolist() for wrench in read_wrench_table(whole.path)] == [[1.0, 1.0, 1.0]] * 3


def test_shapes_and_layers(old: Path) -> None:
    from visuohaptic.deformation.maps import load_map
    from visuohaptic.io import read_scans
    from visuohaptic.io.meshes import read_ply
    from visuohaptic.navigation.files import load_layer
    from visuohaptic.sensing.beam import Beam, load_beam

    assert load_beam(old / "beam.yaml")[0] == Beam()
    found = load_map(old / "cup.npz")
    assert found.stiffness_N_per_m.shape == (len(found.vertices_m),)
    # Of a paper cup: Alt 2016, Fig. 5.6 has some hundred to some thousand newtons per metre.
    assert 100 < np.nanmedian(found.stiffness_N_per_m) < 1e5
    points = np.random.default_rng(0).uniform(0, 1, (12, 3))
    np.testing.assert_allclose(read_ply(old / "surface.ply").vertices_m, points, rtol=1e-6)
    scans = read_scans(old / "scans.csv")
    assert [scan.ranges_m.tolist() for scan, _ in scans] == [[1.0] * 20] * 3
    np.testing.assert_allclose(load_layer(old / "layer.yaml").values, 1.0)


def test_objects(old: Path) -> None:
    pytest.importorskip("pyarrow")
    from visuohaptic.database import ObjectDatabase, import_object

    with ObjectDatabase(old / "db") as database:
        stored = database.get("box")
    for thing in (stored, import_object(old / "card" / "box")):
        assert thing.id == "box"
        assert thing.tag is not None
        assert thing.tag.dynamic_friction_N is not None
        assert thing.tag.dynamic_friction_N.value == pytest.approx(3.2)
        assert thing.geometry is not None
        assert thing.geometry.faces is not None
        assert len(thing.geometry.faces) == 4


def test_this_version_writes_every_format_of_the_folder(tmp_path: Path, old: Path) -> None:
    """A format that is added is added to the folder of the next release."""
    golden.write(tmp_path / "new")
    names = {path.relative_to(tmp_path / "new").parts[0] for path in (tmp_path / "new").rglob("*")}
    assert names >= {path.relative_to(old).parts[0] for path in old.rglob("*")}
