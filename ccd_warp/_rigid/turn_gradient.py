"""How times of impact change with the poses and twists of rigid bodies, from how they change with points on them.

At the time t a point of a body is at pivot(t) + R(t) (X − c), with R(t) = Rot(t ω) R0. Moves of the rotations R0 and R1
by small vectors φ0 and φ1, in the frame of the world, change ω by

    δω = J⁻¹(ω) φ1 − J⁻¹(−ω) φ0,    J(ω) x = x + σ2 ω × x + σ3 ω × (ω × x),

with σ2 = (1 − cos θ)/θ², σ3 = (θ − sin θ)/θ³, θ = |ω|, and R(t) by t J(t ω) δω + Rot(t ω) φ0. What a point adds to the
gradient goes the same way back: the transposed of J(ω) is J(−ω).

References:
    Barfoot, "State estimation for robotics" (2017), section 7.1: the Jacobians of rotations and their inverses.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.body_paths import BodyPaths
from ccd_warp._rigid.rotations import arc_factors, arcs, cross, norms, products, rotated

_SMALL = 2.0**-6  # angle below which σ3 and its like are summed as series, to rounding

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TurningPoints:
    """The points of contacts that are on rigid bodies: a body at most on each side of a contact.

    Attributes:
        num_bodies: How many bodies the motion has, in all worlds.
        rows: The row of the motion of the body on each side, int, shape [n, 2]; -1 where it is not rigid.
        points: Points in the frames of the bodies, shape [n, 4, 3].
        side: The side of each of the four points, shape [n, 4].
        gradient: d toi / d place of each point at toi, shape [n, 4, 3].
        time: The time of impact, shape [n].
    """

    num_bodies: int
    rows: NDArray[np.intp]
    points: Array
    side: NDArray[np.intp]
    gradient: Array
    time: Array

    def by_poses(self, paths: BodyPaths, rotation_t1: Array) -> tuple[Array, Array]:
        """Gradients by the poses at both ends of the bodies on both sides, shape [n, 2, 7] each.

        The quaternions at the end are given, as of the two of a rotation either may be the one of the pose.
        """
        start, end = (np.zeros((*self.rows.shape, 7)) for _ in range(2))
        for side in range(2):
            contacts, of, t, force, moment = self._on_side(paths, side)
            of_turn = t * _jacobian(-t * of.omega, moment)
            pivot_t0 = rotated(of.rotation, of.pivot)
            pivot_t1 = pivot_t0 + arcs(of.omega, pivot_t0, np.ones(len(t)))
            of_start = _turned_back(of.omega, t, moment) - _inverse_jacobian(of.omega, of_turn)
            of_start += cross(pivot_t0, (1.0 - t) * force)
            of_end = _inverse_jacobian(-of.omega, of_turn) + cross(pivot_t1, t * force)
            start[contacts, side] = _of_pose((1.0 - t) * force, of_start, of.rotation)
            end[contacts, side] = _of_pose(t * force, of_end, rotation_t1[self.rows[contacts, side]])
        return start, end

    def by_twist(self, paths: BodyPaths) -> tuple[Array, Array]:
        """Gradients by the poses at the start, shape [n, 2, 7], and by the twists, shape [n, 2, 6]."""
        start, twist = np.zeros((*self.rows.shape, 7)), np.zeros((*self.rows.shape, 6))
        for side in range(2):
            contacts, of, t, force, moment = self._on_side(paths, side)
            of_start = _turned_back(of.omega, t, moment) + cross(rotated(of.rotation, of.pivot), force)
            start[contacts, side] = _of_pose(force, of_start, of.rotation)
            twist[contacts, side] = np.hstack([t * force, t * _jacobian(-t * of.omega, moment)])
        return start, twist

    def _on_side(self, paths: BodyPaths, side: int) -> tuple[NDArray[np.intp], BodyPaths, Array, Array, Array]:
        """Contacts with a rigid body on a side, its path, the time, and force and moment of the points about its pivot.

        "Force" is what the gradients of the points add up to, "moment" the sum of arm × gradient.
        """
        contacts = np.flatnonzero(self.rows[:, side] >= 0)
        of, t = paths.rows(self.rows[contacts, side]), self.time[contacts]
        force, moment = np.zeros((len(contacts), 3)), np.zeros((len(contacts), 3))
        for k in range(4):
            gradient = np.where((self.side[contacts, k] == side)[:, None], self.gradient[contacts, k], 0.0)
            arms = rotated(of.rotation, self.points[contacts, k] - of.pivot)
            force += gradient
            moment += cross(arms + arcs(of.omega, arms, t), gradient)
        return contacts, of, t[:, None], force, moment


def _of_pose(force: Array, moment: Array, quaternions: Array) -> Array:
    """The gradient by position and unit quaternion; a quaternion q moved by φ is q + (φ, 0) q / 2."""
    return np.hstack([force, 2.0 * products(np.hstack([moment, np.zeros((len(moment), 1))]), quaternions)])


def _turned_back(omega: Array, t: Array, vectors: Array) -> Array:
    """Rot(-t ω) times vectors."""
    return vectors + arcs(-omega, vectors, t[:, 0])


def _jacobian(omega: Array, vectors: Array) -> Array:
    """J(ω) times vectors."""
    angles = norms(omega)[:, None]
    second = arc_factors(omega, np.ones(len(omega)))[1]
    is_small = angles < _SMALL
    large = np.where(is_small, 1.0, angles)
    square = angles * angles
    series = 1.0 / 6.0 - square / 120.0 + square * square / 5040.0 - square * square * square / 362880.0
    third = np.where(is_small, series, (large - np.sin(large)) / large**3)
    across = cross(omega, vectors)
    return vectors + second * across + third * cross(omega, across)


def _inverse_jacobian(omega: Array, vectors: Array) -> Array:
    """J⁻¹(ω) times vectors, for turns of less than 2π."""
    angles = norms(omega)[:, None]
    is_small = angles < _SMALL
    half = 0.5 * np.where(is_small, 1.0, angles)
    square = angles * angles
    series = 1.0 / 12.0 + square / 720.0 + square * square / 30240.0 + square * square * square / 1209600.0
    factor = np.where(is_small, series, (1.0 - half / np.tan(half)) / (4.0 * half * half))
    across = cross(omega, vectors)
    return vectors - 0.5 * across + factor * cross(omega, across)
