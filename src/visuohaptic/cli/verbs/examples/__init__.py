"""Verbs that write simulated data to try the others on."""
