"""A bending rod of spring steel on a guided spring: ground truth for tests of the beam sensor.

The rod is a chain of rigid links; the moment at each joint rotates it by its
part of the curvature, and the equilibrium is found by fixed-point iteration. Bending is
not limited to small angles; the rod also twists, stretches and shears. No code is shared with the
estimator in ``sensing``, which integrates a differential equation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core import InputError, Pose
from ...core.geometry import so3_exp, so3_log


@dataclass(frozen=True, slots=True)
class ElasticRod:
    """Round rod clamped to a spring-loaded slider; the defaults are those of Alt 2016, Sec. 3.6.1.

    X points along the straight rod from the slider to the tip, Y and Z across
    it, right-handed.
    """

    length_m: float = 0.12
    diameter_m: float = 0.0015
    youngs_Pa: float = 206e9
    poisson: float = 0.29
    spring_N_per_m: float = 500.0  #: along X
    spring_Nm_per_rad: float = 0.2  #: about X
    links: int = 160  #: the error decreases with the square of this number

    def bend(
        self, force_N: Float[np.ndarray, "3"], moment_Nm: Float[np.ndarray, "3"] | None = None
    ) -> RodState:
        """Shape under a force and a moment at the tip, both with fixed directions.

        Parameters
        ----------
        force_N, moment_Nm
            Force and moment in the frame of the straight rod; the moment is about the displaced tip.

        Raises
        ------
        InputError
            The load buckles or rolls up the rod, so that no equilibrium was found.
        """
        force = np.asarray(force_N, dtype=np.float64)
        moment = np.zeros(3) if moment_Nm is None else np.asarray(moment_Nm, dtype=np.float64)
        radius = 0.5 * self.diameter_m
        area, inertia = math.pi * radius**2, 0.25 * math.pi * radius**4
        shear_Pa = 0.5 * self.youngs_Pa / (1 + self.poisson)
        stiffness = np.array([2 * shear_Pa * inertia, self.youngs_Pa * inertia, self.youngs_Pa * inertia])
        # Shear correction of a full circle.
        stretch = 1 / np.array(
            [self.youngs_Pa * area, *[shear_Pa * area * 6 * (1 + self.poisson) / (7 + 6 * self.poisson)] * 2]
        )
        h = self.length_m / self.links
        # The plain iteration oscillates under loads far beyond the yield limit; a damped one does not.
        for relaxation in (1.0, 0.3):
            curvature, twist = np.zeros((self.links, 3)), 0.0
            for _ in range(600):
                frames, points, middles, joints = self._chain(h * curvature, force, stretch, twist)
                moments = moment + np.cross(points[-1] - joints, force)
                more = np.einsum("nji,nj->ni", middles, moments) / stiffness - curvature
                base = moment + np.cross(points[-1] - points[0], force)
                more_twist = base[0] / self.spring_Nm_per_rad - twist
                change = h * np.abs(more).max() + abs(more_twist)
                if not change < 1e3:
                    break
                if change < 1e-13:
                    return RodState(self, force, moment, frames, points)
                curvature, twist = curvature + relaxation * more, twist + relaxation * more_twist
        raise InputError(
            "ElasticRod.bend", f"no shape found under {force} N and {moment} Nm", remedy="load less"
        )

    def _chain(
        self, turns: np.ndarray, force: np.ndarray, stretch: np.ndarray, twist: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Frames at the nodes, nodes, frames in the joints, joints; a joint sits between two half links."""
        h = self.length_m / self.links
        half = so3_exp(0.5 * turns)
        c, s = math.cos(twist), math.sin(twist)
        base = np.array([[[1.0, 0, 0], [0, c, -s], [0, s, c]]])
        frames = np.concatenate([base, half @ half])
        # Products of two neighbours, of four, of eight: all that begin at the slider, in few steps.
        step = 1
        while step <= self.links:
            frames[step:] = frames[:-step] @ frames[step:]
            step *= 2
        along = np.array([1.0, 0.0, 0.0]) + np.einsum("nji,j->ni", frames, force) * stretch
        steps = 0.5 * h * np.einsum("nij,nj->ni", frames, along)
        points = np.zeros((self.links + 1, 3))
        points[0, 0] = force[0] / self.spring_N_per_m
        points[1:] = points[0] + np.cumsum(steps[:-1] + steps[1:], axis=0)
        return frames, points, frames[:-1] @ half, points[:-1] + steps[:-1]


@dataclass(frozen=True, slots=True, eq=False)
class RodState:
    """The bent rod; coordinates of the straight rod, origin at the unloaded slider."""

    rod: ElasticRod
    force_N: Float[np.ndarray, "3"]
    moment_Nm: Float[np.ndarray, "3"]
    frames: Float[np.ndarray, "n 3 3"]  #: axes of the cross sections, as columns
    points_m: Float[np.ndarray, "n 3"]  #: centres of the cross sections

    def pose(self, xi: float) -> Pose:
        """Cross section at xi = x / L: maps its coordinates to those of the straight rod.

        Parameters
        ----------
        xi
            Position along the rod over its length, 0 at the base and 1 at the tip.
        """
        from scipy.interpolate import CubicSpline

        if not 0 <= xi <= 1:
            raise InputError("xi", f"found {xi:g}, expected 0 to 1")
        at = np.linspace(0, 1, len(self.points_m))
        vectors = so3_log(self.frames)
        both = CubicSpline(at, np.hstack([self.points_m, vectors]))(xi)
        return Pose.from_rotation_vector(both[3:], both[:3])
