"""A check of a step on the device, kept with all that the gradients of its minima need, and these gradients."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from ccd_warp._device_results import TOIS
from ccd_warp._engine.device.given import Given
from ccd_warp._engine.device.step import DeviceStep
from ccd_warp._engine.host.contacts import new_contact_list
from ccd_warp._engine.mesh.planes import planes_of
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp.kernels.step import regularity, toi_adjoint, toi_slope
from ccd_warp.kernels.template import specialised

_CONTACT_COLUMNS = ("count", "kind", "primitives", "toi", "status")
_NO_KEY = int(toi_adjoint.NO_KEY)
# Below so many keys NumPy sorts them faster on the CPU, where Warp counts 2^16 digits several times.
_FEW = 1 << 11


class Attaining(NamedTuple):
    """Contacts that attain minima of a check, in the order of their keys, and how their tois change.

    Attributes:
        num_rows: How many rows there are; on CUDA, and in a capture, those without a contact have no key.
        keys: Their keys.
        listed: Their places among the contacts of the check.
        attained: The key of each minimum.
        pairs: The contacts as a table of pairs, with the gradients by their tois.
        slopes: How these change.
    """

    num_rows: int
    keys: wp.array
    listed: wp.array
    attained: Any
    pairs: Any
    slopes: Any


class KeptCheck:
    """The contacts and the tois of a step that has been checked, and its input: copies, as all of it is overwritten.

    Attributes:
        start: Start positions of all vertices, float64.
        end: Those at the end.
        tois: Times of impact of vertices, bodies, worlds and the scene by the names of a result.
    """

    def __init__(
        self, step: DeviceStep, query: Any, positions: tuple[wp.array, wp.array], radius: wp.array | None
    ) -> None:
        """Keep what a step has now, which was checked between these positions for what the query tells."""
        self._step, self._query, self._device = step, query, step.topology.device
        result = step.result
        self._count = len(result.contacts.kind)
        if self._is_read:
            self._count = min(self._count, int(result.contacts.count.numpy()[0]))
        names = (*_CONTACT_COLUMNS, "normal") if step.has_planes else _CONTACT_COLUMNS
        self._contacts = {name: self._copy(getattr(result.contacts, name), self._count) for name in names}
        self.start, self.end = (self._copy(x) for x in positions)
        self.tois = {name: self._copy(getattr(result, name)) for name in TOIS.values()}
        self._radius = None if radius is None else self._copy(radius)
        _ = step.contact_arrays.moving_row("gradients")  # made now, not in a capture of the backward pass

    @cached_property
    def _check(self) -> Any:
        """What is kept, as the struct of the kernels."""
        arrays = {"start": self.start, "end": self.end, **self.tois}
        if self._radius is not None:
            arrays["radius"] = self._radius
        check = struct_of(toi_adjoint.Check, arrays)
        check.contacts, check.separation = new_contact_list(self._contacts), self._query.separation
        return check

    @cached_property
    def _mesh(self) -> Any:
        """What belongs to the primitives, as the struct of the kernels."""
        topology = self._step.topology
        planes = planes_of(topology)
        arrays = {"edge_corners": topology.corners["edge"], "face_corners": topology.corners["face"]}
        arrays |= {"vertex_body": topology.vertex_body, "vertex_world": topology.vertex_world}
        arrays |= {"plane_point": planes.point, "plane_vertex": planes.vertex, "plane_body": planes.body}
        if self._radius is not None:
            arrays |= dict(zip(("neighbour_begin", "neighbours"), topology.neighbours, strict=True))
        mesh = struct_of(toi_adjoint.CheckedMesh, arrays)
        mesh.num_vertices = topology.mesh.num_vertices
        return mesh

    @property
    def _is_read(self) -> bool:
        """Whether the host may read what a launch has written: on the CPU, where no graph is captured."""
        return bool(self._device.is_cpu and not self._device.is_capturing)

    @property
    def may_touch(self) -> bool:
        """Whether it may have a finite toi: on CUDA, and in a capture, always."""
        return not self._is_read or bool(np.isfinite(self.tois["toi"].numpy()[0]))

    def _copy(self, array: wp.array, count: int | None = None) -> wp.array:
        count = len(array) if count is None else min(count, len(array))
        copy = wp.empty(count, dtype=array.dtype, device=self._device)
        if count:
            wp.copy(copy, array, count=count)
        return copy

    def _empty(self, dtype: Any, count: int | tuple[int, int]) -> wp.array:
        return wp.empty(count, dtype=dtype, device=self._device)

    def _full(self, value: int, count: int, dtype: Any) -> wp.array:
        return wp.full(count, value=value, dtype=dtype, device=self._device)

    def add_gradients(
        self, of_minima: Mapping[str, wp.array], given: Given, gradients: tuple[wp.array | None, wp.array | None]
    ) -> None:
        """Add the gradients of the input, from those of minima: of ``"vertex"``, ``"body"``, ``"world"``, ``"scene"``.

        Where one array stands for two minima, it must be given once.
        """
        if self._is_read:
            of_minima = {name: x for name, x in of_minima.items() if x.numpy().any()}
        attaining = self.attaining(of_minima)
        if attaining is not None:
            self.add_rows(attaining, given, gradients)

    def attaining(self, of_minima: Mapping[str, wp.array]) -> Attaining | None:
        """The contacts that attain minima whose gradients are not 0; None if there is certainly none."""
        if not of_minima or self._count == 0:
            return None
        launch, check, mesh = self._step.execution.launch, self._check, self._mesh
        attained = struct_of(
            toi_adjoint.Attained, {name: self._full(_NO_KEY, len(x), wp.int64) for name, x in of_minima.items()}
        )
        num_listed = self._full(0, 1, wp.int32)
        keys, listed = self._full(_NO_KEY, 2 * self._count, wp.int64), self._empty(wp.int32, 2 * self._count)
        launch(toi_adjoint.attain, self._count, [check, mesh], [attained, num_listed, keys, listed])
        count = int(num_listed.numpy()[0]) if self._is_read else self._count
        if count == 0:
            return None
        self._sort(keys, listed, count)
        pairs, columns = self._new_pairs(count)
        gradient = struct_of(toi_adjoint.MinimaGradients, of_minima)
        launch(toi_adjoint.gather_pairs, count, [check, mesh, keys, listed, attained, gradient], [pairs])
        self._sort(columns["column_vertex"], columns["columns"], 4 * count, mesh.num_vertices.bit_length())
        slopes = struct_of(
            toi_slope.Slopes, {name: self._empty(dtype, count) for name, dtype in dtypes_of(toi_slope.Slopes).items()}
        )
        of = columns.get
        inputs = [self._query, -1, *map(of, ("kinds", "points_t0", "points_t1", "toi", "status"))]
        launch(toi_slope.fill_slopes, count, [*inputs, of("distances"), of("planes"), of("toi_gradient")], [slopes])
        return Attaining(count, keys, listed, attained, pairs, slopes)

    def change_gradients(self, attaining: Attaining, of_minima: Mapping[str, wp.array]) -> None:
        """Let these contacts have other gradients of the same minima."""
        gradient = struct_of(toi_adjoint.MinimaGradients, of_minima)
        inputs = [self._check, self._mesh, attaining.keys, attaining.listed, attaining.attained, gradient]
        self._step.execution.launch(toi_adjoint.change_gradients, attaining.num_rows, inputs, [attaining.pairs])

    def add_rows(self, attaining: Attaining, given: Given, gradients: tuple[wp.array | None, wp.array | None]) -> None:
        """Add what these contacts contribute to the gradients of the input."""
        mesh, form = self._step.topology.mesh, given.form
        rows = specialised("step.toi_adjoint_rows", real=form.real, dimension=mesh.dimension)
        out = rows.RowGradients()
        for name, array in zip(("vertices_t0", "vertices_t1"), gradients, strict=True):
            if array is not None:
                setattr(out, name, array)
        if given.radius is not None:
            out.radius = given.radius.grad
        out.t0_by_vertex, out.t1_by_vertex = int(form.t0_by_vertex), int(form.t1_by_vertex)
        out.is_displacement = int(form.is_displacement)
        num_columns, moving_row = 4 * attaining.num_rows, self._step.contact_arrays.moving_row("gradients")
        inputs = [attaining.pairs, num_columns, attaining.slopes, mesh.num_vertices, moving_row]
        self._step.execution.launch(rows.add_rows, num_columns, inputs, [out])

    def ratings(
        self,
        per: str,
        attaining: Attaining | None,
        hold: wp.array | None = None,
        vertex_rating: wp.array | None = None,
    ) -> wp.array:
        """The rating of each minimum of a kind (`regularity`), given those of vertices, from what attains it."""
        ratings = self._full(int(regularity.UNKNOWN), len(self.tois[TOIS[per]]), wp.int32)
        if attaining is not None:
            inputs = [self._check, self._mesh, attaining.keys, attaining.listed, attaining.attained]
            inputs += [attaining.slopes.is_regular, hold, vertex_rating]
            self._step.execution.launch(regularity.rate_minima, attaining.num_rows, inputs, [ratings])
        return ratings

    def all_ones(self, per: str) -> dict[str, wp.array]:
        """Gradients of 1 of all minima of a kind."""
        return {per: wp.full(len(self.tois[TOIS[per]]), value=1.0, dtype=wp.float64, device=self._device)}

    def _new_pairs(self, count: int) -> tuple[Any, dict[str, wp.array]]:
        """A table of so many pairs, and its columns by name."""
        dtypes = dtypes_of(toi_adjoint.Pairs)
        if self._radius is None:
            dtypes = {name: dtypes[name] for name in dtypes.keys() - {"distances", "radius_columns"}}
        columns = {name: self._empty(dtype, count) for name, dtype in dtypes.items()}
        columns |= {name: self._empty(wp.vec3d, (count, 4)) for name in ("points_t0", "points_t1")}
        columns |= {name: self._empty(wp.int32, 8 * count) for name in ("column_vertex", "columns")}
        return struct_of(toi_adjoint.Pairs, columns), columns

    def _sort(self, keys: wp.array, values: wp.array, count: int, num_bits: int = 64) -> None:
        """Sort the first values by their keys, stably; both arrays have space for twice as many."""
        if self._is_read and count < _FEW:
            of_keys, of_values = (x.numpy()[:count] for x in (keys, values))
            order = np.argsort(of_keys, kind="stable")
            of_keys[...], of_values[...] = of_keys[order], of_values[order]
        else:
            wp.utils.radix_sort_pairs(keys, values, count, end_bit=num_bits)


def as_flags(execution: Execution, ratings: wp.array) -> wp.array:
    """Whether each rating is that of what is regular, bool."""
    flags: wp.array = wp.empty(len(ratings), dtype=wp.bool, device=ratings.device)
    execution.launch(regularity.note_regular, len(ratings), [ratings], [flags])
    return flags
