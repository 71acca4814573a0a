"""Geometry from vision and touch: fusion, transparency, completion (Alt 2016, Ch. 5)."""
