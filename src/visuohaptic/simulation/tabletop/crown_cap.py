"""A bottle with a crown cap, and an opener on a beam sensor held by an arm (Alt 2016, Sec. 3.6.5).

The tool frame has its origin at the centre of the opener's bridge, the edge
that rests on top of the cap: x across, y forward, z up. The bridge is an arch
over the cap; a hook behind and below it goes under the rim. The opener is
mounted on the beam, which deforms in all six axes; where its edges would penetrate the
cap, a contact force acts. The equilibrium is computed at every time (quasi-static);
there is no friction and no inertia.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from ...core import Frame, Pose, finite_array
from ..rendering.blank_frames import BlankFrames
from .arm import SimulatedArm

#: Outline (r, z) of a crown cap on a bottle's neck [m]; z = 0 is its top (ISO 12821, 26 mm finish).
CAPPED = 1e-3 * np.array(
    [(0.0, 0.0), (13.3, 0.0), (15.0, -1.0), (16.05, -6.0), (13.0, -6.0), (13.0, -16.0), (14.5, -18.0),
     (14.5, -40.0), (30.0, -70.0), (30.0, -200.0), (0.0, -200.0)]
)  # fmt: skip
#: The same without the cap.
BARE = np.vstack([1e-3 * np.array([(0.0, -0.5), (12.0, -0.5), (13.0, -1.5)]), CAPPED[5:]])
#: Sensor axes (columns) in the tool: the rod (x of S) points forward, z of S up.
ROTATION_TOOL_SENSOR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class OpenerBeam:
    """The rod that carries the opener: thicker than that of Sec. 3.6.1, which would yield at 4 N."""

    length_m: float = 0.10
    diameter_m: float = 0.005
    youngs_Pa: float = 206e9
    poisson: float = 0.29
    spring_N_per_m: float = 2000.0  #: along the rod
    spring_Nm_per_rad: float = 2.0  #: about the rod

    @property
    def compliance_tool(self) -> Float[np.ndarray, "6 6"]:
        """Motion (d [m], rotation [rad]) of the tip per wrench (N, Nm) there, axes of the tool.

        A cantilever: a force deflects by L^3/3EI and rotates by L^2/2EI, a moment
        deflects by L^2/2EI and rotates by L/EI. Along and about the rod the springs deform.
        """
        length, ei = self.length_m, self.youngs_Pa * math.pi * self.diameter_m**4 / 64
        c = np.zeros((6, 6))
        c[0, 0] = c[2, 2] = length**3 / (3 * ei)
        c[3, 3] = c[5, 5] = length / ei
        half = length**2 / (2 * ei)
        # Up (z) at the tip of a rod along y turns it about +x; aside (x) about -z.
        c[2, 3] = c[3, 2] = half
        c[0, 5] = c[5, 0] = -half
        c[1, 1] = 1 / self.spring_N_per_m
        c[4, 4] = 1 / self.spring_Nm_per_rad + length * (1 + self.poisson) / ei
        return c


@dataclass(frozen=True, slots=True)
class Opener:
    """Shape of the opener in the tool frame."""

    bridge_half_m: float = 0.015  #: half width of the arch
    arch_radius_m: float = 0.028  #: the arch drops by x^2 / (2 R) to the sides
    hook_behind_m: float = 0.015  #: from the bridge back to the tip of the hook
    #: from the bridge down to the hook's upper edge; the arch stands 3 mm above the cap it bears on
    hook_below_m: float = 0.0112
    hook_half_m: float = 0.005  #: half width of the hook
    bridge_N_per_m: float = 1e6  #: contact stiffness of the bridge on the cap
    rim_N_per_m: float = 6e4  #: stiffness of the rim when it is lifted

    def points(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
        """Points on its edges, stiffness of each [N/m], and which of them are the hook's."""
        x = np.linspace(-self.bridge_half_m, self.bridge_half_m, 31)
        bridge = np.column_stack([x, np.zeros_like(x), -(x**2) / (2 * self.arch_radius_m)])
        x = np.linspace(-self.hook_half_m, self.hook_half_m, 7)
        # The hook's edge is a small lip: its upper and its lower side.
        lip = np.column_stack([x, np.full_like(x, -self.hook_behind_m), np.full_like(x, -self.hook_below_m)])
        points = np.vstack([bridge, lip, lip - [0.0, 0.0, 0.0015]])
        hook = np.arange(len(points)) >= len(bridge)
        stiffness = np.where(hook, self.rim_N_per_m / len(x), self.bridge_N_per_m / len(bridge))
        return points, stiffness, hook


@dataclass(frozen=True, slots=True, eq=False)
class CapSeen:
    """Observation of the cap by a camera on the tool."""

    t_s: float
    valid: bool
    position_tip_m: Float[np.ndarray, "3"]  #: of the top's centre, in the tip frame; NaN when not valid
    sigma_m: Float[np.ndarray, "3"]  #: standard deviations along the tip's axes


@dataclass
class CrownCapCell(BlankFrames):
    """Arm, opener, bottle and camera; a ``robots.FrameSource`` whose every frame advances the simulation.

    Frames contain no useful image: :meth:`feel` and :meth:`look`
    return the readings of the newest frame.
    """

    arm: SimulatedArm
    position_base_m: Float[np.ndarray, "3"]  #: of the centre of the cap's top
    rng: np.random.Generator
    opener: Opener = field(default_factory=Opener)
    beam: OpenerBeam = field(default_factory=OpenerBeam)
    open_N: float = 85.0  #: pull of the hook at which the cap is removed
    #: standard deviations of force [N] and moment [Nm] that the sensor reads, axes of the tool
    wrench_sigma: tuple[float, ...] = (0.05, 0.05, 0.25, 0.01, 0.002, 0.01)
    wrench_gain: float = 1.0  #: systematic error of the sensor
    #: error of the cap's observed position from afar and from nearby [m], in the base
    far_error_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near_error_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near_m: float = 0.25  #: distance at which the tracker is accurate
    sight_m: float = 0.45  #: maximum distance at which the cap is detected
    picture_sigma_m: float = 0.0005  #: noise of every observation
    frame_rate_Hz: float = 30.0
    duration_s: float = math.inf

    def __post_init__(self) -> None:
        self.position_base_m = finite_array("CrownCapCell", self.position_base_m, 3)
        self.opened = False
        self.deflection = np.zeros(6)  #: of the tip against the arm, axes of the tool [m, rad]
        self.wrench_tool = np.zeros(6)  #: on the tool about its tip, axes of the tool [N, Nm]
        self._stiff = np.linalg.inv(self.beam.compliance_tool)
        self._points, self._k, self._is_hook = self.opener.points()

    def advance(self, dt_s: float) -> float:
        """Advance the simulation; returns the new time [s]."""
        for _ in range(2):
            self.arm.advance(0.5 * dt_s)
            self._balance()
        return self.arm.t_s

    def feel(self, frame: Frame) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 6"]]:
        """Wrench (N, Nm) measured by a beam sensor, axes of the tool, and its covariance.

        Parameters
        ----------
        frame
            Newest frame.
        """
        sigma = np.array(self.wrench_sigma)
        return self.wrench_gain * self.wrench_tool + sigma * self.rng.standard_normal(6), np.diag(sigma**2)

    def look(self, frame: Frame) -> CapSeen:
        """Measured pose of the cap in the view of the camera on the tool; invalid after the cap is removed.

        Parameters
        ----------
        frame
            Newest frame.
        """
        tip = self.arm.true_pose()
        way = self.position_base_m - tip.translation_m
        far = float(np.linalg.norm(way))
        sigma = np.full(3, self.picture_sigma_m)
        # The camera looks down from the tool; at very short distance the opener hides the cap.
        if self.opened or far > self.sight_m or way[2] > -0.008:
            return CapSeen(frame.t_s, False, np.full(3, math.nan), np.full(3, math.inf))
        wrong = np.array(self.near_error_m if far < self.near_m else self.far_error_m)
        noisy = way + wrong + sigma * self.rng.standard_normal(3)
        return CapSeen(frame.t_s, True, tip.rotation.T @ noisy, sigma)

    def _balance(self) -> None:
        """Deflection at which beam and contact forces are in equilibrium, by Newton's method."""
        tip = self.arm.true_pose()
        q = self.deflection.copy()
        wrench, hook, pull = self._contact(tip, q)
        rest = self._stiff @ q - wrench
        for _ in range(40):
            error = float(np.abs(rest[:3]).max() + 50 * np.abs(rest[3:]).max())
            if error < 1e-4:
                break
            step = np.linalg.solve(self._stiff + hook, -rest)
            # A contact that opens or closes changes the gradient: then use shorter steps.
            for fraction in (1.0, 0.5, 0.2, 0.05):
                trial = q + fraction * step
                wrench, more, pull_now = self._contact(tip, trial)
                left = self._stiff @ trial - wrench
                if float(np.abs(left[:3]).max() + 50 * np.abs(left[3:]).max()) < error:
                    break
            q, rest, hook, pull = trial, left, more, pull_now
        self.deflection, self.wrench_tool = q, self._stiff @ q
        if not self.opened and pull > self.open_N:
            self.opened = True
            self._balance()

    def _contact(
        self, tip: Pose, q: Float[np.ndarray, "6"]
    ) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 6"], float]:
        """Wrench of the cap on the tool, its gradient, and the pull of the hook on the rim [N]."""
        turn = Pose.from_rotation_vector(q[3:], np.zeros(3)).rotation
        arms = self._points @ turn.T
        places = (arms + q[:3]) @ tip.rotation.T + tip.translation_m - self.position_base_m
        r = np.hypot(places[:, 0], places[:, 1])
        depth, normal = _inside(BARE if self.opened else CAPPED, r, places[:, 2])
        touching = depth > 0
        if not touching.any():
            return np.zeros(6), np.zeros((6, 6)), 0.0
        around = places[touching, :2] / np.maximum(r[touching, None], 1e-9)
        outward = np.column_stack([around * normal[touching, :1], normal[touching, 1]])
        force = self._k[touching] * depth[touching]
        # The pull on the rim is the upward force of the hook below it.
        pull = float(-(force * outward[:, 2])[self._is_hook[touching] & (outward[:, 2] < 0)].sum())
        inner = outward @ tip.rotation  # to the axes of the tool
        g = np.hstack([inner, np.cross(arms[touching], inner)])
        return g.T @ force, (g * self._k[touching, None]).T @ g, pull


def _inside(
    outline_m: Float[np.ndarray, "m 2"], r_m: Float[np.ndarray, "n"], z_m: Float[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"]]:
    """Depth of points (r, z) below a solid's surface (0 outside) and the exit direction, a unit vector (r, z)."""
    # The axis r = 0 is not a surface: its edge is omitted.
    a, b = outline_m[:-1], outline_m[1:]
    points = np.column_stack([r_m, z_m])
    along = b - a
    fraction = ((points[:, None] - a) * along).sum(-1) / (along**2).sum(-1)
    nearest = a + np.clip(fraction, 0, 1)[..., None] * along
    away = nearest - points[:, None]
    distance = np.hypot(away[..., 0], away[..., 1])
    best = distance.argmin(axis=1)
    rows = np.arange(len(points))
    # Even-odd rule with a ray in +r over the whole outline.
    c, d = outline_m, np.roll(outline_m, -1, axis=0)
    spans = (c[:, 1] > z_m[:, None]) != (d[:, 1] > z_m[:, None])
    rise = np.where(d[:, 1] == c[:, 1], 1.0, d[:, 1] - c[:, 1])
    at = c[:, 0] + (z_m[:, None] - c[:, 1]) / rise * (d[:, 0] - c[:, 0])
    inside = ((spans & (r_m[:, None] < at)).sum(axis=1) % 2).astype(bool)
    depth = np.where(inside, distance[rows, best], 0.0)
    normal = away[rows, best] / np.maximum(distance[rows, best], 1e-12)[:, None]
    return depth, normal
