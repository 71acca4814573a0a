"""Arrays of the planner, in grid coordinates unless said otherwise: x along the columns, y along the rows [cells]."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int16, Int32

#: A place or a direction: x, y.
Point = Float[np.ndarray, "2"]
#: Places along a path or of candidates.
Path = Float[np.ndarray, "k 2"]
#: Corners of a polygon, not closed.
Outline = Float[np.ndarray, "p 2"]
#: Displacement of each body from its mapped position.
Shifts = Float[np.ndarray, "bodies 2"]
#: Whether a body counts.
Among = Bool[np.ndarray, "bodies"]
#: Distance to the nearest obstacle of the cells of a map, or of the nodes of a lattice.
Clearance = Float32[np.ndarray, "rows columns"]
#: Number of the body or passage to which each node belongs, from 1; 0: none.
Labels = Int16[np.ndarray, "rows columns"]
#: Numbers of nodes, row by row.
Nodes = Int32[np.ndarray, "k"]
#: Cost of each node of a lattice, row by row [units].
Field = Int32[np.ndarray, "n"]
