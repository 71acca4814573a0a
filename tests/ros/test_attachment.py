"""The attachment compared with zenoh's own serializer, which rmw_zenoh uses."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.ros.wire import Attachment

ext = pytest.importorskip("zenoh.ext")
WHOLE = st.integers(-(2**63), 2**63 - 1)


@given(WHOLE, WHOLE, st.binary(min_size=16, max_size=16))
def test_bytes_are_those_of_zenoh(sequence: int, source_ns: int, gid: bytes) -> None:
    theirs = ext.z_serialize((ext.Int64(sequence), ext.Int64(source_ns), gid)).to_bytes()
    ours = Attachment(sequence, source_ns, gid)
    assert ours.pack() == theirs
    assert len(theirs) == 33
    assert Attachment.unpack(theirs) == ours


@given(WHOLE, WHOLE, st.binary(min_size=16, max_size=16))
def test_the_layout_of_the_first_releases_is_read(sequence: int, source_ns: int, gid: bytes) -> None:
    named = (
        "sequence_number", ext.Int64(sequence), "source_timestamp", ext.Int64(source_ns), "source_gid", gid
    )  # fmt: skip
    raw = ext.z_serialize(named).to_bytes()
    assert Attachment.unpack(raw) == Attachment(sequence, source_ns, gid)


@given(st.binary(max_size=90))
def test_other_bytes_are_refused(data: bytes) -> None:
    if len(data) == 33 and data[16] == 16:
        assert Attachment.unpack(data).pack() == data
    else:
        with pytest.raises(InputError, match="attachment"):
            Attachment.unpack(data)
