"""One-line errors of a database, and reading while others write."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import struct
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sqlalchemy")
pytest.importorskip("pyarrow")

from benchmarks.objects_faults import make_object

from visuohaptic.cli.main import main
from visuohaptic.core import (
    DatabaseError,
    FeatureVector,
    Geometry,
    InputError,
    MissingExtraError,
    Provenance,
    VisuoHapticObject,
)
from visuohaptic.core.files import save_yaml
from visuohaptic.database import (
    FeatureIndex,
    ObjectDatabase,
    combine,
    connect_server,
    export_object,
    import_object,
    import_objects,
    merge_objects,
    open_database,
)
from visuohaptic.database.array_store import ArrayStore
from visuohaptic.database.shards import ShardFolder

CUBE = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
#: Two of its twelve triangles.
FACES = np.array([[0, 1, 3], [0, 3, 2]])


@pytest.mark.parametrize("object_id", ["", ".hidden", "a/b", "-x", "a b", "x" * 129, "Küche"])
def test_ids_are_names_of_folders(tmp_path: Path, object_id: str) -> None:
    with open_database(tmp_path) as db:
        with pytest.raises(InputError, match="expected up to 128 letters"):
            db.add(VisuoHapticObject(object_id))
        db.add(VisuoHapticObject("x" * 128))
        assert len(db) == 1


def test_a_refused_object_leaves_no_database(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in (
        (["a/b"], "found the id 'a/b'"),
        (["cup", "--name", "caf\udce9"], "expected text in Unicode"),
    ):
        assert main(["objects", "add", *words, "--db", str(tmp_path / "db")]) == 2
        assert said in capsys.readouterr().err
        assert not (tmp_path / "db").exists()


def test_text_that_a_server_cannot_store_is_refused_here_already(tmp_path: Path) -> None:
    with open_database(tmp_path / "db") as db:
        for name in ("name", "visual_class"):
            with pytest.raises(
                InputError, match=r"object a: found .cu.x00p., expected text without zero bytes"
            ):
                db.add(VisuoHapticObject("a", **{name: "cu\0p"}))


def test_a_folder_among_the_shards_is_left_alone(tmp_path: Path) -> None:
    with open_database(tmp_path / "db") as db:
        db.add(VisuoHapticObject("a"))
    (tmp_path / "db" / "shards" / "lost+found").mkdir()
    with open_database(tmp_path / "db") as db:
        db.add(VisuoHapticObject("b"))
        assert len(db) == 2
    assert (tmp_path / "db" / "shards" / "lost+found").is_dir()


def test_a_database_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a database of objects"):
        open_database(tmp_path / "none", create=False)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file/db: cannot be created \(Not a directory\)"):
        open_database(tmp_path / "file" / "db")
    with open_database(tmp_path / "db") as db:
        for missing in (db.get, db.remove):
            with pytest.raises(InputError, match="there is no object 'cup'"):
                missing("cup")


def test_a_file_that_is_no_database_or_of_a_newer_version(tmp_path: Path) -> None:
    with open_database(tmp_path / "new"):
        pass
    with closing(sqlite3.connect(tmp_path / "new" / "objects.sqlite")) as file:
        for version, said in (
            ("99", "has schema version 99, expected at most"),
            ("x", "found schema version 'x'"),
        ):
            file.execute("UPDATE meta SET value = ? WHERE key = 'schema'", (version,))
            file.commit()
            with pytest.raises(DatabaseError, match=said):
                open_database(tmp_path / "new")
    (tmp_path / "text").mkdir()
    (tmp_path / "text" / "objects.sqlite").write_text("some text")
    with pytest.raises(DatabaseError, match="is not a database"):
        open_database(tmp_path / "text")


def test_a_server_without_its_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(MissingExtraError, match=r"visuohaptic\[shared\]"):
        connect_server("postgresql://host/name")


@pytest.mark.parametrize("times", [1, 4])
def test_what_is_replaced_while_it_is_read_is_read_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, times: int
) -> None:
    """Another process replaces the arrays between the reading of a row and that of its arrays, some times."""
    with open_database(tmp_path) as db, open_database(tmp_path) as other:
        db.add(replace(make_object(1), id="cup"))
        read, numbers = ArrayStore.read_ahead, iter(range(2, 2 + times))

        def read_late(self: ArrayStore, rows: Sequence[Any]) -> object:
            if self is db._arrays and (number := next(numbers, None)) is not None:
                felt = {"stiffness": Provenance("felt", float(number))}
                other.add(VisuoHapticObject("cup", stiffness=make_object(number).stiffness, provenance=felt))
            return read(self, rows)

        monkeypatch.setattr(ArrayStore, "read_ahead", read_late)
        found, last = db.get("cup").stiffness, make_object(1 + times).stiffness
        assert found is not None
        assert last is not None
        np.testing.assert_array_equal(found.vertices_m, last.vertices_m)


def test_arrays_that_are_gone_or_of_another_object(tmp_path: Path) -> None:
    with open_database(tmp_path) as db:
        db.add(make_object(1))
        db.add(make_object(2))
    first, second = sorted((tmp_path / "shards").iterdir())
    kept = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(kept)
    with open_database(tmp_path) as db:
        for number in (1, 2):
            with pytest.raises(DatabaseError, match="do not match their stored hash"):
                db.get(f"o000000{number}")
        assert len([one for one in db.check().problems if "another hash" in one]) == 2
    first.unlink()
    second.write_bytes(b"PAR1 half")
    with open_database(tmp_path) as db:
        said = []
        for one in ("o0000001", "o0000002"):
            for read in (db.get, lambda one, db=db: db.stored([one])):
                with pytest.raises(DatabaseError) as refusal:
                    read(one)
                said.append(str(refusal.value))
        assert sum("missing; check the database" in one for one in said) == 2
        assert sum("is not a readable shard" in one for one in said) == 2
        assert any("is missing" in one for one in db.check().problems)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("UPDATE object SET card = replace(card, 'object 1', 'object 9')", "has another hash"),
        ("UPDATE object SET card = '{'", "is damaged"),
        ("UPDATE object SET card = '[]'", "is damaged"),
        ("UPDATE object SET row_group = 7", "has arrays of 1 objects, expected number 7"),
        ("PRAGMA foreign_keys = OFF; UPDATE object SET shard = 'x'", "broken reference"),
    ],
)
def test_rows_that_were_changed_are_found(tmp_path: Path, change: str, said: str) -> None:
    with open_database(tmp_path) as db:
        db.add(make_object(1))
        assert db.check().problems == ()
    with closing(sqlite3.connect(tmp_path / "objects.sqlite")) as file:
        file.executescript(change)
    with open_database(tmp_path) as db:
        assert any(said in problem for problem in db.check().problems)


def test_objects_are_listed_by_what_is_asked(tmp_path: Path) -> None:
    with open_database(tmp_path) as db:
        db.add_many([VisuoHapticObject("a", name="Red_Cup"), VisuoHapticObject("b", name="redxcup")])
        assert [one.id for one in db.summaries(name="red_cup")] == ["a"]  # _ is a letter, not any letter
        assert [one.id for one in db.summaries(name="RED")] == ["a", "b"]
        assert [one.change for one in db.summaries()] == [db.last_change()] * 2
        assert db.changed(0) == ({"a": 1, "b": 1}, 1)
        assert db.changed(1) == ({}, 1)
        db.add(VisuoHapticObject("c", name="Ölflasche"))
        assert [[one.id for one in db.summaries(name=name)] for name in ("Öl", "ölF")] == [["c"]] * 2


def test_features_of_one_kind_have_one_length(tmp_path: Path) -> None:
    with open_database(tmp_path) as db:
        for count in (3, 4):
            db.add(VisuoHapticObject(f"f{count}", features={"k": FeatureVector(np.arange(float(count)))}))
        with pytest.raises(InputError, match=r"found features 'k' of \[3, 4\] numbers"):
            db.features("k")
        ids, vectors = db.features("other")
        assert (list(ids), len(vectors)) == ([], 0)
        db.remove("f3")
        np.testing.assert_array_equal(db.features("k")[1], [[0.0, 1.0, 2.0, 3.0]])


def test_what_a_search_refuses() -> None:
    index = FeatureIndex(["a", "b"], np.zeros((2, 3)))
    assert len(index) == 2
    assert [match.distance for match in index.nearest(np.array([3.0, 4.0, np.nan]), 2)] == [5.0, 5.0]
    for query in (np.zeros(2), np.full(3, np.nan), np.array([0.0, np.inf, 0.0])):
        with pytest.raises(InputError, match="expected 3 numbers"):
            index.nearest(query)
    with pytest.raises(InputError, match="found 0, expected 1 or more"):
        index.nearest(np.zeros(3), 0)
    for ids, vectors in (
        (["a"], np.zeros((2, 3))),
        (["a"], np.array([[np.nan]])),
        (["a"], np.zeros(1)),
        (["a"], np.zeros((1, 600_000))),
    ):
        with pytest.raises(InputError, match="expected one row of at most"):
            FeatureIndex(ids, vectors)
    assert FeatureIndex([], np.zeros((0, 3))).nearest(np.zeros(3)) == []


def test_what_a_merge_refuses() -> None:
    with pytest.raises(InputError, match="expected at least one"):
        combine([])
    with pytest.raises(InputError, match="expected one id"):
        merge_objects(VisuoHapticObject("a"), VisuoHapticObject("b"))


def test_folders_that_cannot_be_exported_or_imported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="has no licence"):
        export_object(VisuoHapticObject("cup"), tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        export_object(VisuoHapticObject("cup"), tmp_path / "file", licence="CC0-1.0")
    with pytest.raises(InputError, match=r"found no card\.yaml"):
        next(import_objects(tmp_path))
    box = VisuoHapticObject("box", geometry=Geometry(CUBE, FACES))
    card = export_object(box, tmp_path / "out", licence="CC0-1.0")
    folder = card if card.is_dir() else card.parent
    assert [one.id for one in import_objects(folder)] == ["box"]
    (folder / "mesh.glb").unlink()
    with pytest.raises(InputError, match=r"mesh\.glb: is missing, but card.yaml lists it"):
        import_object(folder)


@pytest.mark.parametrize("name", ["../evil", "/evil", "a/b", "", ".", "a" * 129])
def test_an_id_does_not_lead_out_of_the_folder_of_an_export(tmp_path: Path, name: str) -> None:
    """As of a card of others that is read and written again."""
    with pytest.raises(InputError, match=r"found the id .*, expected up to 128 letters"):
        export_object(VisuoHapticObject(name, licence="CC0-1.0"), tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_a_card_of_a_mesh_alone_has_its_geometry(tmp_path: Path) -> None:
    """Cards written by hand name a mesh and no arrays."""
    import trimesh
    import yaml

    mesh = trimesh.Trimesh(CUBE, FACES, process=False).export(file_type="glb")
    for name, data, said in (("whole", mesh, ""), ("half", mesh[:60], "has no valid glTF document")):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "mesh.glb").write_bytes(data)
        about = {"mesh.glb": {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}}
        card = {"format": "visuohaptic object", "version": 1, "licence": "CC0-1.0", "object": {"id": "box"}}
        (folder / "card.yaml").write_text(yaml.safe_dump({**card, "files": about}))
        if said:
            with pytest.raises(InputError, match=said):
                import_object(folder)
        else:
            shape = import_object(folder).geometry
            assert shape is not None
            np.testing.assert_allclose(shape.vertices_m, CUBE, atol=1e-7)
            np.testing.assert_array_equal(shape.faces, FACES)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"accessors": [{"componentType": 5126, "count": 2**30, "type": "VEC3"}]}, "more elements than fit"),
        ({"nodes": [{"mesh": 0}] * 30_000}, "has 30000 nodes, expected at most 10000"),
        ({"nodes": [{"mesh": 0}] * 9_000}, "has 9000000 vertices, expected at most 6000000"),
        (
            {
                "nodes": [{"mesh": 0}] * 9_000,
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
                "accessors": [
                    {"componentType": 5126, "count": 4, "type": "VEC3"},
                    {"componentType": 5125, "count": 5000, "type": "SCALAR"},
                ],
            },
            "has 45000000 corners of triangles, expected at most 36000000",
        ),
        (
            {"nodes": [], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}] * 7_000}]},
            "has 7000000 vertices, expected at most 6000000",
        ),
    ],
)
def test_a_mesh_of_a_card_that_declares_gigabytes_is_refused(tmp_path: Path, change: dict, said: str) -> None:
    """A few hundred bytes declare 12 GB of zeros, and copies of one mesh, or of its triangles, multiply it."""
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": 5126, "count": 1000, "type": "VEC3"}],
        "buffers": [{"byteLength": 12000}],
    }  # fmt: skip
    text = json.dumps(document | change).encode()
    text += b" " * (-len(text) % 4)
    parts = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", 12000, b"BIN\0") + bytes(12000)
    )
    data = b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts
    (tmp_path / "mesh.glb").write_bytes(data)
    about = {"mesh.glb": {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}}
    card = {"format": "visuohaptic object", "version": 1, "licence": "CC0-1.0", "object": {"id": "box"}}
    save_yaml(tmp_path / "card.yaml", {**card, "files": about})
    with pytest.raises(InputError, match=said):
        import_object(tmp_path)


def test_few_shards_stay_open(tmp_path: Path) -> None:
    folder = ShardFolder(tmp_path, open_files=2)
    names = [folder.write([{"a": np.array([float(n)])}])[0] for n in range(4)]
    for _ in range(2):
        for n, name in enumerate(names):
            (arrays,) = folder.read(name, [0])
            assert arrays["a"] == [float(n)]
            assert len(folder._open) <= 2
    folder.read(names[2], [0])
    assert list(folder._open) == [names[3], names[2]]  # the longest unused is closed first
    folder.remove([names[2], "not there"])
    assert list(folder._open) == [names[3]]
    assert len(list(tmp_path.iterdir())) == 3
    folder.close()
    assert len(folder._open) == 0


@pytest.mark.parametrize("columns", [{"name": ["a"]}, {"dtype": ["object"]}, {"shape": ["2x2"]}])
def test_shards_with_rows_that_are_no_arrays(tmp_path: Path, columns: dict[str, Any]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    right = {"name": ["a"], "dtype": ["float64"], "shape": ["1"], "data": [b"12345678"]}
    rows = columns if "name" in columns else right | columns
    pq.write_table(pa.table(rows), tmp_path / "x.parquet", compression="none", use_dictionary=False)
    with pytest.raises(InputError, match=r"x\.parquet: (is not a readable shard|array 'a' is of 'object')"):
        ShardFolder(tmp_path).read("x", [0])


@pytest.mark.parametrize("packed", [{"compression": "zstd"}, {"use_dictionary": True, "compression": "none"}])
def test_a_shard_that_would_unpack_to_far_more_than_its_file_is_refused(
    tmp_path: Path, packed: dict[str, Any]
) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = {
        "name": ["a"] * 64,
        "dtype": ["uint8"] * 64,
        "shape": ["262144"] * 64,
        "data": [bytes(1 << 18)] * 64,
    }
    pq.write_table(pa.table(rows), tmp_path / "x.parquet", **{"use_dictionary": False, **packed})
    assert (tmp_path / "x.parquet").stat().st_size < 1 << 19  # of 16 MiB
    before = pa.total_allocated_bytes()
    with pytest.raises(
        InputError, match=r"x\.parquet: \w+: found 64 values, .*expected an uncompressed shard"
    ):
        ShardFolder(tmp_path).read("x", [0])
    assert pa.total_allocated_bytes() - before < 1 << 20


def test_an_added_object_undoes_its_deletion_and_what_is_older_does_not(tmp_path: Path) -> None:
    def felt(t_s: float) -> VisuoHapticObject:
        return VisuoHapticObject("cup", name="cup", provenance={"name": Provenance("felt", t_s)})

    with open_database(tmp_path) as db:
        db.add(felt(1.0))
        db.remove("cup", t_s=5.0)
        assert ObjectDatabase.__contains__(db, "cup") is False
        db.write_merged({"cup": (felt(5.0), None)})
        assert "cup" not in db
        db.write_merged({"cup": (felt(5.1), None)})
        assert "cup" in db
        db.remove("cup", t_s=9.0)
        assert db.add(felt(20.0)).provenance == {"name": Provenance("felt", 20.0)}
        db.remove("cup", t_s=30.0)
        assert db.add(felt(2.0)).provenance["id"].t_s > 30.0
