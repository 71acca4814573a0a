"""Objects as plain files: one folder per object with a YAML card, its arrays as Parquet, and its mesh as GLB.

``card.yaml`` contains the licence, and size and SHA-256 of the other files. The arrays are exact; the GLB is for
display and other programs, and is read only if the card has no mesh among its arrays.
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..core import Geometry, VisuoHapticObject, decode, encode
from ..core.errors import InputError, needs
from ..core.files import MAX_FILE_BYTES, atomic_path, check_glb, load_yaml_model, read_bytes, save_yaml
from .shards import file_sha256, pack, unpack

if TYPE_CHECKING:
    from pydantic import BaseModel

_log = logging.getLogger(__name__)

_FORMAT = "visuohaptic object"
_ARRAYS, _MESH = "arrays.parquet", "mesh.glb"
#: Ids are folder names, too.
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")


def check_id(object_id: str) -> None:
    """Reject an id that cannot be stored, or that would lead out of the folder of an export.

    Parameters
    ----------
    object_id
        Id of an object.

    Raises
    ------
    InputError
        It does not consist of 1 to 128 letters, digits, ``.``, ``_`` and ``-``.
    """
    if not _ID.fullmatch(object_id):
        found = f"found the id {object_id!r}"
        raise InputError("object", f"{found}, expected up to 128 letters a to z, digits, '.', '_', '-'")


def _card_model() -> type[BaseModel]:
    from pydantic import BaseModel, ConfigDict, Field

    class File(BaseModel):
        model_config = ConfigDict(extra="forbid")
        sha256: str = Field(pattern="^[0-9a-f]{64}$")
        bytes: int = Field(ge=0, le=MAX_FILE_BYTES)

    class Card(BaseModel):
        model_config = ConfigDict(extra="forbid")
        format: Literal["visuohaptic object"]
        version: Literal[1]
        licence: str = Field(min_length=1)
        object: dict[str, Any]
        files: dict[Literal["arrays.parquet", "mesh.glb"], File] = Field(default_factory=dict)

    return Card


def export_object(obj: VisuoHapticObject, folder: Path | str, *, licence: str = "") -> Path:
    """Write an object to ``folder / id``; the card is written last and marks a complete folder.

    Parameters
    ----------
    obj
        The object.
    folder
        Parent folder of the object's folder.
    licence
        SPDX identifier, for an object without one.

    Returns
    -------
    Path
        The card, ``folder / id / card.yaml``.

    Raises
    ------
    InputError
        Neither the object nor the call specifies a licence, its id is no name of a folder, or the folder cannot be written.
    """
    check_id(obj.id)
    if not (licence := obj.licence or licence):
        raise InputError(obj.id, "has no licence", remedy="name the one under which it may be passed on")
    target = Path(folder) / obj.id
    try:
        target.mkdir(parents=True, exist_ok=True)
        (target / "card.yaml").unlink(missing_ok=True)
    except OSError as error:
        raise InputError(target, f"cannot be written ({error.strerror})") from error
    obj = replace(obj, licence=licence)
    card, arrays = encode(obj)
    written = []
    if arrays:
        with atomic_path(target / _ARRAYS) as temporary:
            pack([arrays], temporary)
        written.append(_ARRAYS)
    shape = obj.geometry
    if shape is not None and shape.vertices_m is not None and shape.faces is not None and len(shape.faces):
        data = _glb(shape)
        with atomic_path(target / _MESH) as temporary:
            temporary.write_bytes(data)
        written.append(_MESH)
    files = {
        name: {"sha256": file_sha256(target / name), "bytes": (target / name).stat().st_size}
        for name in written
    }
    save_yaml(
        target / "card.yaml",
        {"format": _FORMAT, "version": 1, "licence": licence, "object": card, "files": files},
    )
    return target


def export_objects(objects: Iterable[VisuoHapticObject], folder: Path | str, *, licence: str = "") -> int:
    """Write objects to separate folders; returns their number.

    Parameters
    ----------
    objects
        The objects.
    folder
        Parent folder of the objects' folders.
    licence
        SPDX identifier, for objects without one.

    Raises
    ------
    InputError
        See :func:`export_object`.
    """
    return len([export_object(obj, folder, licence=licence) for obj in objects])


def import_object(folder: Path | str) -> VisuoHapticObject:
    """Read the object of a folder or card; every file is verified against its hash.

    Parameters
    ----------
    folder
        Folder with a ``card.yaml``, or the card itself.

    Raises
    ------
    InputError
        A file is missing, changed or has the wrong format.
    """
    path = Path(folder)
    path = path if path.suffix == ".yaml" else path / "card.yaml"
    card: Any = load_yaml_model(path, _card_model())
    for name, said in card.files.items():
        file = path.parent / name
        if not file.is_file():
            raise InputError(file, "is missing, but card.yaml lists it")
        if file.stat().st_size != said.bytes or file_sha256(file) != said.sha256:
            raise InputError(file, "does not match its checksum in card.yaml", remedy="export it again")
    arrays = {}
    if _ARRAYS in card.files:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            with pq.ParquetFile(path.parent / _ARRAYS) as file:
                arrays = unpack(file, [0], path.parent / _ARRAYS)[0]
        except (pa.ArrowException, OSError) as error:  # damaged headers are reported as either
            raise InputError(path.parent / _ARRAYS, f"is not a Parquet file ({error})") from error
    obj = replace(decode(card.object, arrays, path), licence=card.licence)
    if obj.geometry is None and _MESH in card.files:
        obj = replace(obj, geometry=_from_glb(path.parent / _MESH))
    return obj


def import_objects(folder: Path | str) -> Iterator[VisuoHapticObject]:
    """Objects of a folder: from its own card, or from its subfolders, sorted by name.

    Parameters
    ----------
    folder
        Card, folder with a card, or folder of such folders.

    Raises
    ------
    InputError
        There is no card; or see :func:`import_object`.
    """
    path = Path(folder)
    if path.suffix == ".yaml" or (path / "card.yaml").is_file():
        yield import_object(path)
        return
    cards = sorted(path.glob("*/card.yaml"))
    if not cards:
        raise InputError(path, "found no card.yaml in it or in its folders")
    for card in cards:
        yield import_object(card)


def _glb(shape: Geometry) -> bytes:
    trimesh = _trimesh()
    mesh = trimesh.Trimesh(shape.vertices_m, shape.faces, process=False)
    return bytes(mesh.export(file_type="glb"))


def _from_glb(path: Path) -> Geometry:
    trimesh = _trimesh()
    data = read_bytes(path, MAX_FILE_BYTES)
    check_glb(path, data)
    try:
        # From memory, so that it cannot refer to other files.
        mesh = trimesh.load(io.BytesIO(data), file_type="glb", force="mesh", process=False)
        return Geometry(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64))
    except Exception as error:
        raise InputError(path, f"is not a readable mesh ({type(error).__name__}: {error})") from error


def _trimesh() -> Any:
    with needs("trimesh", "geometry", "reading and writing of GLB"):
        import trimesh
    return trimesh
