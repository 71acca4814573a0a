"""A slice of the campaign ``python -m benchmarks.map_fuzz``, and that its rows can fail."""

from __future__ import annotations

from benchmarks import map_fuzz


def test_malformed_maps_are_refused_in_bounded_memory() -> None:
    rows = {row["name"]: row["ours"] for row in map_fuzz.run(64, seed=3)}
    assert rows["malformed maps accepted silently"] == 0
    assert rows["malformed maps that crash the reader"] == 0
    assert rows["malformed maps without a clear line"] == 0
    # A 10^5 x 10^5 header would take 10 GB, a bomb 200 MB.
    assert rows["memory that malformed maps take"] < 100


def test_every_kind_of_mutation_is_in_the_slice() -> None:
    found = map_fuzz.campaign(len(map_fuzz.MUTATIONS), seed=4)
    assert {file["kind"] for file in found["files"]} == {f.__name__ for f in map_fuzz.MUTATIONS}
