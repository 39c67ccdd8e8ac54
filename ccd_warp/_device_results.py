"""What launches on a device return: arrays that later launches overwrite, and copies of them on the host."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._contacts import Contact, Contacts, Placed, first_contacts, outcome
from ccd_warp._display import counted
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._status import LaunchFlag, PairKind


@dataclass(frozen=True, repr=False, eq=False)
class DeviceContacts(Placed):
    """Contacts on a device, in arbitrary order, in arrays of fixed capacity; the fields are those of :class:`Contacts`.

    What is beside the fields is computed on the device when it is asked for: each time anew, in the same array, by a
    launch that does not wait, and from what the arrays hold by then. The first time allocates the array; after that a
    graph can hold it. Rows from ``count`` on mean nothing.

    Attributes:
        count: Number of contacts found, which may exceed the capacity; contacts beyond it are not stored; int32, shape
            [1].
        kind: int32, shape [max_contacts], as for all that follow.
        primitives: vec2i.
        toi: float64.
        parameters: vec2d.
        normal: vec3d, as in :class:`Contacts`; of a mesh in the plane z is 0.
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

    @property
    def points(self) -> wp.array:
        """Position of each contact at its toi, as in :class:`Contacts`, vec3d, shape [max_contacts].

        Of a mesh in the plane z is 0. The step is what the arrays of the last launch hold when the device gets there.
        Points agree in every bit with those of :meth:`to_host`; where the arrays have changed since the launch, they
        are those of another step.

        Raises:
            ValueError: If there was no launch, so that no positions are known.
            RuntimeError: If a graph is being captured, and the points were not asked for before.
        """
        return self._known().contact_points()

    @property
    def vertices(self) -> wp.array:
        """Vertices of each contact, as in :class:`Contacts`, vec4i, shape [max_contacts]."""
        return self._known().contact_arrays.vertices()

    @property
    def bodies(self) -> wp.array:
        """Bodies of the first and the second primitive of each contact, vec2i, shape [max_contacts]."""
        return self._known().contact_arrays.bodies()

    @property
    def world(self) -> wp.array:
        """World of each contact, int32, shape [max_contacts]."""
        return self._known().contact_arrays.world()

    def points_at(self, vertices_t0: Any, vertices_t1: Any) -> wp.array:
        """Position of each contact at its toi in a step between given positions.

        Args:
            vertices_t0: Start positions on the device, one row for each vertex, as
                :meth:`ccd_warp.CollisionPipeline.launch` takes them.
            vertices_t1: End positions of the same type; or rows of the moving vertices only. Static bodies stay at
                their start positions.

        Returns:
            The positions, vec3d, shape [max_contacts]; the same array for all positions of one dtype.

        Raises:
            ValueError: If an array is not as described.
            RuntimeError: If a graph is being captured and there was no earlier call with arrays of this dtype.
        """
        return self._known().contact_points_at(vertices_t0, vertices_t1)

    def order_by_toi(self) -> wp.array:
        """Indices of the contacts by ascending toi, those with one toi in the order of :class:`Contacts`.

        Returns:
            The indices, int32, shape [max_contacts]. Those of the contacts come first, the earliest at the front, and
            then those of the rows without one.

        Raises:
            RuntimeError: If a graph is being captured and there was no earlier call.
        """
        return self._known().contact_arrays.order_by_toi()

    def _known(self) -> Any:
        """The step to which the contacts belong, or a ValueError."""
        if self._place is None:
            raise ValueError("contacts were made of arrays alone; expected those of a launch, which knows its mesh")
        return self._place

    def to_host(self, vertices_t0: ArrayLike | None = None, vertices_t1: ArrayLike | None = None) -> Contacts:
        """The contacts as NumPy arrays in the order of :class:`Contacts`; this waits for the device.

        Args:
            vertices_t0: Start positions, for ``points``, as :func:`ccd_warp.mesh_ccd` takes them. By default what the
                arrays of the last launch hold now.
            vertices_t1: End positions, of the same shape; both are given or neither is.

        Returns:
            The contacts, with their points, vertices, bodies and worlds.

        Raises:
            ValueError: If one of the positions is given without the other, or they do not match the mesh.
        """
        if (vertices_t0 is None) != (vertices_t1 is None):
            missing = "vertices_t0" if vertices_t0 is None else "vertices_t1"
            raise ValueError(f"{missing} is None; expected both vertices_t0 and vertices_t1, or neither")
        count = min(int(self.count.numpy()[0]), len(self.kind))
        host = {name: array.numpy()[:count] for name, array in vars(self).items() if name != "count"}
        order = np.lexsort((host["primitives"][:, 1], host["primitives"][:, 0], host["kind"]))
        contacts = Contacts(**{name: values[order] for name, values in host.items()})
        return contacts if self._place is None else self._place.locate(contacts, vertices_t0, vertices_t1)

    def __repr__(self) -> str:
        return f"DeviceContacts(up to {len(self.kind):,} contacts on {self.kind.device}; to_host() reads them)"

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled: the arrays are on a device, and launches go on writing to them."""
        raise TypeError("DeviceContacts cannot be copied or pickled; copy or pickle what to_host() returns")


@dataclass(frozen=True, repr=False, eq=False)
class HostLaunchResult:
    """What the arrays of a :class:`LaunchResult` held when they were read: NumPy arrays and numbers.

    Attributes:
        toi: Earliest time of impact of the scene in [0, t_max]; inf if there is certainly none.
        world_toi: Earliest toi of each world, float64, shape [W].
        body_toi: Earliest toi of each body, float64, shape [B].
        vertex_toi: Earliest toi of each vertex, float64, shape [V].
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
        return f"HostLaunchResult({outcome(self.toi, self.world_toi, self.contacts)}{flags})"

    def _repr_html_(self) -> str:
        return self.contacts._table(repr(self))


@dataclass(frozen=True, repr=False)
class LaunchResult:
    """The Warp arrays to which :meth:`ccd_warp.CollisionPipeline.launch` writes, the same ones each time.

    The result keeps everything alive that a captured graph uses, so keep it as long as the graph.

    Attributes:
        toi: Earliest time of impact of the scene in [0, t_max]; inf if there is certainly none; float64, shape [1].
        world_toi: Earliest toi of each world, float64, shape [W]; with a single world the array ``toi`` itself.
        body_toi: Earliest toi of each body, float64, shape [B].
        vertex_toi: Earliest toi of each vertex, float64, shape [V].
        contacts: Every pair with a finite toi, up to the capacity.
        flags: :class:`ccd_warp.LaunchFlag` of the scene, int32, shape [1].
        world_flags: Flags of each world, int32, shape [W]; with a single world the array ``flags`` itself.
        num_pairs: Number of pairs of each :class:`ccd_warp.PairKind` that the cull left, including those beyond the
            capacity, int64, shape [5].
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
            vertices_t1: End positions, of the same shape; both are given or neither is.

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
