"""Which pairs stand for their closest features, and how many pairs have these: launches for the host and a device."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.structs import struct_of
from ccd_warp._runtime.threads import default_num_threads
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.kernels.at_one_time import unique as kernels


@dataclass(frozen=True)
class SharedFeatures:
    """The pairs of a list that stand for their closest features, in arrays with a row for each pair.

    Attributes:
        keys: Memory of keys by features, int64.
        others: Memory of features, wp.vec2i.
        pair_keys: The keys of the pairs by kind and primitives, int64; empty where their rows are in this order.
        is_unique: Whether it is the first pair with its features, bool.
        shared_by: How many pairs have the features of those, int32; of other pairs it means nothing.
    """

    keys: wp.array
    others: wp.array
    pair_keys: wp.array
    is_unique: wp.array
    shared_by: wp.array

    def find(
        self,
        execution: Execution,
        pairs: "kernels.FeaturePairs",
        num_vertices: int,
        num_pairs: int,
        sort: Callable[[], None],
    ) -> None:
        """Find them, with a function that sorts the keys.

        Args:
            execution: Where to launch.
            pairs: The pairs, a `kernels.FeaturePairs`.
            num_vertices: Number of vertices of their mesh.
            num_pairs: How many there are at most.
            sort: Sorts so many keys.
        """
        vertex_bits, row_bits, marks = index_bits(num_vertices), index_bits(num_pairs), [self.is_unique, self.shared_by]
        inputs, by_row = [pairs, vertex_bits, row_bits], [self.others, self.pair_keys]
        execution.launch(kernels.fill_feature_keys, len(self.is_unique), inputs, [self.keys, *by_row, *marks])
        if num_pairs:
            sort()
            inputs = [row_bits, self.keys[:num_pairs], *by_row]
            execution.launch(kernels.mark_unique, num_pairs, inputs, marks)


def index_bits(count: int) -> int:
    """Bits of a key that hold an index below a number."""
    return max(1, (count - 1).bit_length())


def unique_rows(
    kind: NDArray[np.int32],
    primitives: NDArray[np.int32],
    features: NDArray[np.int32],
    mesh: CollisionMesh,
) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """The first row of each two features of a table on the host, ascending, and how many rows have them."""
    cpu, count = wp.get_device("cpu"), len(kind)

    def on_cpu(values: NDArray[Any], dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=cpu, copy=False)

    columns = {"kind": on_cpu(kind, wp.int32), "primitives": on_cpu(primitives, wp.vec2i)}
    columns |= {"features": on_cpu(features, wp.int32), "count": on_cpu(np.array([count], dtype=np.int32), wp.int32)}
    columns |= {
        "edge_corners": on_cpu(mesh.edges[:, [0, 1, 1]], wp.vec3i),
        "face_corners": on_cpu(mesh.faces, wp.vec3i),
    }
    columns["face_copies"] = on_cpu(mesh._copies_of_faces, wp.int32)
    pairs = struct_of(kernels.FeaturePairs, columns)
    keys, is_unique = np.empty(count, dtype=np.int64), np.empty(count, dtype=bool)
    others, shared_by = np.empty((count, 2), dtype=np.int32), np.empty(count, dtype=np.int32)
    by_row = on_cpu(keys, wp.int64), on_cpu(others, wp.vec2i), on_cpu(keys[:0], wp.int64)
    shared = SharedFeatures(*by_row, on_cpu(is_unique, wp.bool), on_cpu(shared_by, wp.int32))
    shared.find(Execution(cpu, default_num_threads()), pairs, mesh.num_vertices, count, keys.sort)
    rows = np.flatnonzero(is_unique)
    return rows, shared_by[rows]
