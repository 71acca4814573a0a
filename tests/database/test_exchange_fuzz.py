"""Damaged exchange folders: one clear error, and nothing half-imported."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("sqlalchemy")
pytest.importorskip("pyarrow")
pytest.importorskip("trimesh")

from benchmarks.objects_faults import make_object

from visuohaptic.core import Geometry, InputError
from visuohaptic.database import export_object, import_object, import_objects, open_database

#: Texts that replace one value of a card.
_VALUES = (
    None,
    [],
    {},
    -1,
    1e400,
    float("nan"),
    "",
    "x" * 5000,
    "../../etc",
    [[1]],
    {"array": "no"},
    True,
    2**70,
)


def _mutated_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    broken = bytearray(data)
    kind = int(rng.integers(4))
    if kind == 0:
        return bytes(broken[: int(rng.integers(len(broken)))])
    if kind == 1:
        start = int(rng.integers(len(broken)))
        del broken[start : start + int(rng.integers(1, 64))]
        return bytes(broken)
    for place in rng.integers(0, len(broken), int(rng.integers(1, 20))):
        broken[place] = int(rng.integers(256))
    return bytes(broken) + (rng.bytes(100) if kind == 2 else b"")


def _mutated_card(card: dict, rng: np.random.Generator) -> None:
    """One value, anywhere below, is replaced, dropped or called otherwise."""
    here = card
    while True:
        key = sorted(here)[int(rng.integers(len(here)))]
        if isinstance(here[key], dict) and here[key] and rng.random() < 0.8:
            here = here[key]
            continue
        break
    kind = int(rng.integers(3))
    value = here.pop(key)
    if kind == 0:
        here[key] = _VALUES[int(rng.integers(len(_VALUES)))]
    elif kind == 1:
        here[f"{key}_"] = value


def _sign_again(folder: Path) -> None:
    """The card with the hashes of the damaged files: what is in them must be distrusted, too."""
    path = folder / "card.yaml"
    card = yaml.safe_load(path.read_text())
    for name in card["files"]:
        data = (folder / name).read_bytes()
        card["files"][name] = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    path.write_text(yaml.safe_dump(card))


@pytest.mark.parametrize("block", range(4))
def test_damaged_folders(tmp_path: Path, block: int) -> None:
    rng = np.random.default_rng(block)
    obj = make_object(1, vertices=12)
    mesh = Geometry(rng.normal(size=(12, 3)), rng.integers(0, 12, (20, 3)))
    obj = replace(obj, geometry=mesh, licence="CC0-1.0")
    folder = export_object(obj, tmp_path / "out")
    whole = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert set(whole) == {"card.yaml", "arrays.parquet", "mesh.glb"}
    messages = []
    with open_database(tmp_path / "db") as db:
        for number in range(30):
            for name, data in whole.items():
                (folder / name).write_bytes(data)
            if number % 3 == 0:
                card = yaml.safe_load(whole["card.yaml"])
                _mutated_card(card, rng)
                (folder / "card.yaml").write_text(yaml.safe_dump(card))
            elif number % 3 == 1:
                name = sorted(whole)[int(rng.integers(3))]
                (folder / name).write_bytes(_mutated_bytes(whole[name], rng))
            else:
                name = ("arrays.parquet", "mesh.glb")[int(rng.integers(2))]
                if name == "mesh.glb":  # it is only read where the card has no mesh
                    card = yaml.safe_load(whole["card.yaml"])
                    del card["object"]["geometry"]
                    (folder / "card.yaml").write_text(yaml.safe_dump(card))
                (folder / name).write_bytes(_mutated_bytes(whole[name], rng))
                _sign_again(folder)
            before = len(db)
            try:
                found = import_object(folder)
                db.add(found)
            except InputError as error:
                messages.append(str(error))
                assert len(db) == before
            else:
                db.get(found.id)  # what was taken can be read
                assert (
                    found.geometry is None
                    or found.geometry.faces is None
                    or (found.geometry.faces.max(initial=0) < len(found.geometry.vertices_m))
                )
        assert db.check().problems == ()
    assert len(messages) > 10
    assert all("\n" not in text and len(text) < 2000 for text in messages)


def test_a_damaged_folder_among_whole_ones(tmp_path: Path) -> None:
    for number in range(3):
        export_object(make_object(number, vertices=12), tmp_path / "out", licence="CC0-1.0")
    (tmp_path / "out" / "o0000001" / "arrays.parquet").write_bytes(b"PAR1")
    with open_database(tmp_path / "db") as db:
        with pytest.raises(InputError, match="o0000001"):
            db.add_many(import_objects(tmp_path / "out"))
        # One batch: all of it or none.
        assert len(db) == 0
        assert db.check().problems == ()
