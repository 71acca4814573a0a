"""Navigation among movable obstacles (NAMO): costmaps, graphs, pushes and plans from map and haptic tags (Alt 2016, Ch. 4)."""
