"""Third-party triangle meshes: STL, PLY, OBJ, GLB, DAE; all files are treated as untrusted."""

from __future__ import annotations

import io
import logging
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError, MissingExtraError, VisuohapticError, needs
from ...core.files import MAX_TEXT_BYTES, check_glb, read_bytes
from ._mesh_diagnosis import diagnose, first_zero_index
from .ply import parse_ply

FORMATS = (".stl", ".ply", ".obj", ".glb", ".dae")
#: Larger meshes are rejected before they exhaust the memory.
MAX_FACES = 2_000_000
#: Nested instances multiply the contents of a COLLADA file.
MAX_INSTANCES = 16
#: Unit of length of a COLLADA file [m].
_UNIT = re.compile(
    rb"""<unit\b[^>]*\bmeter\s*=\s*["']\s*([0-9.]*[1-9][0-9]*(?:[eE][-+]?[0-9]{1,2})?)\s*["']"""
)


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """Triangles as stored in a file, in the file's unit; nothing is repaired."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    source: str
    unit_m: float | None = None  #: unit of length that the file states (COLLADA only) [m]


def load_mesh(path: Path | str) -> TriangleMesh:
    """Read all triangles of a file as one mesh.

    Parameters
    ----------
    path
        The file; its suffix determines the format.

    Raises
    ------
    InputError
        The format is not supported, or the file is unreadable, empty, too large, or contains non-finite numbers.
    MissingExtraError
        The library for reading meshes is not installed.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in FORMATS:
        raise InputError(path, f"found suffix {path.suffix!r}, expected one of {', '.join(FORMATS)}")
    data = read_bytes(path, MAX_TEXT_BYTES)
    if not data:
        raise InputError(path, "is empty")
    _distrust(path, kind, data)
    if kind == ".ply":
        mesh = parse_ply(path, data)
        vertices, faces = mesh.vertices_m, mesh.faces
    else:
        vertices, faces = _by_trimesh(path, kind, data)
    if faces.ndim != 2 or not len(faces) or faces.shape[1] != 3 or vertices.ndim != 2:
        found = diagnose(kind, data)
        raise InputError(path, "has no triangles" + (f": {found}" if found else ""))
    if vertices.shape[1:] != (3,):
        raise InputError(path, f"found vertices of shape {vertices.shape}, expected three coordinates each")
    if len(faces) > MAX_FACES:
        raise InputError(path, f"has {len(faces)} triangles, expected at most {MAX_FACES}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        face = int(np.argmax(((faces < 0) | (faces >= len(vertices))).any(axis=1)))
        plain = f"triangle {face} refers to vertex {faces[face].max()}, expected 0 to {len(vertices) - 1}"
        raise InputError(path, diagnose(kind, data) or plain)
    used = vertices[faces.ravel()]
    if not np.isfinite(used).all() or np.abs(used).max() > 1e9:
        face = int(np.argmax(~(np.abs(used) <= 1e9).all(axis=1))) // 3
        raise InputError(path, f"triangle {face} has corners that are not finite numbers below 1e9")
    stated = _UNIT.search(data) if kind == ".dae" else None
    return TriangleMesh(vertices, faces, str(path), float(stated[1]) if stated else None)


def _by_trimesh(path: Path, kind: str, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    with needs("trimesh", "geometry", "reading meshes"):
        import trimesh
    # Its readers log a traceback of exceptions that they raise anyway.
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            options = {"skip_materials": True} if kind == ".obj" else {}
            # Loaded from memory, so that a mesh cannot access other files.
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind[1:], process=False, **options)
            sizes = {name: len(getattr(one, "faces", ())) for name, one in scene.geometry.items()}
            # Each node is a copy: a few bytes of a file repeat the largest of its meshes.
            faces_in_all = sum(sizes[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
            if faces_in_all > MAX_FACES:
                raise InputError(path, f"has {faces_in_all} triangles, expected at most {MAX_FACES}")
            mesh = scene.to_mesh()
            return np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64)
    except VisuohapticError:
        raise
    except ImportError as error:
        raise MissingExtraError("pycollada", "geometry", "reading COLLADA meshes") from error
    except Exception as error:
        reason = diagnose(kind, data) or " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(path, f"cannot be read as {kind[1:].upper()}: {reason}") from error
    finally:
        logger.setLevel(level)


def _distrust(path: Path, kind: str, data: bytes) -> None:
    """Reject files that would expand far beyond their size."""
    if kind == ".dae":
        if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
            raise InputError(path, "defines XML entities, which COLLADA does not need")
        count = data.count(b"<instance_node")
        if count > MAX_INSTANCES:
            raise InputError(path, f"has {count} nested instances, expected at most {MAX_INSTANCES}")
    if kind == ".obj" and (found := first_zero_index(data)):
        raise InputError(path, found)
    if kind == ".glb":
        check_glb(path, data)
