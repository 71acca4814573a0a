"""Verbs of the demo, the page and the installation."""
