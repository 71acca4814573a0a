"""A slice of the campaign of corrupted sequences."""

from __future__ import annotations

from benchmarks.sequence_faults import campaign


def test_corrupted_sequences_are_refused_or_their_frames_counted():
    found = campaign(25, seed=7)
    wrong = [entry for entry in found if entry["outcome"] not in ("refused", "counted")]
    assert not wrong, wrong
