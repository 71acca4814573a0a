"""Multifrontal factorisation of a mesh's stiffness, and solves restricted to the required paths of the tree.

Each front of :class:`.ordering.FrontTree` is a small dense matrix, so nearly all work is done by
BLAS. A symmetric positive definite matrix is factorised as ``L L^T``; any other (the tangent beyond a
limit point, or with a follower load) by block elimination with pivoting inside the fronts.

For loads F the compliances ``diag(F^T K^-1 F)`` are column sums of ``(L^-1 F)^2``. Column j of
``L^-1 F`` is zero off the paths from its loaded nodes to the root, and is computed only there:
a map of every surface point thus costs only a few factorisations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core import InputError, one_blas_thread
from . import _front_kernels as kernels
from .ordering import FrontTree

#: Number of columns that are processed together; bounds the memory of a map.
BLOCK_COLUMNS = 2048
#: Pivots that are divided by together in a large front. The triangular solve of BLAS with many right-hand sides runs at
#: a quarter of the speed of its products: by blocks nearly all work is products, and an inverse is one as well.
BLOCK_PIVOTS = 64


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """A factorised stiffness matrix with ``dofs`` unknowns per node.

    ``pivots`` holds L11, or the LU of the pivot block; ``below`` L21, or K21; ``right`` is None, or
    ``K11^-1 K12``.
    """

    tree: FrontTree
    dofs: int  #: degrees of freedom of each node
    definite: bool  #: factorised as ``L L^T``
    negative: int  #: parity of the negative pivots of an indefinite matrix: sign of the determinant, +1 or -1
    pivots: tuple[Any, ...]
    below: tuple[Float[np.ndarray, "b k"], ...]
    right: tuple[Float[np.ndarray, "k b"], ...]

    @one_blas_thread()
    def solve(self, loads: Float[np.ndarray, "n *m"]) -> Float[np.ndarray, "n *m"]:
        """Displacements under one or several load vectors.

        Parameters
        ----------
        loads
            Forces (n,) or (n, m); the degrees of freedom of a node are adjacent in n.
        """
        from scipy.linalg.blas import dtrsm
        from scipy.linalg.lapack import dgetrs

        tree, size = self.tree, self.dofs
        loads = np.asarray(loads, dtype=float)
        x = np.ascontiguousarray(loads.reshape(tree.order.size, size, -1)[tree.order])
        columns = x.shape[2]
        for front in range(tree.fronts):
            begin, end, outside = self._part(front)
            top = x[begin:end].reshape(-1, columns)
            if self.definite:
                # Transposed, the rows of a front are columns in the order of Fortran: solved in place.
                dtrsm(1.0, self.pivots[front], top.T, side=1, lower=1, trans_a=1, overwrite_b=1)
            else:
                top[:] = dgetrs(*self.pivots[front], top)[0]
            if outside.size:
                x[outside] -= (self.below[front] @ top).reshape(-1, size, columns)
        for front in reversed(range(tree.fronts)):
            begin, end, outside = self._part(front)
            beyond = x[outside].reshape(-1, columns)
            if self.definite:
                top = x[begin:end].reshape(-1, columns)
                if outside.size:
                    top -= self.below[front].T @ beyond
                dtrsm(1.0, self.pivots[front], top.T, side=1, lower=1, overwrite_b=1)
            elif outside.size:
                x[begin:end] -= (self.right[front] @ beyond).reshape(-1, size, columns)
        out = np.empty_like(x)
        out[tree.order] = x
        return out.reshape(loads.shape)

    def compliance(self, loads: Any) -> Float[np.ndarray, "m"]:
        """``diag(F^T K^-1 F)`` for sparse loads F (n, m), each column only along its own paths.

        Parameters
        ----------
        loads
            The m sparse loads F, one per column.

        Raises
        ------
        InputError
            The matrix is not positive definite.
        """
        return self._half(loads, coupled=False)

    def coupling(self, loads: Any) -> Float[np.ndarray, "m m"]:
        """``F^T K^-1 F`` for sparse loads F (n, m).

        Parameters
        ----------
        loads
            As of :meth:`compliance`.

        Raises
        ------
        InputError
            As of :meth:`compliance`.
        """
        return self._half(loads, coupled=True)

    def _part(self, front: int) -> tuple[int, int, Int[np.ndarray, "_"]]:
        tree = self.tree
        outside = tree.border[tree.offset[front] : tree.offset[front + 1]]
        return int(tree.first[front]), int(tree.first[front + 1]), outside

    @one_blas_thread()
    def _half(self, loads: Any, *, coupled: bool) -> Float[np.ndarray, "..."]:
        from scipy.sparse import csc_array

        if not self.definite:
            raise InputError("Factor.compliance", "the matrix is not positive definite", remedy="use solve")
        tree, size = self.tree, self.dofs
        loads = csc_array(loads)
        count = loads.shape[1]
        dofs = (tree.order[:, None] * size + np.arange(size)).ravel()
        if coupled:
            out = np.zeros((count, count))
            self._forward(loads[dofs], np.arange(count), out)
            return out
        out = np.zeros(count)
        # Columns that start in the same branch of the tree share most of their path.
        lead = np.full(count, tree.order.size)
        columns = np.repeat(np.arange(count), np.diff(loads.indptr))
        np.minimum.at(lead, columns, tree.place[loads.indices // size])
        ranked = np.argsort(lead, kind="stable")
        for begin in range(0, count, BLOCK_COLUMNS):
            some = ranked[begin : begin + BLOCK_COLUMNS]
            self._forward(loads[:, some][dofs], some, out)
        return out

    def _forward(self, loads: Any, names: Int[np.ndarray, "m"], out: Float[np.ndarray, "..."]) -> None:
        """Add ``(L^-1 F)^2``, or the products of its columns, of permuted loads to ``out``."""
        from scipy.linalg.blas import dgemm, dtrmm, dtrsm
        from scipy.linalg.lapack import dtrtri

        tree, size = self.tree, self.dofs
        by_row = loads.tocsr()
        position = np.empty(loads.shape[1], dtype=np.int64)
        carried: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for front in range(tree.fronts):
            begin, end = int(tree.first[front]) * size, int(tree.first[front + 1]) * size
            a, b = by_row.indptr[begin], by_row.indptr[end]
            kids = [child for child in tree.children[front] if child in carried]
            if a == b and not kids:
                continue
            sets = [carried[child][0] for child in kids]
            columns = (
                sets[0]
                if len(sets) == 1 and a == b
                else np.unique(np.concatenate([*sets, by_row.indices[a:b]]))
            )
            position[columns] = np.arange(columns.size)
            outside = size * int(tree.offset[front + 1] - tree.offset[front])
            top = np.zeros((end - begin, columns.size), order="F")
            bottom = np.zeros((outside, columns.size), order="F")
            if b > a:
                rows = np.repeat(np.arange(end - begin), np.diff(by_row.indptr[begin : end + 1]))
                np.add.at(top, (rows, position[by_row.indices[a:b]]), by_row.data[a:b])
            for child in kids:
                its_columns, values = carried.pop(child)
                local = tree.border_local[tree.offset[child] : tree.offset[child + 1]]
                kernels.add_rows(top.T, bottom.T, values.T, local, position[its_columns], size)
            lower = self.pivots[front]
            if columns.size > len(lower):
                top = dtrmm(1.0, dtrtri(lower, lower=1)[0], top, lower=1, overwrite_b=1)
            else:
                top = dtrsm(1.0, lower, top, lower=1, overwrite_b=1)
            if out.ndim == 1:
                out[names[columns]] += np.einsum("ij,ij->j", top, top)
            else:
                out[np.ix_(names[columns], names[columns])] += top.T @ top
            if outside:
                bottom = dgemm(-1.0, self.below[front], top, beta=1.0, c=bottom, overwrite_c=1)
                carried[front] = columns, bottom


@one_blas_thread()
def factorise(
    tree: FrontTree,
    matrices: Float[np.ndarray, "e s s"],
    diagonal: Float[np.ndarray, "v k"] | None = None,
    *,
    definite: bool = True,
) -> Factor:
    """Factorise the sum of element matrices.

    Parameters
    ----------
    tree
        Tree of the elements of ``matrices``.
    matrices
        Element matrices; degrees of freedom of a node are adjacent.
    diagonal
        Added to the diagonal, by node and degree of freedom: springs, and a positive value for degrees of freedom
        without any element.
    definite
        Use ``L L^T``. Otherwise block elimination, which does not require a definite matrix.

    Raises
    ------
    InputError
        ``definite``, but the matrix is not: a mechanism, or missing supports.
    """
    from scipy.linalg.blas import dgemm, dsyrk
    from scipy.linalg.lapack import dgetrf, dgetrs, dpotrf

    size = _unknowns_per_node(tree, matrices)
    pivots: list[Any] = []
    below: list[np.ndarray] = []
    right: list[np.ndarray] = []
    updates: dict[int, np.ndarray] = {}
    sign = 1
    for front in range(tree.fronts):
        f11, f21, f22, f12 = _assembled_front(tree, front, matrices, diagonal, updates, full=not definite)
        if definite:
            lower, info = dpotrf(f11, lower=1, overwrite_a=1, clean=0)
            if info:
                row = int(tree.first[front]) + max(info - 1, 0) // size
                node = int(tree.order[row]) if info > 0 else -1
                raise InputError(
                    "shell model",
                    f"the stiffness is not positive definite at vertex {node}",
                    remedy="clamp more vertices, or look for a loose or flat part of the mesh there",
                )
            pivots.append(lower)
            if f21.size:
                _divide_rows(lower, f21)
                updates[front] = dsyrk(-1.0, f21, beta=1.0, c=f22, lower=1, overwrite_c=1)
        else:
            lu, swaps, info = dgetrf(f11, overwrite_a=1)
            if info > 0:
                # An exact zero pivot: at a limit point. A tiny pivot preserves the singular direction.
                lu[info - 1, info - 1] = 1e-14 * np.abs(lu).max() or 1.0
            negative = np.count_nonzero(np.diagonal(lu) < 0) + np.count_nonzero(swaps != np.arange(len(f11)))
            sign *= -1 if negative % 2 else 1
            pivots.append((lu, swaps))
            if f21.size:
                solved = dgetrs(lu, swaps, f12, overwrite_b=0)[0]
                updates[front] = dgemm(-1.0, f21, solved, beta=1.0, c=f22, overwrite_c=1)
                right.append(solved)
            else:
                right.append(f12)
        below.append(f21)
    return Factor(tree, size, definite, sign, tuple(pivots), tuple(below), tuple(right))


def _divide_rows(lower: Float[np.ndarray, "k k"], rows: Float[np.ndarray, "b k"]) -> None:
    """``R L^-T`` in the place of ``rows``, which are in the order of Fortran."""
    from scipy.linalg.blas import dgemm, dtrmm, dtrsm
    from scipy.linalg.lapack import dtrtri

    if len(lower) < 2 * BLOCK_PIVOTS:
        dtrsm(1.0, lower, rows, side=1, lower=1, trans_a=1, overwrite_b=1)
        return
    for begin in range(0, len(lower), BLOCK_PIVOTS):
        block = slice(begin, begin + BLOCK_PIVOTS)
        some = rows[:, block]
        if begin:
            dgemm(-1.0, rows[:, :begin], lower[block, :begin], trans_b=1, beta=1.0, c=some, overwrite_c=1)
        inverse = dtrtri(lower[block, block], lower=1)[0]
        dtrmm(1.0, inverse, some, side=1, lower=1, trans_a=1, overwrite_b=1)


def _unknowns_per_node(tree: FrontTree, matrices: Float[np.ndarray, "e s s"]) -> int:
    return matrices.shape[1] // (tree.element_local[0].shape[1] if tree.element_local else 1)


def _assembled_front(
    tree: FrontTree,
    front: int,
    matrices: Float[np.ndarray, "e s s"],
    diagonal: Float[np.ndarray, "v k"] | None,
    updates: dict[int, np.ndarray],
    *,
    full: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The blocks K11, K21, K22 and, when ``full``, K12 of a front: its elements and its children's updates."""
    begin, end = int(tree.first[front]), int(tree.first[front + 1])
    size = _unknowns_per_node(tree, matrices)
    inside = size * (end - begin)
    outside = size * int(tree.offset[front + 1] - tree.offset[front])
    f11 = np.zeros((inside, inside), order="F")
    f21 = np.zeros((outside, inside), order="F")
    f22 = np.zeros((outside, outside), order="F")
    f12 = np.zeros((inside, outside) if full else (0, 0), order="F")
    blocks = f11.T, f21.T, f22.T, f12.T
    kernels.add_elements(*blocks, matrices, tree.elements[front], tree.element_local[front], size, full)
    for child in tree.children[front]:
        local = tree.border_local[tree.offset[child] : tree.offset[child + 1]]
        kernels.add_blocks(*blocks, updates.pop(child).T, local, size, full)
    if diagonal is not None:
        f11.flat[:: inside + 1] += diagonal[tree.order[begin:end]].ravel()
    return f11, f21, f22, f12
