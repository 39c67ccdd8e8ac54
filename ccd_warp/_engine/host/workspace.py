"""What stays from step to step: a mesh's topology on a device, the boxes of static bodies, recordings, buffers."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.step_boxes import StepBoxes
from ccd_warp._engine.host.buffers import Buffers
from ccd_warp._engine.host.contacts import ContactStore
from ccd_warp._engine.host.counters import Counters
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._results.results import Counts
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.progress import Progress
from ccd_warp._runtime.threads import StopFlag
from ccd_warp._runtime.written import Written
from ccd_warp._scene.input.messages import warn
from ccd_warp._scene.mesh import CollisionMesh

# Structs of the kernels that are kept, enough for the different kinds of calls in a loop.
_MOST_PACKED = 16
_T = TypeVar("_T")


class Workspace:
    """The state of one mesh on one device, used by one step at a time.

    After a step that fails it may be inconsistent; it is then discarded, and the next step makes a new one.
    """

    def __init__(
        self,
        mesh: CollisionMesh,
        device: wp.Device,
        topology: Topology | None = None,
        warns_with: "Workspace | None" = None,
    ) -> None:
        """The state for a mesh.

        Args:
            mesh: The mesh.
            device: The Warp device.
            topology: Another than that of the mesh, for a search of another kind.
            warns_with: The state of which this is a part for a search of its own: each warns of what the other has not.
        """
        self.topology = topology or Topology.of(mesh, device)
        self.buffers = Buffers(device)
        self.flag = StopFlag(device)
        self.boxes = StepBoxes(self.topology, self.buffers)
        self.progress = Progress()
        self.unused_events: list[wp.Event] = []  # of CUDA, by which a step is timed
        self.plans: dict[Any, Any] = {}  # of `host_plan`, by what they depend on
        self.last_plans: dict[str, Any] = {}  # that of the last step with a goal, after what it depends on
        self._kept: dict[type, Any] = {}
        self._num_asked: dict[object, int] = {}
        self._packed: dict[Any, Any] = {}
        self._is_all_active = False
        self._at_one_time: dict[str, Workspace] = {}
        self._said: set[object] = set()
        self.warn_with(warns_with)

    def warn_with(self, other: "Workspace | None") -> None:
        """Warn from now on of what another has not warned of, which then does not, either."""
        if other is not None:
            self._said = other._said

    def warn_once(self, what: object, message: Callable[[], str]) -> None:
        """Warn of something, with a message made only then, unless a step of this mesh has warned of it before.

        A warning that is an error is raised each time; a message that is empty is none, and is not made again.
        """
        if what not in self._said:
            if text := message():
                warn(text)
            self._said.add(what)

    def at_one_time(self, goal: str, topology_of: Callable[[Topology], Topology] | None = None) -> "Workspace":
        """The state of calls at one time with a goal, whose boxes have another size than those of a step.

        Args:
            goal: The goal.
            topology_of: The topology in which they search, given that of the mesh, which is the default.
        """
        if goal not in self._at_one_time:
            topology = self.topology if topology_of is None else topology_of(self.topology)
            self._at_one_time[goal] = Workspace(self.topology.mesh, self.topology.device, topology, warns_with=self)
        return self._at_one_time[goal]

    @lazy_property
    def no_counts(self) -> dict[str, Any]:
        """The fields of `Counts` before a step has done anything."""
        mesh = self.topology.mesh
        sizes: dict[str, Any] = {"bodies": mesh.num_bodies, "vertices": mesh.num_vertices, "edges": mesh.num_edges}
        sizes |= {"faces": mesh.num_faces, "codimensional_edges": len(mesh.codimensional_edges)}
        sizes |= {"codimensional_points": len(mesh.codimensional_points)}
        return vars(Counts(**{f"num_{name}": number for name, number in sizes.items()}))

    @lazy_property
    def own_positions(self) -> Positions:
        """Positions at both ends of a step, for a search that fills them itself."""
        start, end = np.empty((2, self.topology.mesh.num_vertices, 3))
        return start, end

    @lazy_property
    def contacts(self) -> ContactStore:
        """The contacts and the minima of a step."""
        return ContactStore(self.topology, self.buffers, self.counters)

    @lazy_property
    def counters(self) -> Counters:
        """What the kernels of a step count, and every toi."""
        mesh = self.topology.mesh
        return Counters(self.topology.device, mesh.num_vertices + mesh.num_bodies + mesh.num_worlds + 1)

    def copied(self, positions: Positions) -> tuple[wp.array, wp.array]:
        """Arrays that stay, with copies of the positions at both ends of a step."""
        start, end = self._copies
        start.write(positions[0])
        end.write(positions[1])
        return start.array, end.array

    @lazy_property
    def _copies(self) -> tuple[Written, Written]:
        count, device = self.topology.mesh.num_vertices, self.topology.device
        start, end = (Written(wp.empty(count, dtype=wp.vec3d, device=device)) for _ in range(2))
        return start, end

    def active(self, bodies: NDArray[np.bool_] | None) -> wp.array:
        """Which bodies are active, int32, shape [B]: all of them by default."""
        if bodies is not None:
            self._active.write(bodies.astype(np.int32))
        elif not self._is_all_active:
            self._active.write(np.int32(1))
        self._is_all_active = bodies is None
        return self._active.array

    @lazy_property
    def _active(self) -> Written:
        return Written(wp.empty(self.topology.mesh.num_bodies, dtype=wp.int32, device=self.topology.device))

    @lazy_property
    def start_distances(self) -> Written:
        """How near each vertex is to anything at the start of a step, as share and length, float64, shape [2 V]."""
        return Written(wp.empty(2 * self.topology.mesh.num_vertices, dtype=wp.float64, device=self.topology.device))

    def kept(self, kind: type[_T], make: Callable[[], _T]) -> _T:
        """What a step of an outer ring keeps here, by its class."""
        if kind not in self._kept:
            self._kept[kind] = make()
        return self._kept[kind]  # type: ignore[no-any-return]

    def is_due(self, what: object) -> bool:
        """Whether something odd is to be asked for: the first, second, fourth, eighth time that a step might."""
        if len(self._num_asked) >= _MOST_PACKED:
            self._num_asked.clear()
        count = self._num_asked[what] = self._num_asked.get(what, 0) + 1
        return count & (count - 1) == 0

    def packed_once(self, key: Any, pack: Callable[[], Any]) -> Any:
        """What follows from a key alone, such as a struct of the kernels, since packing takes as long as a launch."""
        if key not in self._packed:
            packed = pack()
            if len(self._packed) >= _MOST_PACKED:
                self._packed.clear()
            self._packed[key] = packed
        return self._packed[key]
