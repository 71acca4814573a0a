"""Frames and measurements in and out: video, image folders, live cameras, depth, MCAP, tables, maps."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..files import read_image
from .depth_pictures import DepthEncoding, read_depth, write_depth
from .frames import open_source
from .image_folder import ImageFolderSource
from .live import CameraBackend, CameraSettings, FoundCamera, LiveSource, find_cameras, open_camera
from .mcap_in import McapSource
from .mcap_out import MeasurementWriter
from .mcap_records import McapDamage, McapFile, McapMessage, Topic
from .measurement_sink import MeasurementSink
from .occupancy_map import OccupancyMap
from .poses import StampedPose, read_poses, write_poses
from .source import RecordedSource, indices_from_times
from .tables import ForceTable, TableWriter, read_force_table, read_wrench_table
from .video import VideoSource

if TYPE_CHECKING:
    from .depth_import import ImportedSequence, import_sequence
    from .depth_sequence import DepthFrame, DepthSequence

__all__ = [
    "CameraBackend",
    "CameraSettings",
    "DepthEncoding",
    "DepthFrame",
    "DepthSequence",
    "ForceTable",
    "FoundCamera",
    "ImageFolderSource",
    "ImportedSequence",
    "LiveSource",
    "McapDamage",
    "McapFile",
    "McapMessage",
    "McapSource",
    "MeasurementSink",
    "MeasurementWriter",
    "OccupancyMap",
    "RecordedSource",
    "StampedPose",
    "TableWriter",
    "Topic",
    "VideoSource",
    "find_cameras",
    "import_sequence",
    "indices_from_times",
    "open_camera",
    "open_source",
    "read_depth",
    "read_force_table",
    "read_image",
    "read_poses",
    "read_wrench_table",
    "write_depth",
    "write_poses",
]


def __getattr__(name: str) -> Any:
    """Depth sequences are described by pydantic models, which are heavy: imported when first used."""
    if name in {"DepthFrame", "DepthSequence"}:
        module = "depth_sequence"
    elif name in {"ImportedSequence", "import_sequence"}:
        module = "depth_import"
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{module}", __name__), name)
