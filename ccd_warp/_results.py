"""Results of the mesh functions."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._status import PairKind


@dataclass(frozen=True)
class Contacts:
    """Pairs that touch, ordered by :class:`ccd_warp.PairKind` and then lexicographically by primitives.

    Attributes:
        kind: :class:`ccd_warp.PairKind` of each contact, int32, shape [m].
        primitives: Indices of a vertex and a face, of two edges, of the vertex and the edge of a codimensional point
            and a codimensional edge, or of the vertices of two codimensional points, int32, shape [m, 2].
        toi: Earliest time of impact in [0, t_max], float64, shape [m].
        parameters: (u, v) at toi, as in :class:`ccd_warp.PairResult`, float64, shape [m, 2].
        normal: Unit normal of the contact at toi, from the second primitive towards the side from which the first
            comes; zero where nothing moves and no side defines a direction; float64, shape [m, 3]. A point has no
            sides: there the normal opposes the relative velocity (its component across the segment, if there is one),
            or points along the gap where that velocity is zero.
        status: :class:`ccd_warp.CCDStatus` of each contact, int32, shape [m].
        gap: Upper bound of the gap (L∞) beyond the minimum separation at toi, a length, float64, shape [m].
        width: Width of the time interval left open, 0 except at a limit, as in :class:`ccd_warp.PairResult`, float64,
            shape [m].
    """

    kind: NDArray[np.int32]
    primitives: NDArray[np.int32]
    toi: NDArray[np.float64]
    parameters: NDArray[np.float64]
    normal: NDArray[np.float64]
    status: NDArray[np.int32]
    gap: NDArray[np.float64]
    width: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.toi)


@dataclass(frozen=True)
class Counts:
    """Sizes of the scene, and what a call looked at and found.

    A mapping has an entry for each :class:`ccd_warp.PairKind` that was asked for; point-segment and point-point only of
    a mesh with codimensional points.

    Attributes:
        num_bodies: Bodies of the mesh.
        num_vertices: Vertices.
        num_edges: Unique edges.
        num_faces: Faces.
        num_codimensional_edges: Edges that belong to no face.
        num_codimensional_points: Vertices that collide as points.
        num_active_bodies: Bodies that are static or may collide with themselves or with a body whose swept box meets
            theirs.
        num_boxes: Boxes made; those of static bodies by the call that makes them.
        num_sorted_sets: Sets of primitives that had to be put in another order.
        num_searches: Launches of the search.
        num_candidates: Pairs whose boxes meet and that the mesh lets collide; of a call that searches several times,
            those of the last search.
        num_after_cull: Pairs of these that the cull left to the narrow phase.
        num_contacts: Pairs that touch.
        num_contacts_at_start: Contacts with the status ``INITIAL_CONTACT``.
        num_contacts_at_limit: Contacts with the status ``ITERATION_LIMIT`` or ``RESOLUTION_LIMIT``.
        num_batches: Times that the memory for pairs was filled.
    """

    num_bodies: int = 0
    num_vertices: int = 0
    num_edges: int = 0
    num_faces: int = 0
    num_codimensional_edges: int = 0
    num_codimensional_points: int = 0
    num_active_bodies: int = 0
    num_boxes: int = 0
    num_sorted_sets: int = 0
    num_searches: dict[PairKind, int] = field(default_factory=dict)
    num_candidates: dict[PairKind, int] = field(default_factory=dict)
    num_after_cull: dict[PairKind, int] = field(default_factory=dict)
    num_contacts: dict[PairKind, int] = field(default_factory=dict)
    num_contacts_at_start: int = 0
    num_contacts_at_limit: int = 0
    num_batches: int = 0


@dataclass(frozen=True)
class MeshResult:
    """Result of :func:`ccd_warp.mesh_ccd`.

    Attributes:
        toi: Earliest time of impact of the scene in [0, t_max]; inf if there is certainly none.
        vertex_toi: Earliest toi of the contacts that a vertex is part of, inf if none, float64, shape [V].
        body_toi: The same for each body, float64, shape [B].
        contacts: Every pair with a finite toi.
        counts: Sizes of the scene and of each stage's output.
        timings: Seconds of each stage, and their ``total``.
        vertex_contact: Index of the contact that gives the toi of a vertex, the first where several share it, -1 where
            there is none, int32, shape [V].
        body_contact: The same for each body, int32, shape [B].
        world_toi: Earliest toi of each world, inf if none, float64, shape [W]; a mesh without given worlds has one.
    """

    toi: float
    vertex_toi: NDArray[np.float64]
    body_toi: NDArray[np.float64]
    contacts: Contacts
    counts: Counts
    timings: dict[str, float]
    vertex_contact: NDArray[np.int32]
    body_contact: NDArray[np.int32]
    world_toi: NDArray[np.float64]

    @property
    def hit(self) -> bool:
        """Whether any pair has a finite toi."""
        return bool(np.isfinite(self.toi))


@dataclass(frozen=True)
class DeviceContacts:
    """Contacts on a device, in arbitrary order, in arrays of fixed capacity; the fields are those of :class:`Contacts`.

    Attributes:
        count: Number of contacts found, which may exceed the capacity; contacts beyond it are not stored; int32, shape
            [1].
        kind: int32, shape [max_contacts], as for all that follow.
        primitives: vec2i.
        toi: float64.
        parameters: vec2d.
        normal: vec3d.
        status: int32.
        gap: float64.
        width: float64.
    """

    count: wp.array
    kind: wp.array
    primitives: wp.array
    toi: wp.array
    parameters: wp.array
    normal: wp.array
    status: wp.array
    gap: wp.array
    width: wp.array

    def to_host(self) -> Contacts:
        """The contacts as NumPy arrays in the order of :class:`Contacts`; this waits for the device."""
        count = min(int(self.count.numpy()[0]), len(self.kind))
        host = {name: array.numpy()[:count] for name, array in vars(self).items() if name != "count"}
        order = np.lexsort((host["primitives"][:, 1], host["primitives"][:, 0], host["kind"]))
        return Contacts(**{name: values[order] for name, values in host.items()})


@dataclass(frozen=True)
class LaunchResult:
    """The Warp arrays to which :meth:`ccd_warp.CollisionPipeline.launch` writes, the same ones each time.

    The result keeps everything alive that a captured graph uses, so keep it as long as the graph.

    Attributes:
        toi: Earliest time of impact of the scene in [0, t_max]; inf if there is certainly none; float64, shape [1].
        world_toi: The same for each world, float64, shape [W]; with a single world the array ``toi`` itself.
        body_toi: The same for each body, float64, shape [B].
        vertex_toi: The same for each vertex, float64, shape [V].
        contacts: Every pair with a finite toi, up to the capacity.
        flags: :class:`ccd_warp.LaunchFlag` of the scene, int32, shape [1].
        world_flags: The same for each world, int32, shape [W]; with a single world the array ``flags`` itself.
        num_pairs: Number of pairs of each :class:`ccd_warp.PairKind` that the cull left, including those beyond the
            capacity, int64, shape [4].
    """

    toi: wp.array
    world_toi: wp.array
    body_toi: wp.array
    vertex_toi: wp.array
    contacts: DeviceContacts
    flags: wp.array
    world_flags: wp.array
    num_pairs: wp.array
    _step: Any = field(default=None, repr=False, compare=False)  # keeps alive what a graph that writes here uses
