"""A mesh of one world with a motion of many: its bodies stand in memory once, and worlds are searched in batches.

A batch is a mesh of some copies, which all batches share, so its topology, its trees and its buffers are made once. A
further world costs its rows of the motion, and what is found in it.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ccd_warp._contact_place import ContactPlace, joined
from ccd_warp._contacts import Contacts
from ccd_warp._engine.host.joint_search import firsts
from ccd_warp._joint_motion import JointMotion
from ccd_warp._mesh import CollisionMesh
from ccd_warp._mesh_paths import MeshPaths, check_rest, check_rows
from ccd_warp._motion import RigidMotion
from ccd_warp._results import Counts, MeshResult
from ccd_warp._status import PairKind, primitives_of

_T = TypeVar("_T")
# Primitives at a time: of fewer the overhead of a step shows, and more leave the caches.
_PRIMITIVES = 1 << 19


class MotionWorlds:
    """The worlds of a motion for a mesh of one world.

    Attributes:
        num_worlds: Number of worlds.
        copies: The mesh of a batch.
    """

    def __init__(
        self,
        pipeline: Any,
        start: NDArray[np.float64],
        end: NDArray[np.float64],
        motion: RigidMotion | JointMotion,
    ) -> None:
        """Begin a search; ``start`` and ``end`` are the positions of all vertices, the same in every world.

        Batches are calls of the pipelines of such a class as ``pipeline``, a ``CollisionPipeline``.

        Raises:
            ValueError: If the motion has not a row for each rigid body of the mesh in every world, moves a static one,
                or a row of a rigid body differs between both ends.
        """
        self._pipeline, self._motion, self.num_worlds = pipeline, motion, motion.num_worlds
        mesh = self._mesh = pipeline.mesh
        bodies = np.flatnonzero(mesh.rigid)
        given = motion._paths_at_start
        check_rows(mesh, bodies, len(given) // self.num_worlds)
        check_rest(mesh, bodies, given)
        MeshPaths.of(mesh, given.rows(np.arange(len(bodies)))).check_own_frames(mesh, start, end)
        num_primitives = max(mesh.num_faces + mesh.num_edges + mesh.num_vertices, 1)
        self._turn = given.largest_turn
        count = self._num_copies = min(self.num_worlds, max(1, _PRIMITIVES // num_primitives))
        self.copies = mesh._copies(count)
        self._start = np.tile(start, (count, 1))
        self._end = self._start if start is end else np.tile(end, (count, 1))
        # bodies that all copies share, half-spaces, come last
        num_own = mesh.num_bodies - int((mesh.planes.vertices < 0).sum())
        self._copy_of_body = np.arange(self.copies.num_bodies) // num_own
        self._copy_of_body[count * num_own :] = 0

    def _each(self, call: Callable[..., _T]) -> Iterator[tuple[NDArray[np.intp], _T]]:
        """What a call of the pipeline finds in each batch, the first of whose copies are some worlds.

        It gets a pipeline of the copies, positions, motion, and which of the copies it is to search.
        """
        count = self._num_copies
        for first in range(0, self.num_worlds, count):
            worlds = np.arange(first, min(first + count, self.num_worlds))
            is_searched = np.arange(count) < len(worlds)
            of_batch = self._motion._of_worlds(np.append(worlds, np.repeat(worlds[-1:], count - len(worlds))))
            if not isinstance(of_batch, JointMotion):
                paths = MeshPaths.of(self.copies, of_batch)
                # as many slices for all worlds, so that batches change no bit
                of_batch = replace(paths, active=is_searched[self._copy_of_body], turn=self._turn)
            with type(self._pipeline).borrowed(self.copies, self._pipeline._options) as pipeline:
                pipeline._show_progress = self._pipeline._show_progress
                found = call(pipeline, self._start, self._end, of_batch, is_searched)
            yield worlds, found

    def least_toi(self, call: Callable[..., float], is_enough: Callable[[float], Any]) -> float:
        """The least toi that a call finds in any world, at most up to one that is enough."""
        least = np.inf
        for _, toi in self._each(call):
            least = min(least, toi)
            if is_enough(least):
                break
        return least

    def result(self) -> MeshResult:
        """The contacts in all worlds."""
        found = list(self._each(type(self._pipeline)._contacts))
        mesh, num_worlds = self._mesh, self.num_worlds
        contacts = joined([self._in_one_world(result.contacts, worlds) for worlds, result in found])
        none = np.zeros((len(contacts), 1), dtype=np.int32)
        arrays: dict[str, Any] = {}
        for name, size, owners in (
            ("vertex", mesh.num_vertices, contacts.vertices),
            ("body", mesh.num_bodies, contacts.bodies),
            ("world", 1, none),
        ):
            rows = contacts.world[:, None].astype(np.int64) * size + owners
            shape = (num_worlds,) if name == "world" else (num_worlds, size)
            least, first = firsts(contacts.toi, rows, num_worlds * size)
            arrays |= {f"{name}_toi": least.reshape(shape), f"{name}_contact": first.reshape(shape)}
        timings: Counter[str] = Counter()
        for _, result in found:
            timings.update(result.timings)
        return MeshResult(
            toi=min(result.toi for _, result in found),
            contacts=contacts,
            counts=_total([result.counts for _, result in found], mesh, num_worlds),
            timings=dict(timings),
            hidden_gaps=next((result.hidden_gaps for _, result in found if result.hidden_gaps), ""),
            **arrays,
        )

    def _in_one_world(self, contacts: Contacts, worlds: NDArray[np.intp]) -> Contacts:
        """The contacts of a batch as those of the mesh of one world, world after world."""
        mesh = self._mesh
        contacts = contacts[np.argsort(contacts.world, kind="stable")]
        is_shared = mesh.planes.vertices < 0
        planes = np.append(np.tile(np.flatnonzero(~is_shared), self._num_copies), np.flatnonzero(is_shared))
        sizes = {"vertex": mesh.num_vertices, "edge": mesh.num_edges, "face": mesh.num_faces}
        primitives = contacts.primitives.copy()
        for kind in PairKind:
            rows = np.flatnonzero(contacts.kind == int(kind))
            for column, name in enumerate(primitives_of(kind)):
                of_copies = primitives[rows, column]
                primitives[rows, column] = planes[of_copies] if name == "plane" else of_copies % sizes[name]
        place = ContactPlace(mesh, points=contacts.points, relative_velocity=contacts.relative_velocity)
        place.world = worlds[contacts.world].astype(np.int32)
        return Contacts(**{**vars(contacts), "primitives": primitives})._of(place)


def _total(parts: list[Counts], mesh: CollisionMesh, num_worlds: int) -> Counts:
    """What all batches did; sizes are those of all worlds."""
    total: dict[str, Any] = {}
    for each in fields(Counts):
        values = [getattr(part, each.name) for part in parts]
        if isinstance(values[0], dict):
            total[each.name] = {key: sum(value[key] for value in values) for key in values[0]}
        else:
            total[each.name] = sum(values)
    sizes = {name: getattr(mesh, name) for name in ("num_bodies", "num_vertices", "num_edges", "num_faces")}
    sizes["num_codimensional_edges"] = len(mesh.codimensional_edges)
    sizes["num_codimensional_points"] = len(mesh.codimensional_points)
    total |= {name: num_worlds * size for name, size in sizes.items()}
    return Counts(**total)
