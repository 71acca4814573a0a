"""How a container gives way: shapes, shells, contents, stiffness maps (Alt 2016, Sec. 6.1)."""
