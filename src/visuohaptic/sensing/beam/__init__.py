"""Six axes from a bending rod (Alt 2016, Sec. 3.4)."""
