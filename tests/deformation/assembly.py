"""Element matrices added up as a sparse matrix, for other solvers."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array, csc_array, diags_array

from visuohaptic.deformation.shells import ShellModel


def assembled(
    matrices: np.ndarray, elements: np.ndarray, nodes: int, diagonal: np.ndarray | None = None
) -> Any:
    """The sum of the matrices; degrees of freedom of a node are adjacent."""
    size = matrices.shape[1] // elements.shape[1]
    dofs = (elements[:, :, None] * size + np.arange(size)).reshape(len(elements), -1)
    rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None])
    total = coo_array((matrices.ravel(), (rows.ravel(), columns.ravel())), shape=(nodes * size,) * 2)
    return csc_array(total if diagonal is None else total + diags_array(diagonal.ravel()))


def stiffness_matrix(model: ShellModel) -> Any:
    """Of a shell, with springs but without supports."""
    return assembled(model.element_matrices, model.mesh.faces, model.nodes, model.springs)
