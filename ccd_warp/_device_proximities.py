"""What launches at one time return: arrays on a device that later launches overwrite, and copies on the host."""

from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._proximities import Proximities


@dataclass(frozen=True, repr=False, eq=False)
class DeviceProximities:
    """The Warp arrays to which :meth:`ccd_warp.CollisionPipeline.launch_proximity` writes, the same ones each time.

    The pairs are in arbitrary order, in arrays of fixed capacity; the fields are those of
    :class:`ccd_warp.Proximities`. Rows from ``count`` on mean nothing. The result keeps everything alive that a
    captured graph uses, so keep it as long as the graph. What is beside the fields is computed as that of
    :class:`ccd_warp.DeviceContacts` is: when it is asked for, each time anew, in the same array.

    Attributes:
        count: Number of pairs within the distance, which may exceed the capacity; int32, shape [1].
        kind: int32, shape [max_contacts], as for all that follow up to ``features``.
        primitives: vec2i.
        parameters: vec2d.
        distance: float64.
        direction: vec3d; of a mesh in the plane z is 0.
        features: int32.
        flags: :class:`ccd_warp.LaunchFlag` of the scene, int32, shape [1]. With ``PAIRS_OVERFLOW`` or
            ``CONTACTS_OVERFLOW`` pairs are missing from the list, with ``INVALID_INPUT`` those of a vertex with a
            coordinate that is not finite.
        world_flags: Flags of each world, int32, shape [W]; with a single world the array ``flags`` itself.
        num_pairs: Number of pairs of each :class:`ccd_warp.PairKind` that the cull left, including those beyond the
            capacity, int64, shape [5].
    """

    count: wp.array
    kind: wp.array
    primitives: wp.array
    parameters: wp.array
    distance: wp.array
    direction: wp.array
    features: wp.array
    flags: wp.array
    world_flags: wp.array
    num_pairs: wp.array
    _step: Any = field(repr=False, compare=False)

    @property
    def vertices(self) -> wp.array:
        """Vertices of each pair, as in :class:`ccd_warp.Proximities`, vec4i, shape [max_contacts]."""
        return self._step.contact_arrays.vertices()

    @property
    def bodies(self) -> wp.array:
        """Bodies of the first and the second primitive of each pair, vec2i, shape [max_contacts]."""
        return self._step.contact_arrays.bodies()

    @property
    def world(self) -> wp.array:
        """World of each pair, int32, shape [max_contacts]."""
        return self._step.contact_arrays.world()

    def to_host(self) -> Proximities:
        """The pairs as NumPy arrays in the order of :class:`ccd_warp.Proximities`; this waits for the device.

        Their points are those of the positions that the array of the last launch holds now.

        Returns:
            A copy that later launches do not change.
        """
        count = min(int(self.count.numpy()[0]), len(self.kind))
        names = ("kind", "primitives", "parameters", "distance", "direction", "features")
        host = {name: getattr(self, name).numpy()[:count] for name in names}
        order = np.lexsort((host["primitives"][:, 1], host["primitives"][:, 0], host["kind"]))
        mesh = self._step.topology.mesh
        host["direction"] = host["direction"][:, : mesh.dimension]
        arrays = {name: values[order] for name, values in host.items()}
        return Proximities(**arrays, mesh=mesh, positions=self._step.positions())

    def __repr__(self) -> str:
        return f"DeviceProximities(up to {len(self.kind):,} pairs on {self.kind.device}; to_host() reads them)"

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled: the arrays are on a device, and launches go on writing to them."""
        raise TypeError("DeviceProximities cannot be copied or pickled; copy or pickle what to_host() returns")


@dataclass(frozen=True, repr=False, eq=False)
class DeviceDisplacements:
    """The Warp arrays to which :meth:`ccd_warp.CollisionPipeline.launch_displacement_bounds` writes each time.

    The result keeps everything alive that a captured graph uses, so keep it as long as the graph.

    Attributes:
        bounds: For each vertex the length by which it may move, float64, shape [V], as
            :func:`ccd_warp.displacement_bounds` gives it. It is 0 for the vertices of a pair beyond the capacity, and
            in a world with a coordinate that is not finite, so the guarantee holds whatever the flags.
        flags: :class:`ccd_warp.LaunchFlag` of the scene, int32, shape [1].
        world_flags: Flags of each world, int32, shape [W]; with a single world the array ``flags`` itself.
        num_pairs: Number of pairs of each :class:`ccd_warp.PairKind` that the cull left, including those beyond the
            capacity, int64, shape [5].
    """

    bounds: wp.array
    flags: wp.array
    world_flags: wp.array
    num_pairs: wp.array
    _step: Any = field(repr=False, compare=False)

    def to_host(self) -> NDArray[np.float64]:
        """The bounds as a NumPy array; this waits for the device.

        Returns:
            A copy that later launches do not change, shape [V].
        """
        bounds: NDArray[np.float64] = self.bounds.numpy().copy()
        return bounds

    def __repr__(self) -> str:
        return f"DeviceDisplacements({len(self.bounds):,} vertices on {self.bounds.device}; to_host() reads them)"

    def __reduce__(self) -> NoReturn:
        """Refuse to be copied or pickled: the arrays are on a device, and launches go on writing to them."""
        raise TypeError("DeviceDisplacements cannot be copied or pickled; copy or pickle what to_host() returns")
