"""What launches on a device return: arrays that later launches overwrite."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from dataclasses import dataclass, field
from typing import Any, Generic

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._results.device_pairs import DeviceContacts, DevicePairs, OnDevice
from ccd_warp._results.proximities import Proximities
from ccd_warp._results.results import HostLaunchResult, MotionT
from ccd_warp._runtime.display import counted
from ccd_warp._runtime.status import LaunchFlag, PairKind
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.input.arguments import EVERY_PER, Per, check_choice

# The field of a result that has the tois of each part of the mesh.
TOIS = {"scene": "toi", "world": "world_toi", "body": "body_toi", "vertex": "vertex_toi"}


@dataclass(frozen=True, repr=False)
class LaunchResult(OnDevice, Generic[MotionT]):
    """The Warp arrays to which :meth:`ccd_warp.CollisionPipeline.launch` writes, the same ones each time.

    The result keeps everything alive that a captured graph uses, so keep it as long as the graph.

    Attributes:
        toi: Earliest time of impact of the scene in [0, t_max]; inf if there is certainly none; float64, shape [1].
        world_toi: Earliest toi of each world, float64, shape [W]; with a single world the array ``toi`` itself.
        body_toi: Earliest toi of each body, float64, shape [B].
        vertex_toi: Earliest toi of each vertex, float64, shape [V].
        contacts: Every pair with a finite toi, up to the capacity.
        flags: :class:`ccd_warp.LaunchFlag` of the scene, int32, shape [1].
        world_flags: Flags of each world, int32, shape [W]; with a single world the array ``flags`` itself.
        num_pairs: For each :class:`ccd_warp.PairKind`, in their order, how many pairs the cull left, those beyond
            ``max_pairs`` included, int64, shape [5]: vertex-face, edge-edge, point-segment, point-point, vertex-plane.
            The last are vertices that meet a half-space, which take no capacity. Of a launch in several passes, or in
            the slices of a motion, the most of any.
        body_fraction: With a ``motion``, the fraction of its path by which each rigid body goes, 1 of all other bodies,
            float64, shape [B]: below 1 where :meth:`ccd_warp.CollisionPipeline.launch_line_search` has shortened it.
            None without a motion.
    """

    toi: wp.array
    world_toi: wp.array
    body_toi: wp.array
    vertex_toi: wp.array
    contacts: DeviceContacts
    flags: wp.array
    world_flags: wp.array
    num_pairs: wp.array
    body_fraction: wp.array | None = None
    _step: Any = field(default=None, repr=False, compare=False)  # keeps alive what a graph that writes here uses
    _taped: Any = field(default=None, repr=False, compare=False)  # what a launch on a tape has kept

    def __post_init__(self) -> None:
        """Let the contacts know the step to which they belong."""
        self.contacts._of(self._step)

    @property
    def motion(self) -> MotionT | None:
        """The motion of the last launch up to the end of the step; None without one. Reading it waits for the device.

        Its ``poses_t1`` are the poses of the rigid bodies there, as those of a :class:`ccd_warp.LineSearchResult`.
        """
        return None if self.body_fraction is None else self._step.ended_motion()

    def is_regular(self, per: Per = "vertex") -> wp.array:
        """Which results of this launch on a ``wp.Tape`` have a derivative; also after later launches.

        Args:
            per: Of which tois: ``"scene"``, ``"world"``, ``"body"`` or ``"vertex"``. After a line search ``"vertex"``.

        Returns:
            A new array on the device, bool. After ``launch`` whether each toi has a gradient, shape [1], [W], [B] or
            [V]; where it has none, as of inf, its gradient adds 0. After ``launch_line_search`` whether the position of
            each vertex has a derivative, shape [V]. Where False, the vertex either stays where it starts, with the
            derivative of that, or its fraction rests on a contact without a gradient, or on a pair that keeps a start
            distance: then its gradient adds 0 to that of both ends.

        Raises:
            ValueError: If the launch was not recorded on a tape, or ``per`` is not as described.
        """
        check_choice("per", per, EVERY_PER)
        if self._taped is None:
            raise ValueError(
                "the launch was not recorded; expected one inside a wp.Tape, with an array that requires a gradient"
            )
        flags: wp.array = self._taped.is_regular(per)
        return flags

    @text_completed_by(DeviceContacts.to_host)
    def to_host(
        self, vertices_t0: ArrayLike | None = None, vertices_t1: ArrayLike | None = None
    ) -> HostLaunchResult[MotionT]:
        """What all arrays hold now, on the host; this waits for the device.

        Returns:
            A copy that later launches do not change.
        """
        contacts = self.contacts.to_host(vertices_t0, vertices_t1)
        names = ("world_toi", "body_toi", "vertex_toi", "world_flags")
        arrays = {name: getattr(self, name).numpy().copy() for name in names}
        most_before = 0 if self._step is None else self._step.most_contacts  # in earlier passes
        return HostLaunchResult(
            toi=float(self.toi.numpy()[0]),
            contacts=contacts,
            flags=LaunchFlag(int(self.flags.numpy()[0])),
            num_pairs={kind: int(count) for kind, count in zip(PairKind, self.num_pairs.numpy(), strict=True)},
            num_contacts=max(int(self.contacts.count.numpy()[0]), most_before),
            body_fraction=None if self.body_fraction is None else self.body_fraction.numpy().copy(),
            motion=self.motion,
            **arrays,
        )

    def __repr__(self) -> str:
        sizes = [counted(len(self.body_toi), "body", "bodies"), f"{len(self.vertex_toi):,} vertices"]
        sizes += [f"{len(self.world_toi):,} worlds"] if len(self.world_toi) > 1 else []
        return f"LaunchResult({', '.join(sizes)}, arrays on {self.toi.device}; to_host() reads them)"


@text_completed_by(LaunchResult)
@dataclass(frozen=True, repr=False, eq=False)
class DeviceProximities(DevicePairs):
    """The Warp arrays to which :meth:`ccd_warp.CollisionPipeline.launch_proximity` writes, the same ones each time.

    The pairs are in arbitrary order, in arrays of fixed capacity; the fields are those of
    :class:`ccd_warp.Proximities`. Rows from ``count`` on mean nothing. The result keeps everything alive that a
    captured graph uses, so keep it as long as the graph. What is no field, :meth:`unique` included, is
    computed as that of :class:`ccd_warp.DeviceContacts` is: when it is asked for, each time anew, in the same array.

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

    @property
    def normal(self) -> wp.array:
        """``direction``, by the name that it has in contacts."""
        return self.direction

    def unique(self) -> wp.array:
        """Which pairs :meth:`ccd_warp.Proximities.unique` keeps: each two closest features once.

        Returns:
            A mask on the device, bool, shape [max_contacts], False from ``count`` on.

        Raises:
            RuntimeError: If a graph is being captured and there was no earlier call.
        """
        return self._known_step().contact_arrays.unique(self.features)

    def shared_by(self) -> wp.array:
        """How many pairs, this one included, have the closest features of each that :meth:`unique` marks.

        Returns:
            Numbers on the device, int32, shape [max_contacts], which of other pairs mean nothing.

        Raises:
            RuntimeError: If a graph is being captured and there was no earlier call.
        """
        return self._known_step().contact_arrays.shared_by(self.features)

    def to_host(self) -> Proximities:
        """The pairs as NumPy arrays in the order of :class:`ccd_warp.Proximities`; this waits for the device.

        Their points are those of the positions that the array of the last launch holds now.

        Returns:
            A copy that later launches do not change.
        """
        step = self._known_step()
        mesh, columns = step.topology.mesh, self._rows(Proximities)
        columns["direction"] = columns["direction"][:, : mesh.dimension]
        return Proximities(**columns, mesh=mesh, positions=step.positions(), radius=step.radius())


@text_completed_by(LaunchResult)
@dataclass(frozen=True, repr=False, eq=False)
class DeviceDisplacements(OnDevice):
    """The Warp arrays to which :meth:`ccd_warp.CollisionPipeline.launch_displacement_bounds` writes each time.

    The result keeps everything alive that a captured graph uses, so keep it as long as the graph.

    Attributes:
        bounds: For each vertex the length by which it may move, float64, shape [V], as
            :func:`ccd_warp.displacement_bounds` gives it. It is 0 for the vertices of a pair beyond the capacity, and
            in a world with a coordinate that is not finite, so the guarantee holds whatever the flags.
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
