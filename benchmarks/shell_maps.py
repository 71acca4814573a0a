"""CPU time of a full linear map, compared with one solve per grasp with a factor of the same matrix.

python -m benchmarks shell_maps
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from visuohaptic.deformation.shells import (
    RevolutionShell,
    ShellModel,
    dual_tip_map,
    opposing_points,
    pinch_stiffness,
    tip_loads,
)

from .harness import cpu_seconds
from .shell_course import PET, tube

#: Grasps that the peer solves; the rest is extrapolated, each costs the same.
PEER_GRASPS = 64


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    rows: list[dict[str, Any]] = []
    for around, along, floor, aim in ((72, 66, 3.0, 1.0), (144, 132, 15.0, 5.0)):
        mesh = tube(around, along).mesh
        model = ShellModel(mesh, PET, range(around))
        stiffness = dual_tip_map(model)

        def whole(mesh: Any = mesh, around: int = around) -> np.ndarray:
            return dual_tip_map(ShellModel(mesh, PET, range(around)))

        ours_s = cpu_seconds(whole, repeats=3)
        factor_s, solve_s, error = _peer(model, stiffness)
        grasps = len(mesh.vertices_m) // 2
        rows.append(
            {
                "name": f"map of {len(mesh.vertices_m)} vertices: assembly, order, factor, all pinches",
                "ours": ours_s,
                "unit": "s CPU",
                "peer": factor_s + grasps * solve_s,
                "peer_name": f"splu (MMD) and one solve per pinch, {PEER_GRASPS} of {grasps} measured",
                "floor": floor,
                "aim": aim,
                "note": f"largest difference {error:.1e}",
            }
        )
        rows.append(
            {
                "name": "the same: its factor alone",
                "ours": _factor_s(model),
                "unit": "s CPU",
                "peer": factor_s,
            }
        )
    z = np.linspace(0, 0.2, 101)
    shell = RevolutionShell(np.full(101, 0.035), z, 0.0005)
    rows.append(
        {
            "name": "solid of revolution, all 100 heights",
            "ours": 1e3 * cpu_seconds(lambda: pinch_stiffness(shell, PET)),
            "unit": "ms CPU",
            "floor": 130.0,
            "aim": 20.0,
        }
    )
    return rows


def _factor_s(model: ShellModel) -> float:
    def work() -> None:
        model.__dict__.pop("_factor", None)
        model.factor()

    return cpu_seconds(work, repeats=3)


def _peer(model: ShellModel, stiffness: np.ndarray) -> tuple[float, float, float]:
    free = model.free
    dofs = (model.mesh.faces[:, :, None] * 6 + np.arange(6)).reshape(-1, 18)
    rows, columns = np.broadcast_arrays(dofs[:, :, None], dofs[:, None])
    size = 6 * model.nodes
    whole = coo_array(
        (model.element_matrices.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)
    ).tocsr()
    matrix = whole[free][:, free].tocsc()
    started_s = time.process_time()
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    factor_s = time.process_time() - started_s
    chosen = np.linspace(len(stiffness) // 20, len(stiffness) - 1, PEER_GRASPS).astype(int)
    loads = tip_loads(model.nodes, opposing_points(model.mesh, chosen), model.mesh.vertices_m).toarray()[free]
    started_s = time.process_time()
    found = np.array([2 / (loads[:, k] @ factor.solve(loads[:, k])) for k in range(PEER_GRASPS)])
    solve_s = (time.process_time() - started_s) / PEER_GRASPS
    return factor_s, solve_s, float(np.abs(found / stiffness[chosen] - 1).max())
