"""Which parts of bodies may touch in slices of a motion, by spheres and boxes, before a vertex is placed.

A part has a sphere and a box in the frame of its body, which go with it (`trees`). Trees of the parts of two bodies are
tested from the top, in all of the step first (`kernels.rigid.part_overlap`).
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.motion import Slices
from ccd_warp._rigid.body_paths import BodyPaths
from ccd_warp._rigid.parts.trees import PartTrees, distinct, ranges
from ccd_warp._rigid.rotations import in_space
from ccd_warp._runtime.launch import Execution
from ccd_warp._scene.half_space import unit_normals
from ccd_warp._scene.input.worlds import worlds_of_bodies
from ccd_warp._scene.mesh import CollisionMesh

if TYPE_CHECKING:
    from ccd_warp._rigid.parts.near_search import NearSearch

# Pairs of bodies in a launch, and numbers of worlds for which a search stays.
_MOST_ITEMS, _MOST_IDLE = 1 << 24, 4


class NearParts(NamedTuple):
    """Pairs of parts that may come near each other, in no order, each column int32, shape [n].

    Attributes:
        world: World of each.
        slice: Slice of the step.
        a: One part.
        b: The other; the same where it is near a half-space.
    """

    world: NDArray[np.int32]
    slice: NDArray[np.int32]
    a: NDArray[np.int32]
    b: NDArray[np.int32]


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
        self._rigid = np.flatnonzero(mesh.rigid)
        self.pairs = pairs_of(mesh, counts > 0)
        self._on_device: dict[str, tuple[Any, wp.array]] = {}
        self._idle: dict[tuple[str, int, int], list[NearSearch]] = {}

    def primitives(self, row: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Some primitives in the order of the parts.

        Returns:
            Their vertices, one of fewer than three repeated, shape [n, 3]; their kinds, 0 of a face, 1 of a
            codimensional edge, 2 of a codimensional point; the number of each among those of its kind.
        """
        body = np.searchsorted(self._first_row, row, side="right") - 1
        return self._trees.primitives(body, row - self._first_row[body])

    def num_bodies(self, group: NDArray[np.intp], part: NDArray[np.intp], count: int) -> NDArray[np.intp]:
        """Of how many bodies the parts of each of so many groups are."""
        keys = distinct(group * self.mesh.num_bodies + self.body[part])
        return np.bincount(keys // self.mesh.num_bodies, minlength=count)

    def near(
        self, paths: BodyPaths, slices: Slices, reach: float, execution: Execution, *, any_suffices: bool = False
    ) -> NearParts:
        """Pairs of parts that may come within a distance in slices of the step.

        Args:
            paths: Those of the rigid bodies, of one world after another.
            slices: The slices.
            reach: The distance, Euclidean, besides the radii of the vertices.
            execution: Where to test.
            any_suffices: Whether one pair, of those of two bodies in a slice, tells enough.

        Guarantee: two primitives of different parts of bodies that may collide, which come within the distance at some
        time of a slice, on trajectories within the excess of those of the motion in the mathematics of real numbers,
        are in such a pair; and a primitive that comes so near to a half-space is in a pair of its part with itself.
        """
        num_links = len(self._rigid)
        num_worlds = len(paths) // num_links
        count = num_worlds * len(self.pairs)
        if count == 0:
            return NearParts(*4 * [np.zeros(0, dtype=np.int32)])
        worlds_at_once = max(1, _MOST_ITEMS // len(self.pairs))
        found = []
        for first in range(0, num_worlds, worlds_at_once):
            last = min(first + worlds_at_once, num_worlds)
            some = paths
            if last - first < num_worlds:
                some = paths.rows(np.arange(first * num_links, last * num_links))
            near = NearParts(*self._near(last - first, some, slices, reach, execution, any_suffices=any_suffices))
            found.append(near._replace(world=near.world + first))
        return found[0] if len(found) == 1 else NearParts(*map(np.concatenate, zip(*found, strict=True)))

    def _near(
        self, num_worlds: int, paths: BodyPaths, slices: Slices, reach: float, execution: Execution, **how: Any
    ) -> list[NDArray[np.int32]]:
        """The columns of the pairs in some worlds, by a search that no other thread uses meanwhile."""
        from ccd_warp._rigid.parts.near_search import NearSearch  # few programs need it

        device, threads = execution.device, execution.num_threads
        key = str(device), threads, num_worlds
        while len(self._idle) >= _MOST_IDLE and key not in self._idle:
            with suppress(KeyError):  # another thread may do the same
                self._idle.popitem()
        idle = self._idle.setdefault(key, [])
        try:
            search = idle.pop()
        except IndexError:
            trees, pairs = self._trees_on(device)
            search = NearSearch(trees, pairs, len(self._rigid), num_worlds, device, threads)
        found = search.find(paths, slices, reach, **how)
        idle.append(search)
        return found

    def _trees_on(self, device: Any) -> tuple[Any, wp.array]:
        """The trees and the pairs of bodies on a device."""
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


def pairs_of(mesh: CollisionMesh, is_filled: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Pairs of bodies with primitives that may collide, the first rigid, the second -1 - k of half-space k.

    Some rigid bodies stand where they are.
    """
    order, counts = partners_of(mesh)
    first = np.repeat(np.arange(len(order)), counts)
    a, b = order[first], order[ranges(np.arange(1, len(order) + 1), counts)]
    may = is_filled[a] & is_filled[b] & (mesh.rigid[a] | mesh.rigid[b]) & ~(mesh.static[a] & mesh.static[b])
    if mesh.body_pairs is not None:
        may &= mesh.body_pairs[a, b]
    pairs = np.column_stack([a[may], b[may]])
    swapped = ~mesh.rigid[pairs[:, 0]]
    pairs[swapped] = pairs[swapped][:, ::-1]
    rigid = np.flatnonzero(mesh.rigid & is_filled)
    planes = np.stack(np.meshgrid(rigid, -1 - np.arange(len(mesh.planes)), indexing="ij"), axis=-1)
    return np.concatenate([pairs, planes.reshape(-1, 2)])


def partners_of(mesh: CollisionMesh) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Bodies in an order, and how many of those that follow each may be in a world with it, shape [B] each."""
    world = np.zeros(mesh.num_bodies, dtype=np.intp)
    if mesh.num_worlds > 1:
        first, last = worlds_of_bodies(mesh.vertex_body, mesh.vertex_world, mesh.num_bodies)
        world = first if (first >= last).all() else world
    order = np.argsort(world, kind="stable")
    return order, np.searchsorted(world[order], world[order], side="right") - 1 - np.arange(len(order))
