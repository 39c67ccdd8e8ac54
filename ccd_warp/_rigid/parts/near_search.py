"""In which slices of a step bodies come near each other: what else there is need not be searched."""

from contextlib import suppress
from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._engine.mesh.scene import length_scale_of
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._engine.motion import Slice, Slices
from ccd_warp._rigid.arcs import PathTable
from ccd_warp._rigid.body_paths import BodyPaths
from ccd_warp._rigid.parts.mesh import parts_of
from ccd_warp._rigid.parts.overlap import BodyParts
from ccd_warp._rigid.parts.whole_bodies import WholeBodies, record_walk
from ccd_warp._runtime.launch import Execution, Recording, Slot
from ccd_warp._runtime.threads import StopFlag
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh

_MOST_BODIES = 1 << 11  # that are divided
_FEW_FACES = 1 << 12  # of a world, which are divided in no more time than a step may take
# Tests and marks of a search, and the numbers of worlds and slices for which one stays.
_MOST_ITEMS, _MOST_IDLE = 1 << 24, 8
_MOST_MARKS = 1 << 28  # of a world: a GiB


class Near(NamedTuple):
    """What may touch in a step, in worlds of a mesh of one.

    Attributes:
        number: Slices in which any body may touch another, ascending, shape [n].
        bodies: Those that may in each of these slices of each world, bool, shape [n, W, B].
        parts: Parts of bodies that may in any slice of each world, bool, shape [W, P]; empty where they are not wanted.
    """

    number: NDArray[np.intp]
    bodies: NDArray[np.bool_]
    parts: NDArray[np.bool_]

    def slices(self, slices: Slices) -> list[Slice]:
        """The slices of a single world in which anything is near, with the bodies that are; at least one."""
        if len(self.number) == 0:
            return [slices.slice(0)._replace(active=np.zeros(self.bodies.shape[2], dtype=bool))]
        of_slices = zip(self.number.tolist(), self.bodies[:, 0], strict=True)
        return [slices.slice(number)._replace(active=active) for number, active in of_slices]


def body_parts(topology: Topology, ends: Positions, num_worlds: int = 1) -> BodyParts | None:
    """The parts of the bodies of a mesh with positions at both ends of a step, of rigid bodies in their own frames.

    They stay for later calls. A motion of one world may be that of a mesh that has many itself.

    Returns:
        None where bodies are searched for as wholes: many of them, or others than rigid ones and those that stand, and
        where it may take more time to divide them: in a first step of many faces, or with other rows than the last.
    """
    mesh, (start, end) = topology.mesh, ends
    # radii may be others on the device than those of the mesh
    is_plain = mesh.radius is None or np.array_equal(topology.radius.numpy(), mesh.radius)
    are_few = mesh.num_bodies <= _MOST_BODIES and WholeBodies.are_found(mesh, num_worlds)
    if not (are_few and is_plain and _are_same(start, end)):
        return None
    kept = MeshCache.of(mesh).parts
    positions, parts = kept.get("parts", (None, None))
    if _are_same(positions, start):
        return parts
    if not _are_same(kept.get("last"), start):
        kept["last"] = start if start is mesh.vertices else start.copy()
        is_cheap = num_worlds > 1 or mesh.num_faces <= _FEW_FACES or mesh._is_of_instances
        if positions is not None or not is_cheap:
            return None
    parts = parts_of(mesh, start)
    kept["parts"] = kept["last"], parts
    return parts


def _are_same(positions: NDArray[np.float64] | None, start: NDArray[np.float64]) -> bool:
    """Whether these are known positions."""
    return positions is start or (positions is not None and np.array_equal(positions, start))


def touching_distance(mesh: CollisionMesh, options: Options) -> float:
    """A Euclidean distance beyond which pairs do not count as touching, besides their radii: with the tolerance."""
    length_scale = length_scale_of(mesh, options)
    return 2.0 * (options.separation(length_scale) + options.tolerance * length_scale)


def find_near(
    topology: Topology,
    parts: BodyParts | None,
    ends: Positions,
    paths: BodyPaths,
    slices: Slices,
    reach: float,
    threads: int,
    *,
    wants_parts: bool = False,
) -> Near | None:
    """What may touch in a step.

    Args:
        topology: Of the mesh.
        parts: Those of its bodies; None for whole bodies, given their positions.
        ends: Positions at both ends in space, of rigid bodies in their own frames.
        paths: Those of the rigid bodies, of one world after another.
        slices: The slices of the step.
        reach: A Euclidean distance, besides the radii of the vertices.
        threads: Threads on the CPU.
        wants_parts: Whether parts are told, and not bodies alone.

    Returns:
        None where it is not looked for: others than rigid bodies move, or there are too many pairs or slices of bodies.

    Guarantee: two bodies, or parts of two, that may collide, with points which come within the distance at some time
    of a slice, on trajectories within the excess of those of the motion in the mathematics of real numbers, are among
    what is near; and a body, or part, that comes so near to a half-space.
    """
    mesh = topology.mesh
    num_links = int(mesh.rigid.sum())
    num_worlds = len(paths) // num_links
    is_possible = parts is not None or WholeBodies.are_found(mesh, num_worlds)
    if not is_possible or slices.num_slices * mesh.num_bodies > _MOST_MARKS:
        return None
    idle = MeshCache.of(mesh).parts.setdefault("idle", {}) if parts is None else parts.idle
    num_pairs = WholeBodies.num_pairs(mesh) if parts is None else len(parts.pairs)
    num_parts = len(parts.body) if parts is not None and wants_parts else 0
    of_world = max(num_pairs, slices.num_slices * mesh.num_bodies, num_parts)
    at_once = max(1, _MOST_ITEMS // max(of_world, 1))
    found = []
    for first in range(0, num_worlds, at_once):
        last = min(first + at_once, num_worlds)
        some = paths
        if last - first < num_worlds:
            some = paths.rows(np.arange(first * num_links, last * num_links))
        most_slices = 1 << (slices.num_slices - 1).bit_length()
        key = topology, threads, last - first, most_slices, num_parts
        while len(idle) >= _MOST_IDLE and key not in idle:
            with suppress(KeyError):  # another thread may do the same
                idle.popitem()
        searches = idle.setdefault(key, [])
        try:
            search = searches.pop()
        except IndexError:
            search = _NearSearch(parts, num_links, *key)
        found.append(search.find(ends, some, slices, reach))
        searches.append(search)
    return found[0] if len(found) == 1 else _joined(found)


def _joined(found: list[Near]) -> Near:
    """What is near in the worlds of several searches."""
    number = np.unique(np.concatenate([near.number for near in found]))
    bodies = np.zeros((len(number), sum(near.bodies.shape[1] for near in found), found[0].bodies.shape[2]), dtype=bool)
    first = 0
    for near in found:
        last = first + near.bodies.shape[1]
        bodies[np.searchsorted(number, near.number), first:last] = near.bodies
        first = last
    return Near(number, bodies, np.concatenate([near.parts for near in found]))


class _NearSearch:
    """The arrays and launches of a search in so many worlds, by one thread at a time.

    No call uses it again after an error or an interrupt: its stop flag is never cleared.
    """

    def __init__(
        self,
        parts: BodyParts | None,
        num_links: int,
        topology: Topology,
        threads: int,
        num_worlds: int,
        most_slices: int,
        num_parts: int,
    ) -> None:
        mesh, device = topology.mesh, topology.device
        self._shape, flag = (num_worlds, mesh.num_bodies), StopFlag(device)
        self._paths = PathTable(num_worlds * num_links, device)
        self._near = near = WholeBodies.new_marks(num_worlds * mesh.num_bodies, most_slices, device)
        near.parts = wp.zeros((num_worlds if num_parts else 0, num_parts), dtype=wp.int32, device=device)
        self._no_rows: wp.array = wp.empty(0, dtype=wp.vec3d, device=device)
        every = wp.empty(0, dtype=wp.int32, device=device)
        values = {"start": self._no_rows, "end": self._no_rows, "slices": 1, "t_max": 1.0, "reach": 0.0}
        self._recording = recording = Recording(Execution(device, threads, flag), values)
        self._is_whole = parts is None
        with recording.section("near"):
            if parts is None:
                bodies = WholeBodies(topology, topology.radius, np.cumsum(mesh.rigid) - 1)
                bodies.record_bounds(recording, Slot("start"), Slot("end"))
                trees, pairs = bodies.trees, bodies.pairs
            else:
                trees, pairs = parts.on_device(device)
            of_worlds = self._paths.table, num_links, num_worlds
            of_step = Slot("slices"), Slot("t_max"), Slot("reach")
            record_walk(recording, trees, pairs, *of_worlds, near, every, flag.array, *of_step)

    def find(self, ends: Positions, paths: BodyPaths, slices: Slices, reach: float) -> Near:
        """What is near on these paths."""
        recording, near = self._recording, self._near
        self._paths.assign(paths)
        if self._is_whole:
            self._bind_rows(*(wp.array(x, dtype=wp.vec3d, device=recording.device, copy=False) for x in ends))
        for name, value in (("slices", slices.num_slices), ("t_max", slices.t_max), ("reach", reach)):
            recording.bind(name, value)
        recording.play("near")
        if self._is_whole:
            self._bind_rows(self._no_rows, self._no_rows)  # not the caller's
        number = np.flatnonzero(near.is_any.numpy())
        bodies = (near.bodies.numpy()[number] != 0).reshape(len(number), *self._shape)
        found = Near(number, bodies, near.parts.numpy() != 0)
        if len(number):  # of many slices few are near, and nothing need be cleared after most steps
            for marks in (near.bodies, near.is_any, near.parts):
                marks.zero_()
        return found

    def _bind_rows(self, start: wp.array, end: wp.array) -> None:
        self._recording.bind("start", start)
        self._recording.bind("end", end)
