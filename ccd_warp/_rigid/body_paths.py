"""The paths of rigid bodies in a step: a straight line of the pivot, a turn at constant speed about it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.rotations import arc_factors, arcs, cross, normalized, norms, rotated, rotation_vectors
from ccd_warp._runtime.read_only import ReadOnly

# A length that no sum with coordinates shows.
UNSEEN = 2.0**-1000
# What the sum of an excess and of rounding errors loses, and the largest excess.
_EXCESS_UP, _LARGEST = 1.0 + 2.0**-40, float(np.finfo(np.float64).max)


@dataclass(frozen=True, eq=False, repr=False)
class BodyPaths(ReadOnly):
    """How each body moves from t = 0 to t = 1: one row a body, those of one world after those of another.

    A point X of the body's frame is at

        x(t) = pivot_t0 + velocity t + Rot(t omega) R0 (X − pivot) + σ1(t) turning + σ2(t) omega × turning,

    with R0 the rotation at t = 0, θ = |omega|, σ1(t) = sin(θt)/θ and σ2(t) = (1 − cos(θt))/θ², or their limits t and
    t²/2 where θ = 0. With the path "linear" ``turning`` is 0. With "screw" the pivot is the body's origin, ``velocity``
    its velocity along omega, and ``turning`` what is across it, which turns with the body.

    Each field is rounded to float64. With eps = 2**-52, d the displacement of the body's origin in the step, p its
    place at t = 0 and θ no more than π its error is, in Euclidean length, at most

    ========  ======================================================================================
    rotation  2 eps; the quaternions are those given, normalised in exact arithmetic
    omega     4 eps θ, however small θ is; 0 where a twist gives it
    pivot     0
    pivot_t0  eps |p| + 8 eps |pivot|; 0 with "screw"
    velocity  "linear": 2 eps |d| + 16 eps min(θ, 2) |pivot|, or 0 where a twist gives it;
              "screw": 8 eps |d|, or 8 eps of the linear part of a twist
    turning   16 eps |d|, or 8 eps of the linear part of a twist; what it and omega lead to at t = 1,
              σ1(1) turning + σ2(1) omega × turning, is the part of d across omega to 8 eps |d|
    ========  ======================================================================================

    Attributes:
        rotation: Unit quaternion x y z w of the body at t = 0, float64, shape [N, 4].
        omega: Rotation vector of the whole step in the frame of the world, radians, shape [N, 3]; several turns where
            it is longer than 2π.
        pivot: The point about which the body turns, in its own frame, shape [N, 3].
        pivot_t0: Its place in the world at t = 0, shape [N, 3].
        velocity: Its straight displacement in the step, shape [N, 3].
        turning: The part of the velocity of the body's origin that turns with it, shape [N, 3].
        excess: How far points of the body may be from this path at any time, a length, shape [N].
    """

    rotation: NDArray[np.float64]
    omega: NDArray[np.float64]
    pivot: NDArray[np.float64]
    pivot_t0: NDArray[np.float64]
    velocity: NDArray[np.float64]
    turning: NDArray[np.float64]
    excess: NDArray[np.float64]

    def __post_init__(self) -> None:
        self.__setstate__(vars(self))

    def __len__(self) -> int:
        return len(self.omega)

    def __repr__(self) -> str:
        return f"BodyPaths({len(self)})"

    @classmethod
    def between(
        cls, poses_t0: NDArray[np.float64], poses_t1: NDArray[np.float64], pivot: NDArray[np.float64] | None
    ) -> BodyPaths:
        """The paths with the shortest turn between poses, quaternions scaled, shape [N, 7] each.

        Args:
            poses_t0: Positions and quaternions x y z w at t = 0.
            poses_t1: Those at t = 1.
            pivot: Pivots of linear paths, shape [N, 3]; None for screws.
        """
        omega = rotation_vectors(poses_t0[:, 3:], poses_t1[:, 3:])
        displacement = poses_t1[:, :3] - poses_t0[:, :3]
        if pivot is None:
            half = 0.5 * norms(omega)[:, None]
            ratio = np.where(half > 0.0, half / np.tan(np.where(half > 0.0, half, 1.0)), 1.0)
            along, across = _parts(displacement, omega)
            # the inverse of across = σ1(1) turning + σ2(1) omega × turning
            return cls._from(poses_t0, omega, None, along, ratio * across - 0.5 * cross(omega, across))
        arm = rotated(normalized(poses_t0[:, 3:]), pivot)
        return cls._from(poses_t0, omega, pivot, displacement + arcs(omega, arm, np.ones(len(arm))), None)

    @classmethod
    def along(
        cls, poses_t0: NDArray[np.float64], twist: NDArray[np.float64], pivot: NDArray[np.float64] | None
    ) -> BodyPaths:
        """The paths of twists, linear part first, shape [N, 6]; the other arguments are those of :meth:`between`."""
        linear, omega = twist[:, :3], twist[:, 3:].copy()
        if pivot is None:
            return cls._from(poses_t0, omega, None, *_parts(linear, omega))
        return cls._from(poses_t0, omega, pivot, linear.copy(), None)

    @classmethod
    def _from(
        cls,
        poses_t0: NDArray[np.float64],
        omega: NDArray[np.float64],
        pivot: NDArray[np.float64] | None,
        velocity: NDArray[np.float64],
        turning: NDArray[np.float64] | None,
    ) -> BodyPaths:
        rotation, position = normalized(poses_t0[:, 3:]), poses_t0[:, :3]
        pivot_t0 = position.copy() if pivot is None else position + rotated(rotation, pivot)
        none = np.zeros_like(position)
        return cls(
            rotation,
            omega,
            none if pivot is None else pivot.copy(),
            pivot_t0,
            velocity,
            none.copy() if turning is None else turning,
            np.zeros(len(none)),
        )

    @property
    def largest_turn(self) -> float:
        """The largest angle by which a body turns in the step, radians."""
        return float(np.linalg.norm(self.omega, axis=1).max(initial=0.0))

    def rows(self, index: NDArray[np.integer]) -> BodyPaths:
        """The paths of some bodies, or of some of them several times."""
        return BodyPaths(*(getattr(self, field.name)[index] for field in fields(BodyPaths)))

    def within(self, lengths: NDArray[np.float64]) -> Self:
        """The same paths, from which points may be as far as these lengths, shape [N], rounded up."""
        with np.errstate(over="ignore"):
            excess = np.minimum(lengths * _EXCESS_UP, _LARGEST) + 2.0 * UNSEEN
        return replace(self, excess=np.where(lengths > 0.0, excess, 0.0))

    @property
    def moves(self) -> NDArray[np.bool_]:
        """Which bodies move on their paths, shape [N]."""
        moves: NDArray[np.bool_] = np.asarray(np.column_stack([self.omega, self.velocity, self.turning]).any(axis=1))
        return moves

    def seen(self) -> BodyPaths:
        """The same paths, where what stands, and may be off its path, turns with a velocity that its excess covers.

        So no line search takes it for a body that stays.
        """
        stands = (self.excess > 0.0) & ~self.moves
        if not stands.any():
            return self
        turning = self.turning.copy()
        turning[stands, 0] = UNSEEN
        return replace(self, turning=turning)

    def shortened(self, fraction: NDArray[np.float64]) -> Self:
        """The paths up to a fraction of the step for each body, shape [N]."""
        changed = {name: getattr(self, name) * fraction[:, None] for name in ("omega", "velocity", "turning")}
        return replace(self, **changed)

    def positions(
        self, points: NDArray[np.float64], body_of_point: NDArray[np.integer], t: float | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Places in the world of points of the bodies' frames at a time, float64, shape [n, 3].

        Args:
            points: In the bodies' frames, shape [n, 3].
            body_of_point: Row of each point's body, shape [n].
            t: Fraction of the step, one for all or one a point, shape [n].
        """
        rows = np.asarray(body_of_point)
        arms = rotated(self.rotation[rows], np.asarray(points, dtype=np.float64) - self.pivot[rows])
        return self.pivot_t0[rows] + arms + self.displacements(arms, rows, t)

    def displacements(
        self, arms: NDArray[np.float64], rows: NDArray[np.integer], t: float | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """How far points have moved at a time, given their places about the pivot at t = 0, shape [n, 3]."""
        times = np.broadcast_to(np.asarray(t, dtype=np.float64), len(arms))
        omega, turning = self.omega[rows], self.turning[rows]
        first, second = factors = arc_factors(omega, times)
        turned = first * turning + second * cross(omega, turning)
        return self.velocity[rows] * times[:, None] + turned + arcs(omega, arms, times, factors)


def _parts(vectors: NDArray[np.float64], omega: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The parts of vectors along omega and across it; all is along where omega is 0."""
    angles = norms(omega)[:, None]
    axes = omega / np.where(angles > 0.0, angles, 1.0)
    along = np.where(angles > 0.0, axes * (axes * vectors).sum(axis=1, keepdims=True), vectors)
    return along, vectors - along
