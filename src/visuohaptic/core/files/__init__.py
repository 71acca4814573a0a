"""One gate per file format: every file from outside is distrusted here, and nowhere else.

A reader refuses what it cannot read in one line, before it takes memory: special files (pipes, devices),
YAML whose aliases multiply, arrays and images whose headers promise more than a program should hold.
Writers leave a whole file or none.
"""

from __future__ import annotations

from .arrays import MAX_ARRAY_BYTES, read_npy, read_npz
from .atomic import atomic_path, write_text
from .image_header import MAX_PIXELS, image_size
from .images import MAX_IMAGE_BYTES, ImageMode, decode_image, encode_image, read_image, write_image
from .json_file import MAX_JSON_BYTES, load_json
from .part_file import PartFile, check_unlocked, csv_line, lock, whole_lines
from .problems import field_problems
from .regular import file_size, read_bytes, read_head, read_text
from .yaml_text import checked_model, load_yaml, load_yaml_model, parse_yaml, save_yaml

__all__ = [
    "MAX_ARRAY_BYTES",
    "MAX_IMAGE_BYTES",
    "MAX_JSON_BYTES",
    "MAX_PIXELS",
    "ImageMode",
    "PartFile",
    "atomic_path",
    "check_unlocked",
    "checked_model",
    "csv_line",
    "decode_image",
    "encode_image",
    "field_problems",
    "file_size",
    "image_size",
    "load_json",
    "load_yaml",
    "load_yaml_model",
    "lock",
    "parse_yaml",
    "read_bytes",
    "read_head",
    "read_image",
    "read_npy",
    "read_npz",
    "read_text",
    "save_yaml",
    "whole_lines",
    "write_image",
    "write_text",
]
