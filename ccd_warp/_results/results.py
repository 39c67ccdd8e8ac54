"""Results of the mesh functions."""

from collections import Counter
from dataclasses import dataclass, field, fields
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.contacts import Contact, Contacts, Outcome, first_contacts
from ccd_warp._results.intersections import Intersections, crossing_at_start
from ccd_warp._runtime.display import counted, html_table, kind_name, pairs_of_bodies, start_sentence
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import CCDStatus, LaunchFlag, PairKind

__all__ = ["Contact", "Contacts", "Counts", "MeshResult"]

MotionT = TypeVar("MotionT")  # the motion of a call, of which a result keeps what is left


@dataclass(frozen=True, repr=False)
class Counts:
    """Sizes of the scene, and numbers of what each stage of a call processed and found.

    A mapping has an entry for each :class:`ccd_warp.PairKind` to check; point-segment and point-point only of
    a mesh with codimensional points, vertex-plane only of one with half-spaces. The last kind has no cull, and its
    candidates in a step are its contacts.

    Attributes:
        num_bodies: Bodies of the mesh.
        num_vertices: Vertices.
        num_edges: Unique edges.
        num_faces: Faces.
        num_codimensional_edges: Edges that belong to no face.
        num_codimensional_points: Vertices that collide as points.
        num_active_bodies: Bodies that are static or may collide with themselves or with a body whose swept box
            overlaps theirs, half-spaces aside.
        num_boxes: Boxes made; those of static bodies by the call that makes them.
        num_sorted_sets: Sets of primitives that were sorted again.
        num_searches: Launches of the search.
        num_candidates: Pairs whose boxes overlap and that the collision filter does not exclude, in the last search of
            the call.
        num_after_cull: Candidates that the cull left to the narrow phase.
        num_contacts: Pairs that touch.
        num_contacts_at_start: Contacts with the status ``INITIAL_CONTACT``.
        num_contacts_at_limit: Contacts with the status ``ITERATION_LIMIT``, ``RESOLUTION_LIMIT`` or ``ROUNDING_LIMIT``.
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

    def __repr__(self) -> str:
        shown = {
            "candidates": sum(self.num_candidates.values()),
            "after the cull": sum(self.num_after_cull.values()),
            "contacts": sum(self.num_contacts.values()),
        }
        text = ", ".join(f"{count:,} {name}" for name, count in shown.items())
        bodies, vertices = counted(self.num_bodies, "body", "bodies"), f"{self.num_vertices:,} vertices"
        return f"Counts({bodies}, {vertices}, {self.num_edges:,} edges, {self.num_faces:,} faces; {text})"

    def _repr_html_(self) -> str:
        rows: list[tuple[str, str]] = []
        for entry in fields(self):
            value, name = getattr(self, entry.name), entry.name.removeprefix("num_").replace("_", " ")
            by_kind = value.items() if isinstance(value, dict) else ()
            rows += [(f"{kind_name(kind)} {name}", f"{count:,}") for kind, count in by_kind]
            rows += [] if isinstance(value, dict) else [(name, f"{value:,}")]
        return html_table("Counts", ("", ""), rows)


@dataclass(frozen=True, repr=False)
class MeshResult(Outcome):
    """Result of :func:`ccd_warp.mesh_ccd`.

    Attributes:
        toi: Earliest time of impact of the scene in [0, t_max]; inf if there is certainly none.
        vertex_toi: Earliest toi of the contacts that a vertex is part of, inf if none, float64, shape [V].
        body_toi: Earliest toi of the contacts that a body is part of, inf if none, float64, shape [B].
        contacts: Every pair with a finite toi.
        counts: Sizes of the scene and of each stage's output.
        timings: Seconds of each stage, and their ``total``.
        vertex_contact: Index of the contact that gives the toi of a vertex, the first where several share it, -1 where
            there is none, int32, shape [V].
        body_contact: Index of the contact that gives the toi of a body, -1 where there is none, int32, shape [B].
        world_toi: Earliest toi of each world, inf if none, float64, shape [W]; a mesh without given worlds has one,
            unless its ``motion`` has W. Arrays of vertices and of bodies then have shapes [W, V] and [W, B], and
            contacts are those of one world after those of another.
        world_contact: Index of the contact that gives the toi of a world, as of a vertex, int32, shape [W].
        start: What touches or crosses at the start, exactly, with ``check_start=True``; otherwise None.
        hidden_gaps: Where pairs have the status ``ROUNDING_LIMIT``, a sentence on how many they are and on the vertex
            that is farthest from the others; otherwise empty.
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
    world_contact: NDArray[np.int32]
    start: Intersections | None = None
    hidden_gaps: str = ""

    @property
    def pairs_at_start(self) -> Counter[tuple[str, str]]:
        """Number of pairs in contact at the start already, by the names of their bodies, lower index first.

        These have the status ``INITIAL_CONTACT`` and toi 0. Surfaces that cross at the start are not among them where
        an edge is through the inside of a face; :func:`ccd_warp.find_intersections` has all.
        """
        if self.counts.num_contacts_at_start == 0:
            return Counter()
        at_start = self.contacts.status == int(CCDStatus.INITIAL_CONTACT)
        return pairs_of_bodies(self.contacts._known_place().mesh.names, self.contacts.bodies[at_start])

    def __repr__(self) -> str:
        at_start = start_sentence(self.pairs_at_start)
        at_start = "; ".join(filter(None, [at_start, self.hidden_gaps, crossing_at_start(self.start)]))
        at_start = f";\n{at_start}" if at_start else ""
        return f"MeshResult({self._outcome()}{at_start})"


@dataclass(frozen=True, repr=False, eq=False)
class HostLaunchResult(Outcome, Generic[MotionT]):
    """What the arrays of a :class:`LaunchResult` held when they were read: NumPy arrays and numbers.

    Attributes:
        toi: Earliest time of impact of the scene in [0, t_max]; inf if there is certainly none.
        world_toi: Earliest toi of each world, float64, shape [W].
        body_toi: Earliest toi of each body, float64, shape [B].
        vertex_toi: Earliest toi of each vertex, float64, shape [V].
        contacts: Every pair with a finite toi, up to the capacity, in the order of :class:`Contacts`.
        flags: Flags of the scene.
        world_flags: :class:`ccd_warp.LaunchFlag` of each world, int32, shape [W].
        num_pairs: For each :class:`ccd_warp.PairKind` how many pairs the cull left, those beyond the capacity, too; of
            a line search the most of any pass. What ``max_pairs`` has to hold.
        num_contacts: Number of contacts found, including those beyond the capacity; of a line search the most of any
            pass, while ``contacts`` are those of the last. What ``max_contacts`` has to hold.
        body_fraction: Fraction of its path by which each rigid body goes, float64, shape [B]; None without a motion.
        motion: The :class:`ccd_warp.RigidMotion` up to the end of the step, where one was given; its ``poses_t1`` are
            the poses there.
    """

    toi: float
    world_toi: NDArray[np.float64]
    body_toi: NDArray[np.float64]
    vertex_toi: NDArray[np.float64]
    contacts: Contacts
    flags: LaunchFlag
    world_flags: NDArray[np.int32]
    num_pairs: dict[PairKind, int]
    num_contacts: int
    body_fraction: NDArray[np.float64] | None = None
    motion: MotionT | None = None

    @lazy_property
    def vertex_contact(self) -> NDArray[np.int32]:
        """Index of the contact that gives the toi of each vertex, as in :class:`ccd_warp.MeshResult`, shape [V].

        It is -1 where there is none, and where it was beyond the capacity.
        """
        return first_contacts(self.contacts.toi, self.contacts.vertices, self.vertex_toi)

    @lazy_property
    def body_contact(self) -> NDArray[np.int32]:
        """Index of the contact that gives the toi of a body, the first of several, -1 for none, int32, shape [B]."""
        return first_contacts(self.contacts.toi, self.contacts.bodies, self.body_toi)

    @lazy_property
    def world_contact(self) -> NDArray[np.int32]:
        """Index of the contact that gives the toi of a world, the first of several, -1 for none, int32, shape [W]."""
        return first_contacts(self.contacts.toi, self.contacts.world[:, None], self.world_toi)

    def __repr__(self) -> str:
        flags = "" if not self.flags else f", {self.flags!r}"
        return f"HostLaunchResult({self._outcome()}{flags})"
