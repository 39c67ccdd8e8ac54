"""The contacts that attain the tois of a kept check, and what these add to the gradients of the input."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from ccd_warp._engine.mesh.planes import planes_of
from ccd_warp._gradients.caller_arrays import CallerArrays
from ccd_warp._gradients.kept_check import KeptCheck
from ccd_warp._gradients.tape_memory import TapeMemory
from ccd_warp._results.device_results import TOIS
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp.kernels.gradients import attained, regularity, toi_adjoint, toi_slope
from ccd_warp.kernels.template import specialised

if TYPE_CHECKING:
    from ccd_warp._engine.device.step import DeviceStep

_NO_KEY = int(attained.NO_KEY)
# Below so many keys NumPy sorts them faster on the CPU, where Warp counts 2^16 digits several times.
_FEW = 1 << 11
_MOST_UNUSED = 4  # as many as most line searches have passes


def _power_of_two(count: int) -> int:
    """The least power of two that is not below a number."""
    return 1 << (count - 1).bit_length()


class Attaining:
    """Contacts that attain minima of a check, in the order of their keys, and how their tois change.

    On the CPU the arrays are used again by other backward passes after :meth:`release`; CUDA has a pool of memory, and
    that of a capture is gone with its graph.

    Attributes:
        num_rows: How many rows there are; on CUDA, and in a capture, those without a contact have no key.
    """

    num_rows: int

    def __init__(self, check: KeptCheck) -> None:
        """Arrays for as many contacts as a check may have."""
        self._check, self._has_radius = check, check.has_radius
        self._topology = check.step.topology
        self._device, self._launch = self._topology.device, check.memory.launch
        self._capacity = check.count if not check.is_read else _power_of_two(check.count)
        # a sort needs twice the size
        self._keys, self._listed = (self._empty(dtype, 2 * self._capacity) for dtype in (wp.int64, wp.int32))
        self._count = self._empty(wp.int32, 1)
        self._count_on_host: Any = self._count.numpy() if self._device.is_cpu else None  # the same memory
        self._keys_of: dict[str, wp.array] = {}  # of each kind of minima that was asked for
        self._lists: dict[tuple[str, ...], Any] = {}  # the struct of the kernels for each combination of these
        self._rows: dict[Any, Any] = {}  # kernels by the precision of positions
        self._num_pairs = 0

    @classmethod
    def of(cls, check: KeptCheck, of_minima: Mapping[str, wp.array]) -> "Attaining | None":
        """Those of a check that attain minima whose gradients are not 0; None if there is certainly none.

        Args:
            check: The check.
            of_minima: Gradients of ``"vertex"``, ``"body"``, ``"world"`` and ``"scene"``, of some of these.
        """
        if not of_minima or check.count == 0:
            return None
        unused: list[Attaining] = check.memory.attaining
        try:
            attaining = unused.pop() if check.is_read else None
        except IndexError:
            attaining = None
        if attaining is None or attaining._capacity < check.count:
            attaining = cls(check)
        attaining._check = check
        attaining._find(of_minima)
        if attaining.num_rows:
            return attaining
        attaining.release()
        return None

    def release(self) -> None:
        """Let another backward pass have the arrays; nothing else may be asked of this one."""
        memory, is_read = self._check.memory, self._check.is_read
        del self._check
        if is_read and len(memory.attaining) < _MOST_UNUSED:
            memory.attaining.append(self)

    def _empty(self, dtype: type, count: int | tuple[int, int]) -> wp.array:
        return wp.empty(count, dtype=dtype, device=self._device)

    @lazy_property
    def _mesh(self) -> Any:
        """What belongs to the primitives, as the struct of the kernels."""
        topology = self._topology
        planes = planes_of(topology)
        arrays = {"edge_corners": topology.corners["edge"], "face_corners": topology.corners["face"]}
        arrays |= {"vertex_body": topology.vertex_body, "vertex_world": topology.vertex_world}
        arrays |= {"plane_point": planes.point, "plane_vertex": planes.vertex, "plane_body": planes.body}
        if self._has_radius:
            arrays |= dict(zip(("neighbour_begin", "neighbours"), topology.neighbours, strict=True))
        mesh = struct_of(attained.CheckedMesh, arrays)
        mesh.num_vertices = topology.mesh.num_vertices
        return mesh

    def _find(self, of_minima: Mapping[str, wp.array]) -> None:
        """List the contacts, sort them, and find how their tois change."""
        check = self._check
        self._list = self._list_for(of_minima)
        for name in of_minima:
            self._keys_of[name].fill_(_NO_KEY)
        self._count.zero_()
        if not check.is_read:
            self._keys.fill_(_NO_KEY)
        self._launch(attained.attain, check.count, [check.copies.as_struct, self._mesh], [self._list])
        self.num_rows = int(self._count_on_host[0]) if check.is_read else check.count
        if self.num_rows == 0:
            return
        self._sort(self._keys, self._listed, self.num_rows)
        if self._num_pairs < self.num_rows:
            self._make_pairs(self.num_rows if not check.is_read else _power_of_two(self.num_rows))
        self._launch_of_minima(toi_adjoint.gather_pairs, of_minima)
        if self.num_rows > 1:  # one pair has a vertex in one column
            num_bits = self._topology.mesh.num_vertices.bit_length()
            self._sort(self._column_vertex, self._columns, 4 * self.num_rows, num_bits)
        inputs = [check.memory.query, -1, self._pairs.table]
        self._launch(toi_slope.fill_slopes, self.num_rows, inputs, [self._slopes])

    def _list_for(self, of_minima: Mapping[str, wp.array]) -> Any:
        """The list of the contacts that attain such minima, as the struct of the kernels."""
        names = tuple(of_minima)
        if names not in self._lists:
            for name in names:
                if name not in self._keys_of:
                    self._keys_of[name] = self._empty(wp.int64, len(of_minima[name]))
            arrays = {"count": self._count, "keys": self._keys, "listed": self._listed}
            self._lists[names] = struct_of(attained.Attained, arrays | {name: self._keys_of[name] for name in names})
        return self._lists[names]

    def _make_pairs(self, count: int) -> None:
        """Make a table of so many pairs, and of how their tois change."""
        of_table = dtypes_of(toi_slope.Table)
        columns = {name: self._empty(of_table[name], count) for name in of_table if name != "distances"}
        columns |= {name: self._empty(wp.vec3d, (count, 4)) for name in ("points_t0", "points_t1")}
        self._column_vertex, self._columns = (self._empty(wp.int32, 8 * count) for _ in range(2))
        arrays = {"column_vertex": self._column_vertex, "columns": self._columns}
        if self._has_radius:
            columns["distances"] = self._empty(wp.float64, count)
            arrays["radius_columns"] = self._empty(wp.vec2i, count)
        self._pairs = struct_of(toi_adjoint.Pairs, arrays)
        self._pairs.table = struct_of(toi_slope.Table, columns)
        slopes = {name: self._empty(dtype, count) for name, dtype in dtypes_of(toi_slope.Slopes).items()}
        self._slopes = struct_of(toi_slope.Slopes, slopes)
        self._num_pairs = count

    def _sort(self, keys: wp.array, values: wp.array, count: int, num_bits: int = 64) -> None:
        """Sort the first values by their keys, stably; both arrays have space for twice as many."""
        if count == 1:
            return
        if self._check.is_read and count < _FEW:
            of_keys, of_values = (x.numpy()[:count] for x in (keys, values))
            order = np.argsort(of_keys, kind="stable")
            of_keys[...], of_values[...] = of_keys[order], of_values[order]
        else:
            wp.utils.radix_sort_pairs(keys, values, count, end_bit=num_bits)

    def _launch_of_minima(self, kernel: wp.Kernel, of_minima: Mapping[str, wp.array]) -> None:
        """Launch a kernel that finds the gradients by the tois of the contacts."""
        gradient = struct_of(toi_adjoint.MinimaGradients, of_minima)
        inputs = [self._check.copies.as_struct, self._mesh, self._list, gradient]
        self._launch(kernel, self.num_rows, inputs, [self._pairs])

    def change_gradients(self, of_minima: Mapping[str, wp.array]) -> None:
        """Let the contacts have other gradients of the same minima."""
        self._launch_of_minima(toi_adjoint.change_gradients, of_minima)

    def add_rows(self, caller_arrays: CallerArrays, gradients: tuple[wp.array | None, wp.array | None]) -> None:
        """Add what the contacts contribute to the gradients of the input."""
        mesh, form = self._topology.mesh, caller_arrays.form
        if form.real not in self._rows:
            self._rows[form.real] = specialised("gradients.toi_adjoint_rows", real=form.real, dimension=mesh.dimension)
        moving_row = self._check.step.contact_arrays.moving_row("gradients")
        inputs = [self._pairs, 4 * self.num_rows, self._slopes, mesh.num_vertices, moving_row]
        inputs += [int(form.t0_by_vertex), int(form.t1_by_vertex), int(form.is_displacement)]
        outputs = [*gradients, None if caller_arrays.radius is None else caller_arrays.radius.grad]
        self._launch(self._rows[form.real].add_rows, 4 * self.num_rows, inputs, outputs)

    def rate(self, ratings: wp.array, start_distances: wp.array | None, vertex_rating: wp.array | None) -> None:
        """Rate the minima that contacts attain (`regularity`), given the ratings of vertices."""
        inputs = [self._check.copies.as_struct, self._mesh, self._list]
        inputs += [self._slopes.is_regular, start_distances, vertex_rating]
        self._launch(regularity.rate_minima, self.num_rows, inputs, [ratings])


def all_attaining(check: KeptCheck, per: str) -> Attaining | None:
    """The contacts that attain any minimum of a kind, whose gradients are 1."""
    ones = wp.full(
        len(getattr(check.step.result, TOIS[per])), value=1.0, dtype=wp.float64, device=check.step.topology.device
    )
    return Attaining.of(check, {per: ones})


def ratings_of(
    check: KeptCheck,
    per: str,
    attaining: Attaining | None,
    start_distances: wp.array | None = None,
    vertex_rating: wp.array | None = None,
) -> wp.array:
    """The rating of each minimum of a kind (`regularity`), given those of vertices, from what attains it."""
    tois = getattr(check.step.result, TOIS[per])
    ratings: wp.array = wp.full(len(tois), value=int(regularity.UNKNOWN), dtype=wp.int32, device=tois.device)
    if attaining is not None:
        attaining.rate(ratings, start_distances, vertex_rating)
    return ratings


def as_flags(step: "DeviceStep", ratings: wp.array) -> wp.array:
    """Whether each rating is that of what is regular, bool."""
    flags: wp.array = wp.empty(len(ratings), dtype=wp.bool, device=ratings.device)
    TapeMemory.of(step).launch(regularity.note_regular, len(ratings), [ratings], [flags])
    return flags
