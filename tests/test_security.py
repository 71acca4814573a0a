"""Each sentence of SECURITY.md about a file, an archive, a database, ROS or a page is tested by an attack that must fail."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import golden
from visuohaptic.core import InputError, VisuohapticError
from visuohaptic.core.files import load_json, load_yaml, read_image, read_npy, read_npz
from visuohaptic.deformation import load_thickness_map
from visuohaptic.io import DepthEncoding, McapFile, OccupancyMap, VideoSource, read_depth, read_force_table
from visuohaptic.io.depth import DepthSequence, OnnxModel, read_poses
from visuohaptic.io.meshes import load_mesh, read_ply
from visuohaptic.reconstruction.completion import read_touches
from visuohaptic.ros.nodes.launch import read_launch
from visuohaptic.sensing.beam import read_loads
from visuohaptic.sensing.foam import read_strain_stress
from visuohaptic.tasks import Trace


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of every format."""
    folder = tmp_path_factory.mktemp("formats") / "all"
    golden.write(folder)
    return folder


ROOT = Path(__file__).resolve().parents[1]

READERS = {
    "yaml": load_yaml,
    "image": read_image,
    "npz": lambda path: read_npz(path, "an array"),
    "npy": lambda path: read_npy(path, "an array"),
    "map": OccupancyMap.load,
    "table": read_force_table,
    "parquet": lambda path: read_force_table(path.rename(path.with_suffix(".parquet"))),
    "mcap": McapFile,
    "depth": lambda path: read_depth(path, DepthEncoding(1e-3)),
    "ply": read_ply,
    "mesh": load_mesh,
    "video": lambda path: list(VideoSource(path)),
}


# --- configuration, calibration and map files -------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "a: !!python/object/apply:os.system ['touch hit']",
        "a: !!python/object/new:os.system ['touch hit']",
        "a: !!python/name:os.system",
        "!!python/module:os",
    ],
)
def test_yaml_runs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(InputError, match="is not valid YAML"):
        load_yaml(tmp_path / "a.yaml")
    assert not (tmp_path / "hit").exists()


def test_yaml_of_more_than_16_MiB_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_bytes(b"a: " + b"x" * (16 << 20))
    with pytest.raises(InputError, match="expected at most 16777216"):
        load_yaml(tmp_path / "a.yaml")
    (tmp_path / "a.yaml").write_bytes(bytes(17 << 20))
    with pytest.raises(InputError, match="is not UTF-8 text"):  # of a video, the size is not the problem
        load_yaml(tmp_path / "a.yaml")


#: Readers of each row of the table of largest files, and the name of a file.
LARGEST: dict[str, dict[str, Any]] = {
    "YAML": {"a.yaml": load_yaml},
    "JSON, trajectory": {"a.json": lambda path: load_json(path, "a plan", dict), "a.txt": read_poses},
    "image, table of forces": {"a.png": read_image, "a.csv": read_force_table},
    "PLY, network": {"a.ply": read_ply, "a.onnx": OnnxModel},
    "other mesh": {"a.stl": load_mesh},
    "press log of foam, loads of a beam, trace of a task": {
        "a.csv": read_strain_stress,
        "b.csv": read_loads,
        "a.jsonl": Trace.load,
    },
    "thickness of a wall, contacts, launch file": {
        "a.csv": load_thickness_map,
        "b.csv": read_touches,
        "a.xml": lambda path: read_launch(path, {}),
    },
}


@pytest.mark.skipif(sys.platform == "win32", reason="files with holes")
def test_files_larger_than_the_table_says_are_refused(tmp_path: Path) -> None:
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8").partition("## Largest files")[2]
    table = dict(re.findall(r"^\| ([^|]+) \| (\d+ [MG])iB \|$", text, re.MULTILINE))
    assert table.keys() == LARGEST.keys()
    for kind, said in table.items():
        limit = int(said[:-2]) << {"M": 20, "G": 30}[said[-1]]
        for name, read in LARGEST[kind].items():
            with (tmp_path / name).open("wb") as file:
                file.truncate(limit + 1)
            with pytest.raises(InputError, match=f"has {limit + 1} bytes, expected at most {limit}$"):
                read(tmp_path / name)


# --- names that lead out of their folder ------------------------------------------------------------------------

OUTSIDE = ("../secret.pgm", "/etc/hostname", "sub/../../secret.pgm", "link.pgm", "..\\secret.pgm", "")


@pytest.mark.parametrize("name", OUTSIDE)
def test_the_image_of_a_map_stays_in_its_folder(written: Path, tmp_path: Path, name: str) -> None:
    folder = tmp_path / "map"
    folder.mkdir()
    shutil.copy(written / "map.pgm", tmp_path / "secret.pgm")
    if sys.platform != "win32":
        (folder / "link.pgm").symlink_to(tmp_path / "secret.pgm")
    text = (written / "map.yaml").read_text().replace("map.pgm", json.dumps(name))
    (folder / "map.yaml").write_text(text)
    with pytest.raises(InputError):
        OccupancyMap.load(folder / "map.yaml")


@pytest.mark.parametrize("field", ["camera", "depth", "color", "poses"])
@pytest.mark.parametrize("name", ["..", "../other/x", "/etc/passwd", "link"])
def test_files_of_a_sequence_stay_in_its_folder(written: Path, tmp_path: Path, field: str, name: str) -> None:
    folder = Path(shutil.copytree(written / "scan", tmp_path / "scan"))
    if sys.platform != "win32":
        (folder / "link").symlink_to(tmp_path)
    fields = {"depth_scale_m": 1e-4, field: name}
    (folder / "sequence.yaml").write_text("".join(f"{key}: {value}\n" for key, value in fields.items()))
    with pytest.raises(InputError, match="expected a path inside the folder"):
        DepthSequence(folder)


# --- special files ----------------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and devices as files")
@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["pipe", "zero", "random", "loop", "folder"])
def test_pipes_devices_and_folders_are_refused_before_they_are_opened(
    tmp_path: Path, name: str, kind: str
) -> None:
    path = tmp_path / "a.csv"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind in ("zero", "random"):
        path.symlink_to(f"/dev/{kind}")
    elif kind == "loop":
        path.symlink_to(path)
    else:
        path.mkdir()
    with pytest.raises(VisuohapticError, match=r"a\.(csv|parquet)"):
        READERS[name](path)


# --- archives and stored models ---------------------------------------------------------------------------------


def test_stored_arrays_run_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    class Hit:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.system, ("touch hit",)

    objects = np.array([Hit()], dtype=object)
    np.savez("a.npz", a=objects)
    np.save("a.npy", objects)
    for reader, path in ((READERS["npz"], tmp_path / "a.npz"), (READERS["npy"], tmp_path / "a.npy")):
        with pytest.raises(InputError, match="Python objects"):
            reader(path)
    assert not (tmp_path / "hit").exists()


@pytest.mark.parametrize("member", ["../a.npy", "/a.npy", "a.exe", "a.npy/"])
def test_archives_write_nothing_and_hold_arrays_only(tmp_path: Path, member: str) -> None:
    np.save(tmp_path / "one.npy", np.ones(3))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.write(tmp_path / "one.npy", member)
    (tmp_path / "one.npy").unlink()
    before = sorted(path.name for path in tmp_path.parent.rglob("*"))
    try:
        assert READERS["npz"](tmp_path / "a.npz")
    except InputError as error:
        assert "a.npz" in str(error)  # noqa: PT017 - either is right: a name is only a key
    assert sorted(path.name for path in tmp_path.parent.rglob("*")) == before


def test_an_archive_that_unpacks_to_gigabytes_is_refused_by_its_headers(tmp_path: Path) -> None:
    header = (
        b"\x93NUMPY\x01\x00\x76\x00"
        + b"{'descr': '<f8', 'fortran_order': False, 'shape': (250000000,), }".ljust(117)
        + b"\n"
    )
    # After a full flush the compressor is as at its start: the same bytes expand to another megabyte of zeros.
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    first = packer.compress(header) + packer.flush(zlib.Z_FULL_FLUSH)
    million = packer.compress(bytes(1_000_000)) + packer.flush(zlib.Z_FULL_FLUSH)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", first + 2000 * million + packer.flush())
    # Stored so far: both headers are told that it is deflated, and its size. The checksum is not that of the zeros.
    data = bytearray((tmp_path / "a.npz").read_bytes())
    for start, method, size in ((0, 8, 22), (data.rindex(b"PK\x01\x02"), 10, 24)):
        data[start + method : start + method + 2] = zipfile.ZIP_DEFLATED.to_bytes(2, "little")
        data[start + size : start + size + 4] = (len(header) + 2_000_000_000).to_bytes(4, "little")
    (tmp_path / "a.npz").write_bytes(data)
    with zipfile.ZipFile(tmp_path / "a.npz") as archive, archive.open("a.npy") as unpacked:
        assert unpacked.read(3_000_000) == header + bytes(3_000_000 - len(header))
    assert (tmp_path / "a.npz").stat().st_size < 5_000_000
    with pytest.raises(InputError, match="unpacks to more than"):
        READERS["npz"](tmp_path / "a.npz")


@pytest.mark.parametrize("change", ["hash", "size", "file", "name", "version"])
def test_cards_whose_files_were_changed_are_refused(written: Path, tmp_path: Path, change: str) -> None:
    pytest.importorskip("pyarrow")
    from visuohaptic.database import import_object

    folder = Path(shutil.copytree(written / "card" / "box", tmp_path / "box"))
    card = (folder / "card.yaml").read_text()
    if change == "file":
        (folder / "arrays.parquet").write_bytes(b"PAR1" + bytes(40))
    else:
        old, new = {
            "hash": ("sha256: ", "sha256: 0"),
            "size": ("bytes: 1", "bytes: 2"),
            "name": ("arrays.parquet", "../arrays.parquet"),
            "version": ("version: 1", "version: 99"),
        }[change]
        assert old in card
        (folder / "card.yaml").write_text(card.replace(old, new))
    with pytest.raises(InputError, match=r"card\.yaml|arrays\.parquet"):
        import_object(folder)


# --- databases --------------------------------------------------------------------------------------------------


def test_folders_with_signs_of_addresses_are_databases_of_their_own(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    from visuohaptic.core import VisuoHapticObject
    from visuohaptic.database import ObjectDatabase

    names = ("run?1", "run?2", "per%20cent", "a#b", "c&d=e", "mode=ro")
    for name in names:
        with ObjectDatabase(tmp_path / name) as database:
            database.add(VisuoHapticObject("box", name=name))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    for name in names:
        with ObjectDatabase(tmp_path / name) as database:
            assert database.get("box").name == name


@pytest.mark.parametrize(
    "address",
    [
        "mysql://bob:s3cr3t@h/n",
        "postgresql+pg8000://bob:s3cr3t@h/n",
        "postgres+x://bob:s3cr3t@h/n",
        "postgresql://h:port/n?user=bob&password=s3cr3t",
        "postgresql://bob:s3cr3t@h:port/n",
        "postgresql://bob:a@s3cr3t/x?y@[::1/n",
    ],
)
def test_no_message_shows_a_password(address: str) -> None:
    pytest.importorskip("sqlalchemy")
    from visuohaptic.database import ObjectDatabase

    with pytest.raises(VisuohapticError) as refused:
        ObjectDatabase(address)
    assert "s3cr3t" not in str(refused.value)


def test_texts_of_objects_are_no_statements(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    from visuohaptic.core import VisuoHapticObject
    from visuohaptic.database import ObjectDatabase

    text = "'; DROP TABLE objects; --"
    with ObjectDatabase(tmp_path / "db") as database:
        database.add(VisuoHapticObject("a", name=text, visual_class=text))
        assert [one.id for one in database.summaries(name=text)] == ["a"]
        assert [one.id for one in database.summaries(visual_class="' OR 1=1 --")] == []


# --- tables and reports -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["=1+1", "=cmd|' /C calc'!A0", "__import__('os').system('touch hit')", "1e999x"]
)
def test_tables_are_numbers_and_texts(written: Path, tmp_path: Path, text: str) -> None:
    lines = (written / "forces.csv").read_text().splitlines()
    fields = lines[2].split(",")
    fields[3] = text
    (tmp_path / "a.csv").write_text("\n".join([lines[0], lines[1], ",".join(fields)]) + "\n")
    with pytest.raises(InputError, match="line 3, force_N: found"):
        read_force_table(tmp_path / "a.csv")


def test_the_report_escapes_texts_and_loads_nothing(tmp_path: Path) -> None:
    from visuohaptic.report import Report

    hostile = "<script src='http://evil.example/x.js'>alert(1)</script>\"'><img src=x onerror=alert(1)>"
    report = Report(hostile, about=hostile)
    report.section(hostile).text(hostile)
    page = report.write(tmp_path / "a.html").read_text()
    assert "<script" not in page
    assert "<img src=x" not in page
    assert "Content-Security-Policy" in page
    assert "default-src 'none'" in page


# --- ROS --------------------------------------------------------------------------------------------------------


def test_messages_that_promise_more_than_they_hold_are_refused() -> None:
    pytest.importorskip("visuohaptic.ros.wire.message_types", exc_type=ImportError)
    from visuohaptic.ros.wire import cdr
    from visuohaptic.ros.wire.message_types import message_type

    kind = message_type("std_msgs/msg/String")
    for length in (0xFFFFFFFF, 0x7FFFFFFF, 1 << 20):
        data = b"\0\1\0\0" + length.to_bytes(4, "little") + b"abc\0"
        with pytest.raises(InputError, match="std_msgs/msg/String"):
            cdr.decode(data, kind)
