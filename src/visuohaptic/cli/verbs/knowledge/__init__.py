"""Verbs of databases and classifiers."""
