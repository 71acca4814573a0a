"""Verbs of maps, plans, stiffness and grasps."""
