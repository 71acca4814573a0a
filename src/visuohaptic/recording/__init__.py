"""Frames and measurements in and out: video, image folders, live cameras, MCAP, tables, maps."""

from .frames import open_source
from .image_folder import ImageFolderSource, read_image
from .live import CameraBackend, CameraSettings, FoundCamera, LiveSource, find_cameras, open_camera
from .mcap_in import McapSource
from .mcap_out import MeasurementWriter
from .mcap_records import McapDamage, McapFile, McapMessage, Topic
from .occupancy_map import OccupancyMap
from .source import RecordedSource, indices_from_times
from .tables import ForceTable, TableWriter, read_force_table, read_wrench_table
from .video import VideoSource

__all__ = [
    "CameraBackend",
    "CameraSettings",
    "ForceTable",
    "FoundCamera",
    "ImageFolderSource",
    "LiveSource",
    "McapDamage",
    "McapFile",
    "McapMessage",
    "McapSource",
    "MeasurementWriter",
    "OccupancyMap",
    "RecordedSource",
    "TableWriter",
    "Topic",
    "VideoSource",
    "find_cameras",
    "indices_from_times",
    "open_camera",
    "open_source",
    "read_force_table",
    "read_image",
    "read_wrench_table",
]
