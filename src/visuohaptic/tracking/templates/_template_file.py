"""The file ``tags.yaml`` in a folder of templates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from ...core.files import load_yaml_model

#: Tags in the family 36h11.
_TAG_COUNT = 587

Size = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class TagEntry(BaseModel):
    """One AprilTag 36h11."""

    model_config = ConfigDict(extra="forbid")
    id: Annotated[int, Field(ge=0, lt=_TAG_COUNT)]  #: of the family 36h11
    size_m: Size  #: side of the black border


class TemplateFolderFile(BaseModel):
    """Tags by name, and widths of images that state no dpi."""

    model_config = ConfigDict(extra="forbid")
    tags: dict[str, TagEntry] = {}  #: AprilTags by name
    widths_m: dict[str, Size] = {}  #: width of an image that states no dpi, by file name [m]

    @classmethod
    def read(cls, path: Path) -> TemplateFolderFile:
        """Contents of the file; empty if it does not exist.

        Parameters
        ----------
        path
            The file.
        """
        return load_yaml_model(path, cls) if path.exists() else cls()
