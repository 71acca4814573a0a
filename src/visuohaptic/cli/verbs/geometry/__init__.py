"""Verbs of depth sequences and surfaces."""
