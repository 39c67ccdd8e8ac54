"""Results of the mesh functions."""

from dataclasses import dataclass, field, fields
from typing import Any, NoReturn

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._contacts import Contact, Contacts, DeviceContacts
from ccd_warp._display import counted, html_table
from ccd_warp._status import LaunchFlag, PairKind

__all__ = ["Contact", "Contacts", "Counts", "DeviceContacts", "HostLaunchResult", "LaunchResult", "MeshResult"]


@dataclass(frozen=True, repr=False)
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
        for each in fields(self):
            value, name = getattr(self, each.name), each.name.removeprefix("num_").replace("_", " ")
            by_kind = value.items() if isinstance(value, dict) else ()
            rows += [(f"{kind.name.lower().replace('_', '-')} {name}", f"{count:,}") for kind, count in by_kind]
            rows += [] if isinstance(value, dict) else [(name, f"{value:,}")]
        return html_table("Counts", ("", ""), rows)


@dataclass(frozen=True, repr=False)
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

    @property
    def first(self) -> Contact | None:
        """The earliest contact, the first where several have the same toi; None if there is certainly none."""
        return self.contacts._first()

    def __repr__(self) -> str:
        return f"MeshResult({_outcome(self.toi, self.world_toi, self.contacts)})"

    def _repr_html_(self) -> str:
        return self.contacts._repr_html_().replace("<p>Contacts(", f"<p>toi {self.toi!r}, Contacts(", 1)


@dataclass(frozen=True, repr=False, eq=False)
class HostLaunchResult:
    """What the arrays of a :class:`LaunchResult` held when they were read: NumPy arrays and numbers.

    Attributes:
        toi: Earliest time of impact of the scene in [0, t_max]; inf if there is certainly none.
        world_toi: The same for each world, float64, shape [W].
        body_toi: The same for each body, float64, shape [B].
        vertex_toi: The same for each vertex, float64, shape [V].
        contacts: Every pair with a finite toi, up to the capacity, in the order of :class:`Contacts`.
        flags: Flags of the scene.
        world_flags: :class:`ccd_warp.LaunchFlag` of each world, int32, shape [W].
        num_pairs: Number of pairs of each kind that the cull left, including those beyond the capacity.
        num_contacts: Number of contacts found, including those beyond the capacity.
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

    @property
    def hit(self) -> bool:
        """Whether any pair has a finite toi."""
        return bool(np.isfinite(self.toi))

    @property
    def first(self) -> Contact | None:
        """The earliest contact in the list, the first where several have the same toi; None if the list is empty."""
        return self.contacts._first()

    def __repr__(self) -> str:
        flags = "" if not self.flags else f", {self.flags!r}"
        return f"HostLaunchResult({_outcome(self.toi, self.world_toi, self.contacts)}{flags})"

    def _repr_html_(self) -> str:
        return self.contacts._repr_html_().replace("<p>Contacts(", f"<p>toi {self.toi!r}, Contacts(", 1)


@dataclass(frozen=True, repr=False)
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

    def __post_init__(self) -> None:
        """Let the contacts know the step to which they belong."""
        object.__setattr__(self.contacts, "_place", self._step)

    def to_host(self, vertices_t0: ArrayLike | None = None, vertices_t1: ArrayLike | None = None) -> HostLaunchResult:
        """What all arrays hold now, on the host; this waits for the device.

        Args:
            vertices_t0: Start positions, for the points of the contacts, as :func:`ccd_warp.mesh_ccd` takes them. By
                default what the arrays of the last launch hold now; give them if these have changed since.
            vertices_t1: End positions, likewise; both are given or neither is.

        Returns:
            A copy that later launches do not change.

        Raises:
            ValueError: If one of the positions is given without the other, or they do not match the mesh.
        """
        contacts = self.contacts.to_host(vertices_t0, vertices_t1)
        names = ("world_toi", "body_toi", "vertex_toi", "world_flags")
        arrays = {name: getattr(self, name).numpy().copy() for name in names}
        return HostLaunchResult(
            toi=float(self.toi.numpy()[0]),
            contacts=contacts,
            flags=LaunchFlag(int(self.flags.numpy()[0])),
            num_pairs={kind: int(count) for kind, count in zip(PairKind, self.num_pairs.numpy(), strict=True)},
            num_contacts=int(self.contacts.count.numpy()[0]),
            **arrays,
        )

    def __repr__(self) -> str:
        sizes = [counted(len(self.body_toi), "body", "bodies"), f"{len(self.vertex_toi):,} vertices"]
        sizes += [f"{len(self.world_toi):,} worlds"] if len(self.world_toi) > 1 else []
        return f"LaunchResult({', '.join(sizes)}, arrays on {self.toi.device}; to_host() reads them)"

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled: the arrays are on a device, and launches go on writing to them."""
        raise TypeError("a LaunchResult cannot be copied or pickled; copy or pickle what to_host() returns")


def _outcome(toi: float, world_toi: NDArray[np.float64], contacts: Contacts) -> str:
    """The outcome of a step in a line: its toi, in how many worlds, how many contacts, and the first."""
    if not np.isfinite(toi):
        return "toi=inf, no contact"
    parts = [f"toi={toi!r}"]
    if len(world_toi) > 1:
        parts.append(f"{np.isfinite(world_toi).sum():,} of {len(world_toi):,} worlds")
    parts.append(counted(len(contacts), "contact", "contacts"))
    first = contacts._first()
    return ", ".join(parts) + (f", first: {first._described()}" if first else "")
