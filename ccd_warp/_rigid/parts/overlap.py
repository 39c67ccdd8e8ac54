"""Which parts of bodies may touch in slices of a motion, by spheres and boxes, before a vertex is placed.

A part has a sphere and a box in the frame of its body, which go with it (`trees`). Trees of the parts of two bodies are
tested from the top, in all of the step first (`kernels.rigid.part_overlap`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._rigid.parts.trees import PartTrees
from ccd_warp._rigid.parts.whole_bodies import pairs_of
from ccd_warp._rigid.rotations import in_space
from ccd_warp._scene.half_space import unit_normals
from ccd_warp._scene.mesh import CollisionMesh


class BodyParts:
    """The parts of the bodies of a mesh of one world, and which of them may touch.

    Attributes:
        mesh: The mesh.
        body: The body of each part, shape [P].
        begins: The first primitive of each part, shape [P + 1], in the order of the parts.
        may_be_cut: Whether a mesh of its parts excludes the same pairs.
        row_of: The row of a motion that a rigid body is, shape [B].
        pairs: Pairs of bodies that may collide, of which one moves, shape [m, 2]; the first is rigid, and the second
            -1 - k of half-space k.
        idle: Searches for parts that are near, which no call uses.
    """

    def __init__(self, mesh: CollisionMesh, vertices: NDArray[np.float64], *, may_be_cut: bool = True) -> None:
        """Divide the bodies of a mesh whose vertices, of rigid ones in their own frames, are at these places."""
        self.mesh, self.may_be_cut = mesh, may_be_cut
        with np.errstate(all="ignore"):  # what is no number, or too large for its square, is near
            trees = self._trees = PartTrees(mesh, in_space(vertices))
        counts = trees.num_parts[trees.of_body]
        self._first_part = np.append(0, np.cumsum(counts))
        self.body = np.repeat(np.arange(mesh.num_bodies), counts)
        number = np.arange(len(self.body)) - self._first_part[self.body]
        of_tree = trees.first_part[trees.of_body[self.body]] + number
        self.begins = np.append(0, np.cumsum(np.diff(trees.begins)[of_tree]))
        self._first_row = self.begins[self._first_part]  # of each body
        self.row_of = np.cumsum(mesh.rigid) - 1
        self.pairs = pairs_of(mesh, counts > 0)
        self._on_device: dict[str, tuple[Any, wp.array]] = {}
        self.idle: dict[Any, list[Any]] = {}

    def primitives(self, row: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Some primitives in the order of the parts.

        Returns:
            Their vertices, one of fewer than three repeated, shape [n, 3]; their kinds, 0 of a face, 1 of a
            codimensional edge, 2 of a codimensional point; the number of each among those of its kind.
        """
        body = np.searchsorted(self._first_row, row, side="right") - 1
        return self._trees.primitives(body, row - self._first_row[body])

    def on_device(self, device: wp.Device) -> tuple[Any, wp.array]:
        """The trees and the pairs of bodies on a device, as the kernels read them."""
        if str(device) not in self._on_device:
            from ccd_warp.kernels.rigid import part_overlap as kernels

            trees, mesh = self._trees, self.mesh
            arrays = {
                "first": trees.first_node[trees.of_body],
                "num_parts": trees.num_parts[trees.of_body],
                "first_part": self._first_part,
                "link": np.where(mesh.rigid, self.row_of, -1),
                **trees.nodes._asdict(),
                "plane_point": in_space(mesh.planes.points),
                "plane_normal": in_space(unit_normals(mesh.planes.normals)),
            }
            part_trees = kernels.PartTrees()
            for name, values in arrays.items():
                dtype = wp.int32 if values.dtype == np.intp else wp.float64 if values.ndim == 1 else wp.vec3d
                setattr(part_trees, name, wp.array(values, dtype=dtype, device=device))
            pairs = np.array(self.pairs, dtype=np.int32)
            self._on_device[str(device)] = part_trees, wp.array(pairs, dtype=wp.vec2i, device=device)
        return self._on_device[str(device)]
