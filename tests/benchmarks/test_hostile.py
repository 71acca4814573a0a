"""Slices of the campaigns of hostile arrays and files, and that their rows can fail."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from benchmarks._journal import Journal

from benchmarks import hostile_arrays, hostile_files

#: Functions that once raised, hung or ended the process.
FOUND = (
    "visuohaptic.core.area_vectors",
    "visuohaptic.core.so3_log",
    "visuohaptic.io.write_depth",
    "visuohaptic.navigation.mapping.door_probability",
    "visuohaptic.navigation.pushing.load_of_feet",
    "visuohaptic.navigation.pushing.push_contacts",
    "visuohaptic.recognition.touch.unknown_kinds",
    "visuohaptic.report.floor_map",
    "visuohaptic.sensing.push.fit_circle_algebraic",
    "visuohaptic.tracking.estimate_homography",
)


def test_hostile_arrays_raise_nothing_foreign():
    journal = Journal(None, {})
    hostile_arrays.campaign(list(FOUND), 2, journal)
    found = hostile_arrays.summary(journal)
    assert found["not tried"] == []
    assert found["tried"] > 200
    faults = [
        (name, *row)
        for name, rows in journal.rows.items()
        for row in rows
        if row[1] in ("foreign", "wrong", "crashed or hung")
    ]
    assert faults == []


def test_the_campaign_of_arrays_sees_what_it_is_for():
    """A function without a check, one that reads the memory as it lies, and one that the check mends."""
    from jaxtyping import Float

    def careless(values: Float[np.ndarray, "n 2"]) -> float:
        return float(values[1, 1]) * values.strides[0]

    outcomes = {case: outcome for case, outcome, _ in hostile_arrays.cases("careless", careless, 0)}
    # Annotations of this file are texts with the shape in them, as in the library.
    assert outcomes["values: flat"] == "foreign"
    assert outcomes["values: strided"] == "wrong"
    assert outcomes["values: NaN"] == "result"


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are set by Linux")
def test_mutated_files_are_accepted_or_refused_in_one_line():
    journal = Journal(None, {})
    hostile_files.campaign(len(hostile_files.READERS), 4, journal)
    faults = [row for row in journal.rows.values() if row[1] not in ("accepted", "refused")]
    assert faults == []
    assert len(journal.rows) == len(hostile_files.READERS)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are set by Linux")
def test_valid_files_are_accepted_and_kept_ones_refused(tmp_path: Path):
    """What mutations start from is read; each file of the corpus was a fault once."""
    files = hostile_files.valid_files(tmp_path)
    names = {name.replace(" ", "_"): name for _, name, _ in files}
    for path in sorted(hostile_files.CORPUS.glob("*-*")):
        files.append((path.name, names[path.name.partition("-")[0]], path))
    rows = hostile_files.examine(files)
    valid = {key: row[1:3] for key, row in rows.items() if key.startswith("valid ") and row[1] != "accepted"}
    assert set(valid) <= {"valid tree"}, valid
    kept = {key: row for key, row in rows.items() if not key.startswith("valid ")}
    assert {key: row[1] for key, row in kept.items() if row[1] not in ("accepted", "refused")} == {}


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are set by Linux")
def test_the_campaign_of_files_sees_what_it_is_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A process that dies, and a reader that raises what it should not."""
    worker = hostile_files._WORKER.replace(
        "readers = {",
        "READERS += (('dies', '', None, 'io:os.abort()'), ('raises', '', None, 'io:1 / 0'))\nreaders = {",
    ).replace("{**scope, ", "{**scope, 'os': os, ")
    monkeypatch.setattr(hostile_files, "_WORKER", worker)
    path = tmp_path / "a"
    path.write_bytes(b"")
    found = hostile_files.examine([("1", "dies", path), ("2", "raises", path)])
    assert found["1"][1] == "crashed"
    assert "the process ended" in found["1"][2]
    assert found["2"][1:3] == ["crashed", "ZeroDivisionError: division by zero"]
