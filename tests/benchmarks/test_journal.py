"""An interrupted campaign is continued."""

from __future__ import annotations

import pytest
from benchmarks._journal import Journal


def test_rows_survive_and_a_torn_line_is_dropped(tmp_path):
    path, about = tmp_path / "rows.jsonl", {"campaign": "a"}
    Journal(path, about).put("0", [1.5])
    with path.open("a") as stream:
        stream.write('{"key": "1", "ro')
    again = Journal(path, about)
    assert "0" in again
    assert "1" not in again
    again.put("1", 2)
    assert Journal(path, about).rows == {"0": [1.5], "1": 2}
    with pytest.raises(SystemExit, match="another campaign"):
        Journal(path, {"campaign": "b"})
