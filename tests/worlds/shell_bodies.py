"""Containers of revolution: classes with ranges, other kinds, and the wall of each.

A description has the entries that the library reads from YAML (base, sections with their bulge, rings, rim, top,
wall), in metres and pascals; a pair of numbers is a range. Its conversion into a wall is implemented independently here.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from .shells import Revolution

__all__ = [
    "CLASSES",
    "FRUSTUM_M",
    "MATERIALS",
    "OTHERS",
    "Description",
    "draw",
    "knots_m",
    "levels_m",
    "radius_at",
    "wall_of",
]

Description = dict[str, Any]

#: Young's modulus [Pa] and Poisson's ratio, from data sheets.
MATERIALS = {
    "LDPE": (0.28e9, 0.45),
    "HDPE": (0.8e9, 0.42),
    "PP": (1.75e9, 0.40),
    "PET": (2.35e9, 0.38),
    "PS": (3.25e9, 0.34),
    "aluminium": (69e9, 0.33),
    "glass": (67.5e9, 0.22),
}
#: Wall of a stiff cap, and the mouth of a cap's middle [m]: the axis itself has no ring.
STIFF_CAP_M, PIN_M = 0.005, 0.0005
#: Longest frustum of a wall [m], and in a ring.
FRUSTUM_M, RING_FRUSTUM_M = 0.0016, 0.0008


def _mm(*values: float) -> list[float]:
    return [value / 1000 for value in values]


def _described(
    material: str, wall: list[float], base: list[float], sections: list[dict], **more: Any
) -> Description:
    return {
        "base": {"shape": "circle", "radius": base},
        "sections": sections,
        "wall": wall,
        "material": material,
        "youngs_modulus": MATERIALS[material][0],
        **more,
    }


def _section(height: list[float], radius: list[float] | None = None, **more: Any) -> dict[str, Any]:
    return {"height": height, **({} if radius is None else {"radius": radius}), **more}


_STIFF = {"top": {"kind": "stiff"}}
_CLOSED = {"top": {"kind": "closed"}}

#: Classes on which a recogniser is trained and tested.
CLASSES: dict[str, Description] = {
    "pot": _described(
        "PP", _mm(0.3, 0.55), _mm(25, 31), [_section(_mm(65, 95), _mm(33, 40), bulge=_mm(-1, 1))],
        rim={"height": _mm(2, 3), "wall": _mm(1.5, 2.5)},
    ),
    "beaker": _described("PS", _mm(0.25, 0.45), _mm(25, 31), [_section(_mm(75, 110), _mm(32, 39), bulge=_mm(-1, 1))]),
    "shampoo": _described(
        "HDPE", _mm(0.7, 1.1), _mm(26, 33),
        [
            _section(_mm(95, 130), bulge=_mm(0, 2)),
            _section(_mm(22, 32), _mm(13, 16), bulge=_mm(2, 4)),
            _section(_mm(10, 15), wall=_mm(1.5, 1.5)),
        ],
        **_STIFF,
    ),
    "milk": _described(
        "HDPE", _mm(0.5, 0.8), _mm(34, 43),
        [
            _section(_mm(85, 115), bulge=_mm(0, 2)),
            _section(_mm(40, 55), _mm(16, 20), bulge=_mm(3, 6)),
            _section(_mm(12, 18), wall=_mm(1.2, 1.2)),
        ],
        **_STIFF,
    ),
    "water": _described(
        "PET", _mm(0.25, 0.45), _mm(29, 36),
        [
            _section(_mm(60, 80), bulge=_mm(0, 2)),
            _section(_mm(40, 55), bulge=_mm(-5, -2)),
            _section(_mm(45, 60), _mm(12, 14), bulge=_mm(4, 7)),
            _section(_mm(14, 22), wall=_mm(1.2, 1.2)),
        ],
        rings=[{"z": _mm(25, 35), "depth": _mm(-1.5, -0.8), "width": _mm(9, 9)}],
        **_STIFF,
    ),
    "tub": _described("PP", _mm(0.6, 1.0), _mm(32, 40), [_section(_mm(60, 85), _mm(34, 42), bulge=_mm(0, 1.5))], **_CLOSED),
}  # fmt: skip

#: Containers of unknown classes.
OTHERS: dict[str, Description] = {
    "can": _described("aluminium", _mm(0.1, 0.14), _mm(30, 35), [_section(_mm(105, 130))], top={"kind": "closed", "wall": _mm(0.3, 0.3)}),
    "jar": _described("glass", _mm(2, 3), _mm(32, 42), [_section(_mm(70, 90)), _section(_mm(15, 15), _mm(28, 28))]),
    "mug": _described("glass", _mm(3, 4), _mm(36, 42), [_section(_mm(85, 100), bulge=_mm(0, 2))]),
    "tube": _described("LDPE", _mm(0.5, 0.8), _mm(18, 22), [_section(_mm(130, 160))], **_STIFF),
    "funnel": _described("PP", _mm(0.8, 1.2), _mm(45, 52), [_section(_mm(110, 130), _mm(20, 26))]),
    "goblet": _described(
        "PS", _mm(0.8, 1.1), _mm(32, 38), [_section(_mm(50, 60), _mm(14, 14)), _section(_mm(60, 70), _mm(35, 40))]
    ),
    "bowl": _described("PP", _mm(1.0, 1.5), _mm(30, 36), [_section(_mm(50, 60), _mm(65, 75), bulge=_mm(6, 9))]),
    "globe": _described("PET", _mm(0.5, 0.8), _mm(20, 24), [_section(_mm(80, 95), bulge=_mm(22, 28))], **_STIFF),
    "vase": _described(
        "glass", _mm(1.8, 2.4), _mm(25, 30), [_section(_mm(90, 110), bulge=_mm(10, 14)), _section(_mm(40, 50), _mm(30, 36))]
    ),
    "foil cup": _described("aluminium", _mm(0.06, 0.09), _mm(25, 30), [_section(_mm(40, 50), _mm(36, 42))]),
    "canister": _described(
        "HDPE", _mm(1.8, 2.5), _mm(50, 60), [_section(_mm(150, 180)), _section(_mm(35, 40), _mm(20, 22))], **_STIFF
    ),
    "bell": _described("PP", _mm(0.5, 0.7), _mm(45, 52), [_section(_mm(60, 80), _mm(18, 22), bulge=_mm(8, 11))], **_CLOSED),
    "bellows": _described(
        "LDPE", _mm(0.7, 0.9), _mm(28, 32), [_section(_mm(115, 125))],
        rings=[{"z": [z / 1000] * 2, "depth": _mm(-3.5, -2.5), "width": _mm(16, 16)} for z in (20, 40, 60, 80, 100)], **_STIFF,
    ),
}  # fmt: skip


def draw(description: Description, rng: np.random.Generator, *, outside: float = 0.0) -> Description:
    """One member, each range at a uniform place.

    With ``outside``, every second range on average is left by up to this fraction of its width, on either side.
    """

    def chosen(part: Any) -> Any:
        if isinstance(part, dict):
            return {name: chosen(value) for name, value in part.items()}
        if not isinstance(part, list):
            return part
        if part and isinstance(part[0], dict):
            return [chosen(entry) for entry in part]
        low, high = part
        place = rng.uniform()
        if outside and rng.uniform() < 0.5:
            place = 1 + outside * place if rng.uniform() < 0.5 else -outside * place
        value = low + place * (high - low)
        return [value, value]

    out: Description = chosen(description)
    return out


def knots_m(member: Description) -> tuple[np.ndarray, np.ndarray]:
    """Heights and radii at the ends of the sections of a member."""
    heights, radii = [0.0], [member["base"]["radius"][0]]
    for section in member["sections"]:
        heights.append(heights[-1] + section["height"][0])
        radii.append(section.get("radius", [radii[-1]])[0])
    return np.array(heights), np.array(radii)


def radius_at(member: Description, z_m: np.ndarray) -> np.ndarray:
    """Radius of the middle of the wall at some heights."""
    heights, radii = knots_m(member)
    z = np.asarray(z_m, dtype=float)
    which = np.clip(np.searchsorted(heights, z, side="left") - 1, 0, len(radii) - 2)
    part = (z - heights[which]) / (heights[which + 1] - heights[which])
    bulge = np.array([section.get("bulge", [0.0])[0] for section in member["sections"]])[which]
    radius: np.ndarray = np.interp(z, heights, radii) + 4 * bulge * part * (1 - part)
    for ring in member.get("rings", ()):
        away = (z - ring["z"][0]) / ring["width"][0]
        radius += np.where(np.abs(away) < 0.5, ring["depth"][0] * np.cos(np.pi * away) ** 2, 0.0)
    return radius


def levels_m(member: Description, step_m: float, ring_step_m: float) -> np.ndarray:
    """Heights from foot to mouth, at most so far apart; ends of sections, rings and rim are among them."""
    heights, _radii = knots_m(member)
    rings = [(ring["z"][0], ring["width"][0] / 2) for ring in member.get("rings", ())]
    cuts = {*map(float, heights)} | {z + sign * half for z, half in rings for sign in (-1, 1)}
    if "rim" in member:
        cuts.add(float(heights[-1]) - member["rim"]["height"][0])
    out = [0.0]
    for low, high in itertools.pairwise(sorted(cuts)):
        in_ring = any(abs(0.5 * (low + high) - z) < half for z, half in rings)
        count = max(4, int(np.ceil((high - low) / (ring_step_m if in_ring else step_m))))
        out += list(np.linspace(low, high, count + 1)[1:])
    return np.array(out)


def wall_of(
    member: Description,
    *,
    modulus: float = 1.0,
    step_m: float = FRUSTUM_M,
    ring_step_m: float = RING_FRUSTUM_M,
) -> Revolution:
    """The wall of a member, its modulus by a factor.

    Frusta of the default lengths leave 0.5 % in tight rings, for readings; an error goes with their square.
    """
    z = levels_m(member, step_m, ring_step_m)
    heights, _radii = knots_m(member)
    height, radius = heights[-1], radius_at(member, z)
    middle = 0.5 * (z[1:] + z[:-1])
    own = [section.get("wall", member["wall"])[0] for section in member["sections"]]
    thick = np.array(own)[np.clip(np.searchsorted(heights, middle) - 1, 0, len(own) - 1)]
    if "rim" in member:
        thick[middle > height - member["rim"]["height"][0]] = member["rim"]["wall"][0]
    points = np.column_stack([radius, z])
    top = member.get("top", {"kind": "open"})
    if top["kind"] != "open":
        default = STIFF_CAP_M if top["kind"] == "stiff" else member["wall"][0]
        inner = np.linspace(radius[-1], PIN_M, 13)[1:]
        points = np.concatenate([points, np.column_stack([inner, np.full_like(inner, height)])])
        thick = np.concatenate([thick, np.full(len(inner), top.get("wall", [default])[0])])
    return Revolution(points, thick, modulus * member["youngs_modulus"], MATERIALS[member["material"]][1])
