"""In which slices of a step bodies come near each other: what else there is need not be searched."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._engine.motion import Slice, Slices
from ccd_warp._rigid.parts.mesh import parts_of
from ccd_warp._rigid.parts.overlap import BodyParts, NearParts
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh

# Bodies of one world, whose pairs are listed, and of many, of which each has as many tests.
_MOST_BODIES, _MOST_BODIES_OF_WORLDS = 1 << 11, 64
# Faces for each slice above which it takes longer to divide the bodies than to search them: once, and in each step.
_LARGE_SCENE, _SMALL_SCENE = 1 << 12, 1 << 7


def body_parts(
    mesh: CollisionMesh, topology: Topology, ends: Any, num_slices: int, num_worlds: int = 1
) -> BodyParts | None:
    """The parts of the bodies of a mesh with positions at both ends of a step, of rigid bodies in their own frames.

    They stay for later calls. A motion of one world may be that of a mesh that has many itself.

    Returns:
        None where they are not looked for: of many bodies, or others than rigid ones and those that stand, and of
        large ones where it takes less time to search them: in a first step of few slices, unless they are copies of
        one, and wherever rows are others than in the step before.
    """
    start, end = ends
    most = _MOST_BODIES if num_worlds == 1 else _MOST_BODIES_OF_WORLDS
    # radii may be others on the device than those of the mesh
    is_plain = mesh.radius is None or np.array_equal(topology.radius.numpy(), mesh.radius)
    if mesh.num_bodies > most or not is_plain or not (start is end or np.array_equal(start, end)):
        return None
    kept = MeshCache.of(mesh).parts
    positions, parts = kept.get("parts", (None, None))
    if _are_same(positions, start):
        return parts
    last = kept.get("last")
    if not _are_same(last, start):
        last = kept["last"] = start if start is mesh.vertices else start.copy()
        num_passes = num_slices * num_worlds
        is_cheap = mesh.num_faces <= num_passes * (_LARGE_SCENE if positions is None else _SMALL_SCENE)
        if not (is_cheap or (positions is None and mesh._is_of_instances)):
            return None
    parts = parts_of(mesh, start)
    kept["parts"] = last, parts
    return parts


def _are_same(positions: NDArray[np.float64] | None, start: NDArray[np.float64]) -> bool:
    """Whether these are known positions."""
    return positions is start or (positions is not None and np.array_equal(positions, start))


def reach_of(options: Options, length_scale: float) -> float:
    """A Euclidean distance beyond which parts do not come within the separation of a pair, besides their radii."""
    return 2.0 * options.separation(length_scale)


def searched_slices(parts: BodyParts, near: NearParts, slices: Slices) -> list[Slice]:
    """The slices of one world in which anything is near, with the bodies that are; at least one."""
    searched = [
        slices.slice(number)._replace(active=_bodies(parts, near.a[rows], near.b[rows]))
        for number, rows in of_each(near.slice)
    ]
    return searched or [slices.slice(0)._replace(active=_bodies(parts, near.a, near.b))]


def of_each(numbers: NDArray[np.integer]) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Each of some numbers, ascending, with the rows that have it."""
    rows = np.argsort(numbers, kind="stable")
    different, first = np.unique(numbers[rows], return_index=True)
    if len(rows):
        yield from zip(different.tolist(), np.split(rows, first[1:]), strict=True)


def _bodies(parts: BodyParts, *near: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which bodies some parts are of."""
    bodies = np.zeros(parts.mesh.num_bodies, dtype=bool)
    for part in near:
        bodies[parts.body[part]] = True
    return bodies
