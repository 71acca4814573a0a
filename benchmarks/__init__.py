"""Benchmarks; where a peer exists, a figure is also given as a ratio to the peer, measured in the same process."""
