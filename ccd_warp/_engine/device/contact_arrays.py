"""What the pairs that a launch lists are asked for besides its arrays, computed on the device at that moment."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._engine.host.contacts import new_contact_list
from ccd_warp._engine.mesh.planes import planes_of
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._results.shared_features import SharedFeatures
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.structs import struct_of
from ccd_warp.kernels.at_one_time.unique import FeaturePairs
from ccd_warp.kernels.step import contact_place as kernels
from ccd_warp.kernels.template import specialised


class ContactArrays:
    """Arrays with a row for each pair that a list has capacity for; one is made when it is first asked for.

    The list is that of the contacts, or of what is near at one time, whose pairs have no toi and no points here.

    Every call computes an array anew, from what the contacts and positions are when the device gets there. It has a
    launch of fixed size and, after the first, neither allocates nor waits, so that a graph can hold it.
    """

    def __init__(
        self,
        topology: Topology,
        execution: Execution,
        arrays: Mapping[str, wp.array],
        radii: tuple[wp.array, wp.array] | None = None,
        name: str = "contacts",
    ) -> None:
        """Take the arrays of a list by the names of ``kernels.step.contacts``, and what messages call it.

        ``radii`` are those of the vertices and of the primitives around them, for points.
        """
        self._topology, self._execution, self._name, self._radii = topology, execution, name, radii
        self._list = new_contact_list(arrays)
        self._capacity = len(arrays["kind"])
        self._arrays: dict[str, wp.array] = {}

    def vertices(self) -> wp.array:
        """Vertices of each pair, vec4i."""
        return self._filled("vertices", wp.vec4i, kernels.fill_vertices)

    def bodies(self) -> wp.array:
        """Bodies of both primitives, vec2i."""
        topology = self._topology
        return self._filled("bodies", wp.vec2i, kernels.fill_bodies, topology.vertex_body, planes_of(topology).body)

    def world(self) -> wp.array:
        """World of each pair, int32."""
        return self._filled("world", wp.int32, kernels.fill_world, self._topology.vertex_world)

    def weights(self) -> wp.array:
        """Weights of the vertices of each pair, vec4d."""
        return self._filled("weights", wp.vec4d, kernels.fill_weights)

    def points(self, name: str, positions: tuple[wp.array, wp.array]) -> wp.array:
        """Points at toi, vec3d, in a step between positions of one precision, in an array of this name.

        The first array has a row for every vertex, the second for every vertex or for the moving ones alone; its rows
        of static vertices are not read.
        """
        start, end = positions
        real = wp.float64 if start.dtype in (wp.vec2d, wp.vec3d) else wp.float32
        dimension = 2 if start.dtype in (wp.vec2f, wp.vec2d) else 3
        num_vertices = self._topology.mesh.num_vertices
        inputs = [start, end, self.moving_row(name), int(len(end) == num_vertices)]
        planes = planes_of(self._topology)
        inputs += [planes.point, planes.vertex, planes.unit, *(self._radii or ())]
        return self._filled(
            name, wp.vec3d, specialised("step.contact_points", real=real, dimension=dimension).fill_points, *inputs
        )

    def unique(self, features: wp.array) -> wp.array:
        """Which pairs are the first, by kind and pair, that have their closest features, bool."""
        return self._shared_features("unique", features).is_unique

    def shared_by(self, features: wp.array) -> wp.array:
        """How many pairs have the closest features of those, int32."""
        return self._shared_features("shared_by", features).shared_by

    def _shared_features(self, name: str, features: wp.array) -> SharedFeatures:
        capacity, device = self._capacity, self._topology.device
        size = 2 * capacity  # the sort needs twice the size
        keys, order = (self._array(name, key, t, size) for key, t in (("keys", wp.int64), ("order", wp.int32)))
        of_rows = (("others", wp.vec2i), ("pair keys", wp.int64), ("is unique", wp.bool), ("shared by", wp.int32))
        shared = SharedFeatures(keys, *(self._array(name, key, dtype, capacity) for key, dtype in of_rows))
        columns = {key: getattr(self._list, key) for key in ("count", "kind", "primitives")} | {"features": features}
        columns |= {f"{kind}_corners": self._topology.corners[kind] for kind in ("edge", "face")}
        columns["face_copies"] = self._topology.face_copies
        count = capacity
        if device.is_cpu and not device.is_capturing:  # the host knows how many rows there are
            count = min(count, int(self._list.count.numpy()[0]))
        sort = partial(wp.utils.radix_sort_pairs, keys, order, count)
        num_vertices = self._topology.mesh.num_vertices
        shared.find(self._execution, struct_of(FeaturePairs, columns), num_vertices, count, sort)
        return shared

    def _filled(self, name: str, dtype: type, kernel: wp.Kernel, *inputs: Any) -> wp.array:
        """The array of this name, filled by a kernel that takes the contacts and these inputs."""
        array = self._array(name, name, dtype, self._capacity)
        corners = [self._topology.corners[kind] for kind in ("edge", "face")]
        self._execution.launch(kernel, self._capacity, inputs=[self._list, *corners, *inputs], outputs=[array])
        return array

    def moving_row(self, name: str) -> wp.array:
        """The place of each vertex among the moving ones, -1 for a static one."""
        mesh, moving = self._topology.mesh, self._topology.moving_vertices
        if len(moving) == mesh.num_vertices:
            return moving  # each has its own

        def rows() -> wp.array:
            row = np.full(mesh.num_vertices, -1, dtype=np.int32)
            row[mesh.moving_vertices] = np.arange(len(moving), dtype=np.int32)
            return wp.array(row, dtype=wp.int32, device=self._topology.device)

        return self._kept(name, "moving row", rows)

    def _array(self, name: str, key: str, dtype: type, size: int) -> wp.array:
        return self._kept(name, key, lambda: wp.empty(size, dtype=dtype, device=self._topology.device))

    def _kept(self, name: str, key: str, make: Callable[[], wp.array]) -> wp.array:
        """An array that stays, made at its first use; ``name`` is what the user asked for."""
        if key not in self._arrays:
            if self._topology.device.is_capturing:  # memory of a capture is gone with its graph
                raise RuntimeError(f"a graph is being captured; ask for {self._name}.{name} once before the capture")
            self._arrays[key] = make()
        return self._arrays[key]
