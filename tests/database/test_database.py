"""Stored objects are read back complete, and are found by a search."""

from __future__ import annotations

import contextlib
import random
import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sqlalchemy")
pytest.importorskip("pyarrow")

from benchmarks.objects_faults import make_object

from benchmarks import objects_faults
from visuohaptic.core import DatabaseError, Estimate, Evidence, InputError, Sighting, VisuoHapticObject, cards
from visuohaptic.database import (
    FeatureIndex,
    ObjectDatabase,
    add_evidence,
    connection,
    export_object,
    import_object,
    import_objects,
    index_of,
    open_database,
    schema,
    sync,
    synchronise,
)
from visuohaptic.database.search import _LEVELS, _best_step, _rounded

from .servers import certificate, postgres_url


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    yield from postgres_url(tmp_path_factory)


def _text(obj: VisuoHapticObject) -> str:
    card, arrays = cards.encode(obj)
    return cards.card_text(card) + cards.arrays_digest(arrays)


def _round_trip(db: ObjectDatabase) -> None:
    stored = db.add(make_object(6))
    assert _text(db.get(stored.id)) == _text(stored)
    refined = db.add(
        add_evidence(VisuoHapticObject(stored.id), Evidence("material.youngs_modulus_Pa", Estimate(3e9, 1e6)))
    )
    assert refined.material is not None
    assert refined.material.youngs_modulus_Pa is not None
    assert refined.material.youngs_modulus_Pa.value == pytest.approx(3e9, rel=1e-3)
    assert refined.stiffness is not None  # what was known stays
    assert [one.id for one in db.summaries(visual_class="class 6")] == [stored.id]
    assert db.check().problems == ()
    db.remove(stored.id)
    assert stored.id not in db
    with pytest.raises(InputError, match="no object"):
        db.get(stored.id)
    db.add(make_object(6))
    assert stored.id in db


def test_file_round_trip(tmp_path: Path) -> None:
    with open_database(tmp_path / "db") as db:
        _round_trip(db)


def test_server_round_trip(server: str) -> None:
    with open_database(server) as db:
        _round_trip(db)


def test_replaced_arrays_leave_no_files(tmp_path: Path) -> None:
    with open_database(tmp_path) as db:
        for number in range(3):
            db.add(replace(make_object(number), id="one"))
        assert len(list((tmp_path / "shards").iterdir())) == 1
    (tmp_path / "shards" / ".left.part.parquet").write_bytes(b"half")
    with open_database(tmp_path) as db:
        db.add(make_object(5))  # the first write tidies
        assert len(list((tmp_path / "shards").iterdir())) == 2


def test_damage_is_found(tmp_path: Path) -> None:
    with open_database(tmp_path) as db:
        db.add(make_object(1))
    (path,) = (tmp_path / "shards").iterdir()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with open_database(tmp_path) as db:
        assert any("another hash" in problem for problem in db.check().problems)
        with pytest.raises(DatabaseError):
            db.get("o0000001")


def test_old_schema_is_brought_up_to_date(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from sqlalchemy import create_engine

    engine = create_engine(f"sqlite:///{tmp_path / 'objects.sqlite'}")
    with engine.begin() as connection:
        schema.migrate(connection, "old", upto=1)
        assert schema.version_of(connection, "old") == 1
    engine.dispose()
    with open_database(tmp_path) as db:
        db.add(make_object(1))
        assert len(db) == 1
    monkeypatch.setattr(schema, "VERSION", 1)
    with pytest.raises(DatabaseError, match="update visuohaptic"):
        open_database(tmp_path)


def _both_ways(one: ObjectDatabase, two: ObjectDatabase, shared: ObjectDatabase) -> None:
    one.add(replace(make_object(1), seen=Sighting((1.0, 2.0, 0.0), 0.1, 5.0)))
    two.add(make_object(2))
    place = "tag.stiffness_N_per_m"
    one.add(add_evidence(VisuoHapticObject("cup"), Evidence(place, Estimate(10.0, 1.0))))
    two.add(add_evidence(VisuoHapticObject("cup"), Evidence(place, Estimate(12.0, 1.0))))
    before = len(shared)
    assert synchronise(one, shared).received == before  # nothing comes back of what was sent there
    # The other robot's object, and the cup with what the other has felt of it.
    assert synchronise(two, shared).received == before + 2
    assert synchronise(one, shared).received == 2
    assert synchronise(two, shared).received == 0
    texts = {_text(db.get("cup")) for db in (one, two, shared)}
    assert len(texts) == 1
    assert len(shared.get("cup").evidence) == 2
    assert two.get("o0000001").seen is None  # where it stands is the first robot's knowledge
    assert one.get("o0000001").seen is not None
    one.remove("o0000002", t_s=1e10)
    for robot in (one, two):
        synchronise(robot, shared)
    assert "o0000002" not in two
    changes = shared.changed(0)[1]
    synchronise(one, shared)
    assert not shared.changed(changes)[0]  # nothing new is nothing written


def test_what_was_received_is_not_offered_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        open_database(tmp_path / "a") as one,
        open_database(tmp_path / "b") as two,
        open_database(tmp_path / "s") as shared,
    ):
        one.add_many(make_object(number) for number in range(5))
        one.add(make_object(7))
        two.add(add_evidence(make_object(7), Evidence("material.youngs_modulus_Pa", Estimate(3e9, 1e6))))
        assert (found := synchronise(one, shared)) == type(found)(6, 0)
        # Of the object that both know, the second knows all; the first learns of it.
        assert synchronise(two, shared) == type(found)(1, 5)
        writes = shared.changed(0)[1]
        assert synchronise(two, shared) == type(found)(0, 0)
        assert synchronise(one, shared) == type(found)(0, 1)
        assert synchronise(one, shared) == type(found)(0, 0)
        assert shared.changed(0)[1] == writes
        # What somebody adds here while news arrive is not taken for one of them.
        two.add(make_object(8))
        synchronise(two, shared)
        write = one.write_merged

        def busy(items: Any) -> Any:
            one.add(make_object(9))
            return write(items)

        monkeypatch.setattr(one, "write_merged", busy)
        assert synchronise(one, shared).received == 1
        monkeypatch.undo()
        synchronise(one, shared)
        assert "o0000009" in shared


def test_two_robots_share_a_folder(tmp_path: Path) -> None:
    with (
        open_database(tmp_path / "a") as one,
        open_database(tmp_path / "b") as two,
        open_database(tmp_path / "s") as shared,
    ):
        _both_ways(one, two, shared)


def test_two_robots_share_a_server(tmp_path: Path, server: str) -> None:
    with (
        open_database(tmp_path / "a") as one,
        open_database(tmp_path / "b") as two,
        open_database(server) as shared,
    ):
        _both_ways(one, two, shared)


@pytest.mark.parametrize("batch", [2, 3, 512])
def test_all_are_exchanged_whatever_is_sent_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, batch: int
) -> None:
    monkeypatch.setattr(sync, "BATCH", batch)
    with open_database(tmp_path / "one") as one, open_database(tmp_path / "shared") as shared:
        for database, names in ((one, "abcde"), (shared, "defghij")):
            database.add_many([VisuoHapticObject(name) for name in names])
        found = synchronise(one, shared)
        # What both have is the same: nothing is learnt from it.
        assert (found.sent, found.received) == (5, 5)
        assert (
            [row.id for row in one.summaries()]
            == [row.id for row in shared.summaries()]
            == list("abcdefghij")
        )
        found = synchronise(one, shared)
        assert (found.sent, found.received) == (0, 0)


def test_more_objects_than_are_read_at_once(tmp_path: Path) -> None:
    with open_database(tmp_path) as db:
        ids = [f"o{number:04d}" for number in range(1003)]
        db.add_many((VisuoHapticObject(one) for one in ids), batch=1003)
        assert list(db.stored(ids)) == ids
        assert db.write_merged({one: (VisuoHapticObject(one), None) for one in ids}).known == set(ids)


def test_plain_files(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    obj = make_object(4)
    with pytest.raises(InputError, match="licence"):
        export_object(obj, tmp_path)
    folder = export_object(obj, tmp_path, licence="CC0-1.0")
    assert _text(import_object(folder)) == _text(replace(obj, licence="CC0-1.0"))
    assert [one.id for one in import_objects(tmp_path)] == [obj.id]
    data = folder / "arrays.parquet"
    data.write_bytes(data.read_bytes()[:-1] + b"x")
    with pytest.raises(InputError, match="does not match its checksum"):
        import_object(folder)


@pytest.mark.parametrize(
    ("scale", "known_fraction"), [(1.0, 1.0), (1.0, 0.2), (1e5, 0.6), (1e-3, 1.0), (1e-3, 0.4)]
)
def test_search_is_exact(scale: float, known_fraction: float) -> None:
    """As a scan of all, over more than one block of rows and sums of 16 features."""
    rng = np.random.default_rng(0)
    vectors = scale * rng.standard_t(2, size=(9000, 40))  # heavy tails: many are clipped
    vectors[7] = vectors[8]
    ids = [str(i) for i in range(len(vectors))]
    index = FeatureIndex(ids, vectors)
    for _ in range(20):
        query = scale * rng.standard_t(2, size=40)
        query[rng.random(40) > known_fraction] = np.nan
        query[0] = 0.0
        found = index.nearest(query, 7)
        scan = np.sqrt(np.nansum((vectors - query) ** 2, axis=1))
        assert [m.id for m in found] == [ids[i] for i in np.argsort(scan, kind="stable")[:7]]
        np.testing.assert_allclose([m.distance for m in found], np.sort(scan)[:7], rtol=1e-12)
    assert [m.id for m in index.nearest(vectors[7], 2)] == ["7", "8"]
    assert len(index.nearest(vectors[7], 9999)) == 9000


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_search_is_exact_beyond_the_border_of_a_level(scale: float) -> None:
    """Of few features many vectors round to one level, and the nearest is often in the next one."""
    rng = np.random.default_rng(1)
    for n in (1, 2):
        vectors = scale * rng.random((400, n))
        index = FeatureIndex([str(i) for i in range(400)], vectors)
        for query in scale * rng.random((200, n)):
            (found,) = index.nearest(query)
            assert found.distance == pytest.approx(np.linalg.norm(vectors - query, axis=1).min(), rel=1e-12)


def test_values_of_equal_frequency_are_rounded_without_a_border() -> None:
    """Of all steps, that between equal levels over the whole range has the least error; half a step in each dimension."""
    offset = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 4))
    offset[0] = 1.0
    step = _best_step(offset)
    assert step == pytest.approx(2.0 / (_LEVELS - 1))
    assert (_rounded(offset, step)[1] <= 0.5 * step * np.sqrt(4)).all()


def test_search_in_a_database(tmp_path: Path) -> None:
    with open_database(tmp_path) as db:
        db.add_many(make_object(number) for number in range(20))
        (found,) = index_of(db, "stiffness").nearest(make_object(3).features["stiffness"].values)
        assert (found.id, found.distance) == ("o0000003", 0.0)


@pytest.mark.parametrize(("count", "batches"), [(0, []), (4, [2, 2]), (5, [2, 2, 1])])
def test_many_are_counted_and_acknowledged_by_batches(tmp_path: Path, count: int, batches: list[int]) -> None:
    acknowledged: list[list[str]] = []
    with open_database(tmp_path) as db:
        objects = (make_object(number) for number in range(count))
        assert db.add_many(objects, batch=2, stored=acknowledged.append) == count
        assert [len(ids) for ids in acknowledged] == batches
        assert len(db) == count


def test_killed_writers(tmp_path: Path) -> None:
    found = objects_faults.kills(tmp_path / "db", 4, random.Random(1))
    assert found["acknowledged"] > 0
    assert (found["lost"], found["problems"], found["half-written"]) == (0, 0, 0)


def test_sixteen_writers(tmp_path: Path) -> None:
    found = objects_faults.writers(tmp_path / "db", objects=4)
    with open_database(tmp_path / "db") as db:
        assert len(db) == 16 * 4 + 1
    assert (found["lost"], found["problems"]) == (0, 0)


def test_no_writer_is_refused_while_others_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another writer holds the lock at each attempt, ten times as long as one that stands still is awaited."""
    with (
        open_database(tmp_path) as db,
        contextlib.closing(sqlite3.connect(tmp_path / "objects.sqlite")) as other,
    ):
        other.isolation_level = None
        other.execute("BEGIN IMMEDIATE")
        now_s = 0.0

        def sleep(_: float) -> None:
            nonlocal now_s
            now_s += 0.9 * connection._WAIT_S
            other.execute("UPDATE counter SET value = value + 1")
            other.execute("COMMIT")
            if now_s < 10.0 * connection._WAIT_S:
                other.execute("BEGIN IMMEDIATE")

        monkeypatch.setattr(connection, "time", SimpleNamespace(monotonic=lambda: now_s, sleep=sleep))
        assert db.add(make_object(1)).id in db
        assert now_s >= 10.0 * connection._WAIT_S


def test_a_writer_that_holds_the_lock_and_does_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "_WAIT_S", 0.2)
    pauses: list[float] = []
    monkeypatch.setattr(connection.time, "sleep", pauses.append)
    with (
        open_database(tmp_path) as db,
        open_database(tmp_path) as other,
        other.connections.writing(),
        pytest.raises(DatabaseError, match="database is locked; what was being written is not stored"),
    ):
        db.add(make_object(1))
    assert len(pauses) > 1  # it asked again until the wait had ended
    with open_database(tmp_path) as db:
        assert db.add(make_object(1)).id in db


def test_writers_that_are_killed_at_once(tmp_path: Path) -> None:
    found = objects_faults.writers(tmp_path / "db", 5, kill_rng=random.Random(2))
    assert found["killed"] > 0
    assert found["acknowledged"] > 0
    assert (found["lost"], found["problems"]) == (0, 0)


def test_full_disk() -> None:
    found = objects_faults.full_disk(2, random.Random(1))
    if found is None:
        pytest.skip("no right to mount a small disk")
    assert found["acknowledged"] > 0
    assert (found["lost"], found["problems"]) == (0, 0)


def test_roles_of_a_server(server: str) -> None:
    """As ``docs/objects.md`` grants them: a robot writes and changes no schema, a viewer reads."""
    import psycopg

    page = (Path(__file__).parents[2] / "docs" / "objects.md").read_text()
    grants = page.partition("```sql\n")[2].partition("```")[0]
    with open_database(server) as owner:
        owner.add(make_object(1))
        with psycopg.connect(server) as connection:
            connection.execute(grants)
        with open_database(server.replace("//robot@", "//robot7@")) as robot:
            robot.add(make_object(2))
            robot.remove("o0000002")
        with open_database(server.replace("//robot@", "//desk@")) as viewer:
            assert viewer.get("o0000001").id == "o0000001"
            assert len(index_of(viewer, "stiffness")) >= 1
            with pytest.raises(DatabaseError, match="permission denied"):
                viewer.add(make_object(3))
        assert "o0000003" not in owner


def test_tls_is_verified(server: str, tmp_path: Path) -> None:
    folder = Path(server.partition("host=")[2])
    if not (folder / "server.pem").is_file():
        pytest.skip("openssl is not installed: the server has no certificate")
    port = (folder / "data" / "postmaster.pid").read_text().splitlines()[3]
    address = f"postgresql://robot@localhost:{port}/postgres?sslmode=verify-full&sslrootcert="
    with open_database(f"{address}{folder / 'server.pem'}") as db:
        db.add(make_object(1))
        assert "o0000001" in db
    certificate(tmp_path / "other.pem", tmp_path / "other.key")
    with pytest.raises(DatabaseError, match="certificate verify failed"):
        open_database(f"{address}{tmp_path / 'other.pem'}")


@pytest.mark.parametrize("tidied", [False, True])
def test_others_write_between_preparation_and_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tidied: bool
) -> None:
    """Objects are merged with what is stored when the lock is held, and shards that another process removed are there again."""
    place = "tag.stiffness_N_per_m"
    with open_database(tmp_path) as db, open_database(tmp_path) as other:
        db.add(make_object(1))
        write_early, seen = db._arrays.write_early, []

        def meanwhile(blobs: list) -> dict | None:
            early = write_early(blobs)
            if not seen:
                seen.append(early["name"])
                other._arrays._tidy_due = tidied
                other.add(add_evidence(VisuoHapticObject("cup"), Evidence(place, Estimate(10.0, 1.0))))
            return early

        monkeypatch.setattr(db._arrays, "write_early", meanwhile)
        cup = add_evidence(VisuoHapticObject("cup"), Evidence(place, Estimate(12.0, 1.0)))
        db.add_many([cup, *(make_object(number) for number in range(2, 50))])
        assert (tmp_path / "shards" / f"{seen[0]}.parquet").is_file() is not tidied
        assert db.get("cup").tag.stiffness_N_per_m.value == pytest.approx(11.0)
        assert (len(db), db.check().problems) == (50, ())
        for number in range(1, 50):
            assert _text(db.get(f"o{number:07d}")) == _text(make_object(number))


def test_an_early_shard_that_is_not_needed_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process stores the same object first."""
    with open_database(tmp_path) as db, open_database(tmp_path) as other:
        other.add(make_object(1))
        write_early = db._arrays.write_early

        def meanwhile(blobs: list) -> dict | None:
            name = write_early(blobs)
            monkeypatch.setattr(db._arrays, "write_early", write_early)
            other.add(make_object(2))
            return name

        monkeypatch.setattr(db._arrays, "write_early", meanwhile)
        db.add(make_object(2))
        assert len(list((tmp_path / "shards").iterdir())) == 2
        assert db.check() == type(db.check())(2, 2, ())


def test_an_early_shard_of_a_transaction_that_fails_is_removed_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_database(tmp_path) as db:
        db.add(make_object(1))
        with monkeypatch.context() as patch:
            patch.setattr("visuohaptic.database.database.store_rows", lambda *_: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                db.add(make_object(2))
        assert len(list((tmp_path / "shards").iterdir())) == 2
        db.add(make_object(3))
        assert len(list((tmp_path / "shards").iterdir())) == 2
        assert db.check() == type(db.check())(2, 2, ())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "CREATE VIEW more AS WITH RECURSIVE c(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM c) SELECT k FROM c",
            "the view 'more'",
        ),
        ("CREATE TRIGGER late AFTER INSERT ON object BEGIN DELETE FROM object; END", "the trigger 'late'"),
        ("UPDATE meta SET value = '-2' WHERE key = 'schema'", "schema version '-2'"),
        ("UPDATE meta SET value = 'new' WHERE key = 'schema'", "schema version 'new'"),
        (f"UPDATE meta SET value = '{'9' * 5000}' WHERE key = 'schema'", "schema version '99"),
        ("UPDATE meta SET value = '99' WHERE key = 'schema'", "schema version 99, expected at most"),
    ],
)
def test_a_file_that_computes_by_itself_or_has_no_version_is_refused(
    tmp_path: Path, change: str, said: str
) -> None:
    with open_database(tmp_path / "db") as db:
        db.add(make_object(6))
    with contextlib.closing(sqlite3.connect(tmp_path / "db" / "objects.sqlite")) as file:
        file.execute(change)
        file.commit()
    with pytest.raises(DatabaseError) as caught:
        open_database(tmp_path / "db")
    assert said in str(caught.value)
    assert len(str(caught.value)) < 300
