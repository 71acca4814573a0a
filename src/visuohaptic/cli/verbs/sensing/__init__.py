"""Verbs of cameras and sensors."""
