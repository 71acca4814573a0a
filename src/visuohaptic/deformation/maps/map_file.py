"""Stiffness map files: NPZ for computation, VTU for ParaView, GLB with colours for viewers."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ...core import InputError, StiffnessMap, atomic_path, read_npz
from ...core.files import (
    check_target,
    draw_surface,
    frame_box,
    literal,
    new_figure,
    ramp_colours,
    save_figure,
)

_ARRAYS = ("vertices_m", "faces", "stiffness_N_per_m", "stiffness_sigma_N_per_m")
#: File suffixes of maps.
MAP_SUFFIXES = (".npz", ".vtu", ".glb")


def save_map(path: Path | str, found: StiffnessMap) -> None:
    """Write a stiffness map atomically.

    Parameters
    ----------
    path
        With the suffix .npz (for computation), .vtu (ParaView) or .glb (coloured mesh).
    found
        Map.
    """
    path = check_target(path, MAP_SUFFIXES)
    writers = {".npz": _save_npz, ".vtu": _save_vtu, ".glb": _save_glb}
    with atomic_path(path) as temporary:
        writers[path.suffix.lower()](temporary, found)


def load_map(path: Path | str) -> StiffnessMap:
    """Read and validate an NPZ map.

    Parameters
    ----------
    path
        NPZ file of :func:`save_map`.

    Raises
    ------
    InputError
        The file does not exist, or its arrays are not a stiffness map.
    """
    arrays = read_npz(path, "a stiffness map", names=_ARRAYS, remedy="write it with save_map")
    vertices, faces = arrays["vertices_m"], arrays["faces"]
    count = len(vertices) if vertices.ndim else 0
    good = vertices.dtype.kind == "f" and vertices.ndim == 2 and vertices.shape[1] == 3
    if not (good and np.isfinite(vertices).all()):
        raise InputError(path, f"found {vertices.shape}, expected finite numbers (v, 3)", field="vertices_m")
    good = faces.dtype.kind in "iu" and faces.ndim == 2 and faces.shape[1] == 3
    if not good or (faces.size and (faces.min() < 0 or faces.max() >= count)):
        raise InputError(path, f"expected vertex numbers below {count}, shape (f, 3)", field="faces")
    for name in _ARRAYS[2:]:
        if arrays[name].dtype.kind != "f" or arrays[name].shape != (count,):
            raise InputError(path, f"found {arrays[name].shape}, expected ({count},)", field=name)
        if (arrays[name] < 0).any():
            raise InputError(
                path, f"found {np.nanmin(arrays[name]):g}, expected no number below 0", field=name
            )
    return StiffnessMap(vertices, faces.astype(np.int64), arrays[_ARRAYS[2]], arrays[_ARRAYS[3]])


def colours(stiffness_N_per_m: Float[np.ndarray, "v"]) -> UInt8[np.ndarray, "v 3"]:
    """Colours of a map: dark is soft, bright is stiff, on a logarithmic scale from the 2nd to the 98th percentile.

    Parameters
    ----------
    stiffness_N_per_m
        Stiffness of each vertex [N/m]; non-finite values get the colour of the stiffest.
    """
    value, low, high = _logarithm(stiffness_N_per_m)
    fraction = np.nan_to_num((value - low) / max(high - low, 1e-12), nan=1.0, posinf=1.0)
    return ramp_colours(fraction)


def plot_map(path: Path | str, found: StiffnessMap, title: str = "") -> None:
    """Plot two views and the profile over the height, like figure 6.5.

    Parameters
    ----------
    path
        Figure to write, .png, .pdf or .svg.
    found
        Map.
    title
        Title of the figure.

    Examples
    --------
    >>> from visuohaptic.deformation.maps import object_map
    >>> from visuohaptic.deformation.shapes import load_object
    >>> plot_map("stiffness.png", object_map(load_object("cup", around=32), band=False))
    """
    from matplotlib.colors import LogNorm

    points_mm = found.vertices_m * 1e3
    shade = colours(found.stiffness_N_per_m)[found.faces].mean(axis=1) / 255
    figure, views = new_figure(1, 3, size=(10, 5), layout="constrained", projection="3d")
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    for axes, azimuth in zip(views, (-60, 30), strict=False):
        draw_surface(axes, points_mm[found.faces], shade)
        frame_box(axes, low, high, azimuth_deg=azimuth)
        axes.set_xlabel("x [mm]")
        axes.set_ylabel("y [mm]")
        axes.locator_params(axis="x", nbins=3)
        axes.locator_params(axis="y", nbins=3)
    views[2].remove()
    axes = figure.add_subplot(1, 3, 3)
    use = np.isfinite(found.stiffness_N_per_m)
    stiffness = 1e-3 * found.stiffness_N_per_m[use]
    _, low_log, high_log = _logarithm(1e-3 * found.stiffness_N_per_m)
    bounds = LogNorm(np.exp(low_log), np.exp(high_log))
    shown = axes.scatter(stiffness, points_mm[use, 2], c=stiffness, cmap="viridis", norm=bounds, s=6)
    figure.colorbar(shown, ax=axes, label="stiffness [N/mm]", extend="both")
    axes.set_xscale("log")
    axes.set_xlabel("stiffness [N/mm]")
    axes.set_ylabel("height [mm]")
    axes.grid(alpha=0.3)
    figure.suptitle(literal(title))
    save_figure(path, figure)


def _save_npz(path: Path, found: StiffnessMap) -> None:
    np.savez_compressed(
        path,
        vertices_m=np.asarray(found.vertices_m, dtype=np.float64),
        faces=np.asarray(found.faces, dtype=np.int64),
        stiffness_N_per_m=np.asarray(found.stiffness_N_per_m, dtype=np.float64),
        stiffness_sigma_N_per_m=np.asarray(found.stiffness_sigma_N_per_m, dtype=np.float64),
    )


def _save_vtu(path: Path, found: StiffnessMap) -> None:
    def array(name: str, values: np.ndarray, components: int = 1) -> str:
        kind = {"f": "Float64", "i": "Int64", "u": "UInt8"}[values.dtype.kind]
        data = np.ascontiguousarray(values).tobytes()
        text = base64.b64encode(struct.pack("<Q", len(data)) + data).decode()
        return (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="binary">'
            f"{text}</DataArray>\n"
        )

    faces = found.faces.astype("<i8")
    count = len(faces)
    path.write_text(
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        f'header_type="UInt64">\n<UnstructuredGrid><Piece NumberOfPoints="{len(found.vertices_m)}" '
        f'NumberOfCells="{count}">\n<PointData Scalars="stiffness_N_per_m">\n'
        + array("stiffness_N_per_m", found.stiffness_N_per_m.astype("<f8"))
        + array("stiffness_sigma_N_per_m", found.stiffness_sigma_N_per_m.astype("<f8"))
        + "</PointData>\n<Points>\n"
        + array("Points", found.vertices_m.astype("<f8"), 3)
        + "</Points>\n<Cells>\n"
        + array("connectivity", faces.ravel())
        + array("offsets", 3 * np.arange(1, count + 1, dtype="<i8"))
        + array("types", np.full(count, 5, dtype=np.uint8))
        + "</Cells>\n</Piece></UnstructuredGrid></VTKFile>\n",
        encoding="ascii",
    )


def _save_glb(path: Path, found: StiffnessMap) -> None:
    points = found.vertices_m.astype("<f4")
    shade = np.concatenate(
        [colours(found.stiffness_N_per_m), np.full((len(points), 1), 255, np.uint8)], axis=1
    )
    parts = [points.tobytes(), shade.tobytes(), found.faces.astype("<u4").tobytes()]
    views, offset = [], 0
    for part, target in zip(parts, (34962, 34962, 34963), strict=True):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(part), "target": target})
        offset += len(part)
    least, largest = points.min(axis=0).tolist(), points.max(axis=0).tolist()

    def counted(view: int) -> dict[str, int]:
        return {"bufferView": view, "count": len(points)}

    document = {
        "asset": {"version": "2.0", "generator": "visuohaptic"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        # glTF is y-up: rotate by -90 degrees about x.
        "nodes": [{"mesh": 0, "rotation": [-(0.5**0.5), 0, 0, 0.5**0.5]}],
        "materials": [
            {"doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}]}
        ],
        "accessors": [
            {"componentType": 5126, "type": "VEC3", "min": least, "max": largest, **counted(0)},
            {"componentType": 5121, "type": "VEC4", "normalized": True, **counted(1)},
            {"componentType": 5125, "type": "SCALAR", "bufferView": 2, "count": found.faces.size},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(parts)
    data += b"\0" * (-len(data) % 4)
    total = 12 + 8 + len(text) + 8 + len(data)
    path.write_bytes(
        struct.pack("<4sII", b"glTF", 2, total)
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(data), b"BIN\0")
        + data
    )


def _logarithm(stiffness: Float[np.ndarray, "v"]) -> tuple[Float[np.ndarray, "v"], float, float]:
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.log(stiffness)
    use = value[np.isfinite(value)]
    if not use.size:
        return value, 0.0, 1.0
    return value, float(np.percentile(use, 2)), float(np.percentile(use, 98))
