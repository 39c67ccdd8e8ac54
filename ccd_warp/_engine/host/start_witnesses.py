"""Pairs that show that the toi of a step is 0, before it is searched, where nothing may start within its distance."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.mesh.scene import length_scale_of, norm_of
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.pairs import pair_vertices, radii_of_pairs
from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh

# Pairs that are kept: one suffices as long as it stays within its distance.
_MOST = 8
# What is added to a gap before it is compared, shares of itself and of the size of its pair, and a length whose square
# does not underflow: far more than rounding takes.
_OF_GAP, _OF_SIZE, _LENGTH = 2.0**-20, 2.0**-40, 2.0**-500


class StartWitnesses:
    """Pairs with toi 0 of an earlier step of a mesh that are far within their distances.

    A toi is never later than the time at which two points of a pair are within its distance. So as long as two points
    of one of these pairs are, the least toi of a step is 0, and need not be searched for.
    """

    def __init__(self) -> None:
        self._options: Options | None = None
        self._pairs: _Pairs | None = None

    def note(self, mesh: CollisionMesh, options: Options, start: NDArray[np.float64], contacts: Contacts) -> None:
        """Keep those of the contacts of a step, none with a plane, that are farthest within their distances."""
        shares = _Pairs.of(mesh, options, contacts).shares(start)
        self._options, self._pairs = options, _Pairs.of(mesh, options, contacts[np.argsort(shares)[:_MOST]])

    def are_within(self, options: Options, start: NDArray[np.float64]) -> bool:
        """Whether one is certain to start within its distance; not if the options are others, as pairs may be."""
        if self._pairs is None or self._options != options:
            return False
        return bool((self._pairs.shares(start) < 1.0).any())


class _Pairs(NamedTuple):
    """Pairs with what positions do not change.

    Attributes:
        vertices: Their vertices, shape [m, 4].
        weights: The weights of these in the difference of two points of a pair, shape [m, 4].
        kept: The distance that each is to keep, shape [m].
        is_ball: Whether it is Euclidean.
    """

    vertices: NDArray[np.int32]
    weights: NDArray[np.float64]
    kept: NDArray[np.float64]
    is_ball: bool

    @classmethod
    def of(cls, mesh: CollisionMesh, options: Options, contacts: Contacts) -> "_Pairs":
        """Those of contacts."""
        vertices = pair_vertices(mesh, contacts)
        kept = np.full(len(contacts), options.separation(length_scale_of(mesh, options)))
        if mesh.radius is not None:
            with np.errstate(all="ignore"):
                kept += radii_of_pairs(contacts.kind, vertices, mesh.radius, mesh.radius).sum(axis=1)
        return cls(vertices, _weights(contacts), kept, norm_of(mesh, options).is_ball)

    def shares(self, start: NDArray[np.float64]) -> NDArray[np.float64]:
        """An upper bound of the distance of each pair, as a share of that which it is to keep; shape [m]."""
        with np.errstate(all="ignore"):
            corners = start[self.vertices]
            corners -= corners[:, :1].copy()  # differences come first: the distance from the origin does not matter
            size = np.abs(corners).max(axis=(1, 2), initial=0.0)
            difference = (self.weights[:, :, None] * corners).sum(axis=1)
            if self.is_ball:
                gap = np.linalg.norm(difference, axis=1)
            else:
                gap = np.abs(difference).max(axis=1, initial=0.0)
            shares: NDArray[np.float64] = ((1.0 + _OF_GAP) * gap + _OF_SIZE * size + _LENGTH) / self.kept
        return shares


def _weights(pairs: Contacts) -> NDArray[np.float64]:
    """Weights of the four vertices of each pair in the difference of two of its points, shape [m, 4].

    Whatever the parameters are, these are points of its primitives.
    """
    u = pairs.parameters[:, 0].clip(0.0, 1.0)
    v = np.minimum(pairs.parameters[:, 1].clip(0.0, 1.0), np.where(pairs.kind == PairKind.VERTEX_FACE, 1.0 - u, 1.0))
    none, one = np.zeros_like(u), np.ones_like(u)
    weights = {
        PairKind.VERTEX_FACE: (one, u + v - 1.0, -u, -v),
        PairKind.EDGE_EDGE: (1.0 - u, u, v - 1.0, -v),
        PairKind.POINT_SEGMENT: (one, none, u - 1.0, -u),
        PairKind.POINT_POINT: (one, none, -one, none),
    }
    of_pairs = [np.stack(of_kind, axis=1) for of_kind in weights.values()]
    return np.select([(pairs.kind == kind)[:, None] for kind in weights], of_pairs)
