"""XXH3 against libxxhash: stored values, and any bytes where the library is on this machine."""

from __future__ import annotations

import ctypes
import ctypes.util

import pytest
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.ros.wire._gid import publisher_gid, xxh3_128

#: XXH3_128bits of libxxhash 0.8.1 over the bytes 0, 1, ..., 250, 0, 1, ...; one length of each way of computing.
STORED = [
    (17, 0x685BC458B37D057FC06E233DF7729217),
    (64, 0x9C6E140A465545E590C1971DDB04CE74),
    (65, 0xEBEDF05EEADC28F11AEE64A1615DE88F),
    (128, 0x14792FC3AF88DC6C05321A0B64D67B41),
    (129, 0xDD5E74AC6B45F54EBC30B63382B09A3B),
    (240, 0x65B5BE86DA5540E7C92B68E16F83BBB6),
    (241, 0x1DA1CB61BCB8A2A102E8CD95421C6D02),
    (1024, 0xD0AC1F7B93BF57B9E5D78BAFA45B2AA5),
    (1025, 0x2882EBCA04EC915CE95C42288F28186E),
    (3000, 0xD324B9E72FA9FB271B846747012C24AA),
]
LIBRARY = ctypes.util.find_library("xxhash")


@pytest.mark.parametrize(("size", "expected"), STORED)
def test_stored_values(size: int, expected: int) -> None:
    assert xxh3_128(bytes(place % 251 for place in range(size))) == expected


class _Hash(ctypes.Structure):
    _fields_ = (("low", ctypes.c_uint64), ("high", ctypes.c_uint64))


@pytest.mark.skipif(LIBRARY is None, reason="libxxhash is not on this machine")
@given(st.binary(min_size=17, max_size=1500))
def test_any_bytes(data: bytes) -> None:
    library = ctypes.CDLL(LIBRARY)
    library.XXH3_128bits.restype = _Hash
    library.XXH3_128bits.argtypes = [ctypes.c_char_p, ctypes.c_size_t]
    theirs = library.XXH3_128bits(data, len(data))
    assert xxh3_128(data) == theirs.low | theirs.high << 64


def test_an_id_is_the_low_half_first() -> None:
    """As rmw_zenoh copies the two halves into its 16 bytes."""
    token = (
        "@ros2_lv/0/ab/0/1/MP/%/%/node/%topic/std_msgs::msg::dds_::String_/TypeHashNotSupported/::,7:,:,:,,"
    )
    gid = publisher_gid(token)
    assert int.from_bytes(gid[:8], "little") == xxh3_128(token.encode()) & (2**64 - 1)
    assert len(gid) == 16


def test_too_few_bytes() -> None:
    with pytest.raises(ValueError, match="17 or more"):
        xxh3_128(b"short")
