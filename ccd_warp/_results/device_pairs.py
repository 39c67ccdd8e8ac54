"""Tables of pairs on a device: arrays that later launches overwrite, and copies of them on the host."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._results.contacts import Contacts
from ccd_warp._results.pairs import PairTable
from ccd_warp._results.placed import Placed
from ccd_warp._scene.input.interop import DeviceArray


class OnDevice:
    """Arrays to which launches go on writing, so that nobody can have a copy of them."""

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled."""
        name = type(self).__name__
        raise TypeError(f"{name} cannot be copied or pickled; copy or pickle what to_host() returns")


class DevicePairs(OnDevice, Placed):
    """The twin of a table of pairs: arrays of fixed capacity, and the number of rows that mean anything."""

    count: wp.array
    kind: wp.array
    primitives: wp.array

    @property
    def vertices(self) -> wp.array:
        """Vertices of each pair, as in :class:`ccd_warp.Contacts`, vec4i, shape [max_contacts]."""
        return self._known_step().contact_arrays.vertices()

    @property
    def weights(self) -> wp.array:
        """Weights of the four ``vertices`` in the difference of the closest points, vec4d, shape [max_contacts].

        As in :class:`ccd_warp.Contacts`: a force of magnitude f that pushes the two apart is f times the weight times
        ``normal`` on each vertex.
        """
        return self._known_step().contact_arrays.weights()

    @property
    def bodies(self) -> wp.array:
        """Bodies of the first and the second primitive of each pair, vec2i, shape [max_contacts]."""
        return self._known_step().contact_arrays.bodies()

    @property
    def world(self) -> wp.array:
        """World of each pair, int32, shape [max_contacts]."""
        return self._known_step().contact_arrays.world()

    def _known_step(self) -> Any:
        """The step to which the pairs belong, or a ValueError."""
        if self._place is None:
            raise ValueError("contacts were made of arrays alone; expected those of a launch, which knows its mesh")
        return self._place

    def _rows(self, table: type[PairTable]) -> dict[str, NDArray[Any]]:
        """The columns of the twin on the host, in the order that it has there; this waits for the device."""
        count = min(int(self.count.numpy()[0]), len(self.kind))
        names = table.__dataclass_fields__.keys() & vars(self).keys()
        some = slice(count or 1)  # an array of Warp has at least one
        host = {name: getattr(self, name)[some].numpy()[:count] for name in names}
        order = np.lexsort((host["primitives"][:, 1], host["primitives"][:, 0], host["kind"]))
        return {name: values[order] for name, values in host.items()}

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"{name}(up to {len(self.kind):,} pairs on {self.kind.device}; to_host() reads them)"


@dataclass(frozen=True, repr=False, eq=False)
class DeviceContacts(DevicePairs):
    """Contacts on a device, in arbitrary order, in arrays of fixed capacity; the fields are those of :class:`Contacts`.

    What is no field is computed on the device when it is asked for: each time anew, in the same array, by a
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
        return self._known_step().contact_points()

    def points_at(self, vertices_t0: DeviceArray, vertices_t1: DeviceArray) -> wp.array:
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
        return self._known_step().contact_points_at(vertices_t0, vertices_t1)

    def to_host(self, vertices_t0: ArrayLike | None = None, vertices_t1: ArrayLike | None = None) -> Contacts:
        """The contacts as NumPy arrays in the order of :class:`Contacts`; this waits for the device.

        Args:
            vertices_t0: Start positions, for the points of the contacts, as :func:`ccd_warp.mesh_ccd` takes them. By
                default what the arrays of the last launch hold now; give them if these have changed since.
            vertices_t1: End positions, of the same shape; both are given or neither is.

        Returns:
            The contacts, with their points, vertices, bodies and worlds.

        Raises:
            ValueError: If one of the positions is given without the other, or they do not match the mesh.
        """
        if (vertices_t0 is None) != (vertices_t1 is None):
            missing = "vertices_t0" if vertices_t0 is None else "vertices_t1"
            raise ValueError(f"{missing} is None; expected both vertices_t0 and vertices_t1, or neither")
        contacts = Contacts(**self._rows(Contacts))
        return contacts if self._place is None else self._place.locate(contacts, vertices_t0, vertices_t1)
