"""The id of a publisher as in rmw_zenoh: 128-bit XXH3 of its token.

XXH3 is a published algorithm (xxHash, ``doc/xxhash_spec.md``). This implementation is for 17 bytes and more; tokens are
longer. It is pure Python and slow, but used only once per topic.
"""

from __future__ import annotations

import struct

_M32, _M64 = 0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF
_P32 = (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D)
_P64 = (0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x85EBCA77C2B2AE63, 0x27D4EB2F165667C5)
_MX1 = 0x165667919E3779F9
#: The algorithm's 192-byte secret.
_SECRET = bytes.fromhex(
    "b8fe6c3923a44bbe7c01812cf721ad1cded46de9839097db7240a4a4b7b3671f"
    "cb79e64eccc0e578825ad07dccff7221b8084674f743248ee03590e6813a264c"
    "3c2852bb91c300cb88d0658b1b532ea371644897a20df94e3819ef46a9deacd8"
    "a8fa763fe39c343ff9dcbbc7c70b4f1d8a51e04bcdb45931c89f7ec9d9787364"
    "eac5ac8334d3ebc3c581a0fffa1363eb170ddd51b7f0da49d316552629d4689e"
    "2b16be587d47a1fc8ff8b8d17ad031ce45cb3a8f95160428afd7fbcabb4b407e"
)


def publisher_gid(token: str) -> bytes:
    """16-byte unique id of a publisher: the low half of the hash, then the high one.

    Parameters
    ----------
    token
        Liveliness token of the publisher.
    """
    return xxh3_128(token.encode()).to_bytes(16, "little")


def xxh3_128(data: bytes) -> int:
    """128-bit XXH3 without seed, of 17 bytes or more.

    Parameters
    ----------
    data
        Bytes to hash.
    """
    size = len(data)
    if size < 17:
        raise ValueError(f"found {size} bytes, expected 17 or more")
    if size <= 240:
        return _short(data) if size <= 128 else _middle(data)
    return _long(data)


def _u64(data: bytes, place: int) -> int:
    return int.from_bytes(data[place : place + 8], "little")


def _fold(left: int, right: int) -> int:
    product = left * right
    return (product & _M64) ^ (product >> 64)


def _avalanche(value: int) -> int:
    value ^= value >> 37
    value = value * _MX1 & _M64
    return value ^ (value >> 32)


def _mix16(data: bytes, place: int, secret: int) -> int:
    return _fold(_u64(data, place) ^ _u64(_SECRET, secret), _u64(data, place + 8) ^ _u64(_SECRET, secret + 8))


def _mix32(low: int, high: int, data: bytes, first: int, second: int, secret: int) -> tuple[int, int]:
    low = (low + _mix16(data, first, secret)) & _M64
    low ^= (_u64(data, second) + _u64(data, second + 8)) & _M64
    high = (high + _mix16(data, second, secret + 16)) & _M64
    high ^= (_u64(data, first) + _u64(data, first + 8)) & _M64
    return low, high


def _joined(low: int, high: int, size: int) -> int:
    first = (low + high) & _M64
    second = (low * _P64[0] + high * _P64[3] + size * _P64[1]) & _M64
    return _avalanche(first) | (-_avalanche(second) & _M64) << 64


def _short(data: bytes) -> int:
    size = len(data)
    low, high = size * _P64[0] & _M64, 0
    for place in range((size - 1) // 32, -1, -1):
        low, high = _mix32(low, high, data, 16 * place, size - 16 * (place + 1), 32 * place)
    return _joined(low, high, size)


def _middle(data: bytes) -> int:
    size = len(data)
    low, high = size * _P64[0] & _M64, 0
    for place in range(4):
        low, high = _mix32(low, high, data, 32 * place, 32 * place + 16, 32 * place)
    low, high = _avalanche(low), _avalanche(high)
    for place in range(4, size // 32):
        low, high = _mix32(low, high, data, 32 * place, 32 * place + 16, 3 + 32 * (place - 4))
    low, high = _mix32(low, high, data, size - 16, size - 32, 136 - 17 - 16)
    return _joined(low, high, size)


def _long(data: bytes) -> int:
    size = len(data)
    lanes = [_P32[2], _P64[0], _P64[1], _P64[2], _P64[3], _P32[1], _P64[4], _P32[0]]
    stripes = (len(_SECRET) - 64) // 8
    block = 64 * stripes
    blocks = (size - 1) // block
    for number in range(blocks):
        for stripe in range(stripes):
            _accumulate(lanes, data, number * block + 64 * stripe, 8 * stripe)
        for lane in range(8):
            value = lanes[lane] ^ (lanes[lane] >> 47) ^ _u64(_SECRET, len(_SECRET) - 64 + 8 * lane)
            lanes[lane] = value * _P32[0] & _M64
    for stripe in range((size - 1 - block * blocks) // 64):
        _accumulate(lanes, data, blocks * block + 64 * stripe, 8 * stripe)
    _accumulate(lanes, data, size - 64, len(_SECRET) - 64 - 7)
    low = _merged(lanes, 11, size * _P64[0] & _M64)
    high = _merged(lanes, len(_SECRET) - 64 - 11, ~(size * _P64[1]) & _M64)
    return low | high << 64


def _accumulate(lanes: list[int], data: bytes, place: int, secret: int) -> None:
    values = struct.unpack_from("<8Q", data, place)
    keys = struct.unpack_from("<8Q", _SECRET, secret)
    for lane, (value, key) in enumerate(zip(values, keys, strict=True)):
        mixed = value ^ key
        lanes[lane ^ 1] = (lanes[lane ^ 1] + value) & _M64
        lanes[lane] = (lanes[lane] + (mixed & _M32) * (mixed >> 32)) & _M64


def _merged(lanes: list[int], secret: int, start: int) -> int:
    for lane in range(0, 8, 2):
        keys = _u64(_SECRET, secret + 8 * lane), _u64(_SECRET, secret + 8 * lane + 8)
        start = (start + _fold(lanes[lane] ^ keys[0], lanes[lane + 1] ^ keys[1])) & _M64
    return _avalanche(start)
