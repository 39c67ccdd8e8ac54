"""Launches of a pipeline: its steps on the device, their capacities, and where static bodies stand."""

import ctypes
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._calls.motions import paths_of
from ccd_warp._engine.device.input import PreparedLaunch
from ccd_warp._engine.device.line_search import DeviceLineSearch
from ccd_warp._engine.device.step import MOST_CONTACTS, MOST_PAIRS, Capacities, DeviceStep
from ccd_warp._engine.host.oddities import DistanceInEdges
from ccd_warp._engine.mesh.scene import length_scale_of, possible_kinds
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._results.device_results import LaunchResult
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.status import LaunchFlag
from ccd_warp._runtime.tape import wants_gradient
from ccd_warp._scene.input.arguments import check_count
from ccd_warp._scene.input.interop import DeviceArray, as_positions, without_worlds
from ccd_warp._scene.input.options import Options, naming

if TYPE_CHECKING:
    from ccd_warp._gradients.line_search_tape import TapedLineSearch
    from ccd_warp._gradients.toi_tape import TapedLaunch
    from ccd_warp._rigid.arc_step import DeviceArcStep

_DeviceStepT = TypeVar("_DeviceStepT", bound=Any)
# Warns once of something, with a message that is made only then.
Warn = Callable[[str, Callable[[], str]], None]
_OVERFLOW = LaunchFlag.PAIRS_OVERFLOW | LaunchFlag.CONTACTS_OVERFLOW


class Launches:
    """Steps on the device, which a launch takes out while it uses them and puts back only if it succeeds.

    One thread at a time calls them.

    Attributes:
        capacities: Those of the steps.
    """

    def __init__(self, topology: Topology, options: Options) -> None:
        """Have no step yet."""
        self._topology, self._mesh, self._options = topology, topology.mesh, options
        self.capacities = Capacities.default(self._mesh)
        self._layout = self._mesh._vertices_in_space
        self._step: DeviceLineSearch | None = None
        self._arc_step: DeviceArcStep | None = None  # of launches with a motion
        self._at_one_time: dict[type, Any] = {}
        self._interrupted: DeviceStep | None = None  # the step of a launch that was interrupted
        self._is_placing = False  # whether that launch may have moved some of the static bodies
        self._placed_by: DeviceStep | None = None  # the step whose launch was the last to place static bodies
        self._is_distance_checked = False  # at the positions of a launch
        # for a motion of many worlds: their number, the launches of as many copies of the mesh, and their positions
        self._of_worlds: tuple[int, Launches, dict[Any, wp.array]] | None = None

    @lazy_property
    def radius(self) -> wp.array | None:
        """The radii of the vertices; None if the mesh was made without."""
        radius = self._mesh.radius
        return None if radius is None else self._topology.array(radius, wp.float64)

    def set_capacities(self, max_pairs: int | None, max_contacts: int | None) -> None:
        """Let steps that are made from now on have these capacities, where they are given."""
        self.capacities, self._of_worlds = self._with_capacities(max_pairs, max_contacts), None

    def _with_capacities(self, max_pairs: int | None, max_contacts: int | None) -> Capacities:
        capacities = self.capacities
        if max_pairs is not None:
            capacities = replace(capacities, max_pairs=check_count("max_pairs", max_pairs, MOST_PAIRS))
        if max_contacts is not None:
            capacities = replace(capacities, max_contacts=check_count("max_contacts", max_contacts, MOST_CONTACTS))
        return capacities

    def reserve(
        self, max_pairs: int | None, max_contacts: int | None, vertices: ArrayLike | None, warn: Warn
    ) -> LaunchResult:
        """Make the device step (:meth:`ccd_warp.CollisionPipeline.reserve`)."""
        if self._topology.device.is_capturing:
            raise RuntimeError("a graph is being captured; call reserve() before the capture")
        with naming("reserve"):
            capacities = self._with_capacities(max_pairs, max_contacts)
        layout = None
        if vertices is not None:
            layout = self._mesh._in_space(self._mesh._placed(self._mesh.frame(vertices, "vertices").copy()))
        self._check_distance(lambda: self._layout if layout is None else layout, warn)
        return self._make_step(capacities, layout).result

    def _check_distance(self, start: Callable[[], NDArray[np.float64]], warn: Warn) -> None:
        """Warn once of a distance of pairs that is many edges long at the start positions of launches."""
        separation = self._options.separation(length_scale_of(self._mesh, self._options))
        if not separation > 0.0 and self._mesh.radius is None:
            return
        radius = None if self.radius is None else self.radius.numpy()
        distance = DistanceInEdges.of(self._topology, start(), separation, radius, self._mesh.exclusion_rings)
        if distance is not None:
            warn("distance", distance.described)

    def _check_first_distance(self, step: DeviceStep, prepared: PreparedLaunch, warn: Warn) -> None:
        """Warn of such a distance at the positions of a first launch; those of a capture are not known yet."""
        if not self._topology.device.is_capturing:
            self._check_distance(lambda: step.start_of(prepared), warn)
            self._is_distance_checked = True

    def _make_step(self, capacities: Capacities, layout: NDArray[np.float64] | None) -> DeviceLineSearch:
        """Make the device step, laid out for other positions if they are given."""
        before = self._step or self._interrupted
        placed = self._layout if before is None else before.static_positions()
        is_new_layout = layout is not None
        if layout is not None:
            placed = layout
        layout = self._layout if layout is None else layout
        try:
            arguments = self._topology, self._options, capacities, layout, placed, self.radius
            step = _made(DeviceLineSearch, *arguments)
        except RuntimeError as error:  # of Warp; what it has allocated so far is freed
            if "allocate" not in str(error):
                raise
            num_kinds = len(possible_kinds(self._mesh, self._options))
            least = capacities.num_bytes(num_kinds, is_cuda=self._topology.device.is_cuda)
            raise MemoryError(
                f"max_pairs is {capacities.max_pairs:,} and max_contacts is {capacities.max_contacts:,}, which take "
                f"{least:,} bytes on {self._topology.device.alias} besides the boxes; expected capacities for which "
                f"it has memory"
            ) from error
        if placed is layout:
            self._is_placing = False
        if is_new_layout:
            self._placed_by = None
        elif self._placed_by is not None and not self._placed_by.on_arcs:
            self._placed_by = step
        self.capacities, self._layout, self._step = capacities, layout, step
        self._at_one_time.clear()
        self._arc_step = self._of_worlds = None
        return step

    def launch(
        self,
        vertices_t0: DeviceArray,
        vertices_t1: DeviceArray,
        motion: RigidMotion | None,
        warn: Warn,
        **arguments: Any,
    ) -> LaunchResult:
        """Launch on the device step, which is made now if :meth:`reserve` has not made it."""
        positions = vertices_t0, vertices_t1
        is_taped = wants_gradient(*positions, self.radius)
        if is_taped and motion is not None:
            raise ValueError(
                "a launch with a motion is not recorded, and an array on the tape requires a gradient; expected none "
                "that does, or no tape, and for gradients result.to_host().contacts.toi_gradient(), which "
                "motion.gradient_by_poses() and gradient_by_twist() take"
            )
        name_t1 = arguments.get("name_t1", "vertices_t1")
        vertices_t0 = without_worlds(vertices_t0, "vertices_t0", self._mesh.rows_by_world, self._mesh.dimension)
        vertices_t1 = without_worlds(vertices_t1, name_t1, self._mesh.rows_by_world, self._mesh.dimension)
        if motion is not None:
            is_of_worlds = isinstance(motion, RigidMotion) and motion.num_worlds > 1 and self._mesh.num_worlds == 1
            launch = self._launch_worlds if is_of_worlds else self._launch_on_arcs
            return launch(vertices_t0, vertices_t1, motion, warn, **arguments)
        if self._step is None and self._topology.device.is_capturing:
            raise RuntimeError("nothing is reserved; call reserve() before the capture")
        step = self._step or self._make_step(self.capacities, None)
        prepared = step.prepare(vertices_t0, vertices_t1, **arguments, is_taped=is_taped)
        if not self._is_distance_checked:
            self._check_first_distance(step, prepared, warn)
        taped = self._taped(step, prepared, positions) if is_taped else None
        if self._is_placing and not prepared.places_static:
            raise RuntimeError(
                "a launch was interrupted while it placed static bodies; "
                "pass vertices_t0 with a row for every vertex, or call reserve(vertices=...)"
            )
        self._check_places(step, prepared)
        self._interrupted, self._is_placing = step, prepared.places_static
        self._step = None
        result = (step if taped is None else taped).launch(prepared)
        self._step = step
        self._interrupted, self._is_placing = None, False
        overflow = self._tell_overflow(step, step.result, warn)
        if overflow and taped is not None:
            taped.on_backward = partial(warn, "gradient", lambda: _without_gradient(overflow))
        return step.result if result is None else result

    def _tell_overflow(self, step: DeviceStep, found: Any, warn: Warn) -> LaunchFlag:
        """Warn once, where a launch has ended, of capacities that did not suffice; returns the flags of that.

        On CUDA, and in a capture, nothing is read.
        """
        if self._topology.device.is_cuda or self._topology.device.is_capturing:
            return LaunchFlag(0)
        flags = _OVERFLOW & LaunchFlag(ctypes.c_int32.from_address(found.flags.ptr).value)
        if flags & LaunchFlag.PAIRS_OVERFLOW:
            warn("pairs", lambda: _described("pairs", int(found.num_pairs.numpy()[:4].max()), self.capacities))
        if flags & LaunchFlag.CONTACTS_OVERFLOW:
            count = getattr(found, "contacts", found).count
            most = max(int(count.numpy()[0]), step.most_contacts)
            warn("contacts", lambda: _described("contacts", most, self.capacities))
        return flags

    def _launch_on_arcs(
        self, vertices_t0: DeviceArray, vertices_t1: DeviceArray, motion: RigidMotion, warn: Warn, **arguments: Any
    ) -> LaunchResult:
        """Launch on the device step of bodies that turn, which the first such launch makes."""
        from ccd_warp._rigid.arc_step import DeviceArcStep  # few programs need it

        mesh = self._mesh
        paths = paths_of(mesh, self._options, motion)
        step, self._arc_step = self._arc_step, None
        if step is None:
            if self._topology.device.is_capturing:
                raise RuntimeError("a graph is being captured; a launch with a motion is no part of one")
            layout = paths.at(mesh, mesh._vertices_in_space, mesh._vertices_in_space, 0.0)
            of_step = self._topology, self._options, self.capacities, layout, self._layout, self.radius
            step = _made(DeviceArcStep, *of_step)
        prepared = step.prepare_on_paths(vertices_t0, vertices_t1, paths, **arguments)
        if not self._is_distance_checked:
            self._check_first_distance(step, prepared, warn)
        self._check_places(step, prepared)
        step.launch_on_paths(prepared, motion, paths)
        self._arc_step = step
        self._tell_overflow(step, step.result, warn)
        return step.result

    def _launch_worlds(
        self, vertices_t0: DeviceArray, vertices_t1: DeviceArray, motion: RigidMotion, warn: Warn, **arguments: Any
    ) -> LaunchResult:
        """Launch on as many copies of a mesh of one world as a motion has worlds."""
        count, mesh, device = motion.num_worlds, self._mesh, self._topology.device
        if arguments.get("line_search") is not None:
            raise ValueError(
                f"motion has {count} worlds, and the mesh one; expected a pipeline of mesh.replicate({count}) for "
                f"launch_line_search, which shortens the motion of each world"
            )
        if self._of_worlds is None or self._of_worlds[0] != count:
            if device.is_capturing:
                raise RuntimeError("a graph is being captured; a launch with a motion is no part of one")
            launches = Launches(Topology.of(mesh._copies(count, count), device), self._options)
            if self.capacities != Capacities.default(mesh):  # those of the caller
                launches.capacities = self.capacities
            self._of_worlds = count, launches, {}
        _, launches, arrays = self._of_worlds
        rows = {mesh.num_vertices: "one a vertex"}
        if mesh.static.any():
            rows[len(mesh.moving_vertices)] = "one a moving vertex"

        def of_worlds(name: str, values: Any) -> Any:
            """An array of one world for each of them."""
            of_one = as_positions(values, name, device, rows, mesh.dimension)
            key = name, of_one.dtype, len(of_one)
            if key not in arrays:
                arrays[key] = wp.empty(count * len(of_one), dtype=of_one.dtype, device=device)
            _repeat(of_one, arrays[key])
            return arrays[key]

        if self.radius is not None and launches.radius is not None:
            _repeat(self.radius, launches.radius)
        start = of_worlds("vertices_t0", vertices_t0)
        end = start if vertices_t1 is vertices_t0 else of_worlds(arguments.get("name_t1", "vertices_t1"), vertices_t1)
        return launches.launch(start, end, motion, warn, **arguments)

    def _check_places(self, step: DeviceStep, prepared: PreparedLaunch) -> None:
        """Check that a step knows where static bodies stand; launches with and without a motion keep places apart."""
        if prepared.places_static:
            self._placed_by = step
        elif self._placed_by is not None and self._placed_by is not step:
            raise RuntimeError(
                "static bodies were placed by a launch with a motion, and now there is none, or the other way round; "
                "pass vertices_t0 with a row for every vertex, or call reserve(vertices=...)"
            )

    def _taped(
        self, step: DeviceLineSearch, prepared: PreparedLaunch, positions: tuple[DeviceArray, DeviceArray]
    ) -> "TapedLaunch | TapedLineSearch":
        """A launch, or a line search, that is recorded on the active tape."""
        taped: Any
        if prepared.form.line_search is None:
            from ccd_warp._gradients.toi_tape import TapedLaunch as taped  # few programs need them
        else:
            from ccd_warp._gradients.line_search_tape import TapedLineSearch as taped
        return taped(step, prepared, positions, self.radius)

    def launch_at_one_time(self, kind: Any, positions: DeviceArray, length: float, warn: Warn) -> Any:
        """Launch on a step of a kind, which is made now if there is none; returns the arrays to which it writes."""
        for name, array in (("positions", positions), ("radius", self.radius)):
            if wants_gradient(array):
                raise ValueError(
                    f"{name} requires a gradient and a tape is recording, but this launch finds no times of impact, "
                    "which alone have gradients; expected an array that requires none, or no tape"
                )
        step = self._at_one_time.get(kind)
        if step is None:
            if self._topology.device.is_capturing:
                raise RuntimeError("a graph is being captured, and this launch was not called before the capture")
            of_step = self._topology, self._options, self.capacities, self._layout, self.radius
            step = _made(kind, *of_step)
        prepared = step.prepare_positions(positions)
        self._at_one_time.pop(kind, None)
        step.launch_within(prepared, step.values(length))
        self._at_one_time[kind] = step
        self._tell_overflow(step, step.arrays, warn)
        return step.arrays


def _repeat(of_one: wp.array, of_all: wp.array) -> None:
    """Fill an array with as many copies of another as it holds, twice as many with each launch."""
    filled = len(of_one)
    if filled == 0:
        return
    wp.copy(of_all, of_one, count=filled)
    while filled < len(of_all):
        count = min(filled, len(of_all) - filled)
        wp.copy(of_all, of_all, dest_offset=filled, count=count)
        filled += count


_LOST = {
    "pairs": "each in excess counts as touching from the start, or as near",
    "contacts": "those in excess are missing from the list",
}


def _described(what: str, most: int, capacities: Capacities) -> str:
    """What a launch had no place for, and what to do."""
    name = f"max_{what}"
    return (
        f"a launch has {most:,} {what}{' of a kind' if what == 'pairs' else ''}, and {name} is "
        f"{getattr(capacities, name):,}, so that {_LOST[what]}, as its flags say: reserve({name}={2 * most}) makes "
        f"space for twice as many"
    )


def _without_gradient(overflow: LaunchFlag) -> str:
    """What a backward pass lacks."""
    return (
        f"the launch of this backward pass has {overflow!r}: the gradient by the toi of what found no place is none, "
        f"and adds 0; reserve() more before the launch, and look at its flags"
    )


def _made(kind: Callable[..., _DeviceStepT], *arguments: Any) -> _DeviceStepT:
    """A step on the device whose arrays are filled already: the stream that reads them first may be another one."""
    step = kind(*arguments)
    wp.synchronize_device(step.topology.device)
    return step
