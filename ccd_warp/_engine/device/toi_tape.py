"""A launch on a tape: what its backward pass needs is kept, and one function is recorded."""

from dataclasses import replace
from typing import Any

import warp as wp

from ccd_warp._device_results import LaunchResult
from ccd_warp._engine.device.input import PreparedLaunch
from ccd_warp._engine.device.step import DeviceStep
from ccd_warp._engine.host.contacts import new_contact_list
from ccd_warp._engine.mesh.planes import planes_of
from ccd_warp._input.interop import as_positions, without_worlds
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp._runtime.tape import active_tape
from ccd_warp.kernels.step import toi_adjoint, toi_slope
from ccd_warp.kernels.template import specialised

_TOIS = ("toi", "world_toi", "body_toi", "vertex_toi")
_NO_KEY = int(toi_adjoint.NO_KEY)


class TapedLaunch:
    """The last launch of a step, whose minima get gradients with respect to its input.

    What the backward pass needs is computed from the positions now, so that these and the results may be overwritten.

    Attributes:
        result: The result, with tois of its own, which later launches do not overwrite.
    """

    def __init__(self, step: DeviceStep, prepared: PreparedLaunch, given: tuple[Any, Any], radius: Any) -> None:
        """Compute it for arguments of a launch and the radii, and record the backward pass on the active tape."""
        touch = step.touch()
        self._step, self._form = step, prepared.form
        self._rows = [len(prepared.vertices_t0), len(prepared.vertices_t1)]
        self._given = [x if isinstance(x, wp.array) and x.requires_grad else None for x in (*given, radius)]
        self._capacity = len(step.result.contacts.kind)
        self._moving_row = step.contact_arrays.moving_row("gradients")
        self._query = touch.query(is_planar=step.topology.mesh.dimension == 2)
        self._keep(touch.separation, radius)
        self.result = self._new_result(step.result)
        self._attain(step.result)
        tois = {id(x): x for x in (getattr(self.result, name) for name in _TOIS)}
        active_tape().record_func(self._backward, [*tois.values(), *(x for x in self._given if x is not None)])

    def _empty(self, dtype: Any, count: int | tuple[int, int] | None = None) -> wp.array:
        count = self._capacity if count is None else count
        return wp.empty(count, dtype=dtype, device=self._step.topology.device)

    def _full(self, count: int) -> wp.array:
        return wp.full(count, value=_NO_KEY, dtype=wp.int64, device=self._step.topology.device)

    def _keep(self, separation: float, radius: wp.array | None) -> None:
        """Gather the pairs."""
        step, capacity = self._step, self._capacity
        topology, planes = step.topology, planes_of(step.topology)
        columns = dtypes_of(toi_adjoint.Pairs)
        if radius is None:
            columns = {name: columns[name] for name in columns.keys() - {"distances", "radius_columns"}}
        self._columns = {name: self._empty(dtype) for name, dtype in columns.items()}
        self._columns |= {name: self._empty(wp.vec3d, (capacity, 4)) for name in ("points_t0", "points_t1")}
        self._pairs = struct_of(toi_adjoint.Pairs, self._columns)
        positions = step.last_positions()
        assert positions is not None
        inputs = [new_contact_list(vars(step.result.contacts)), *(topology.corners[kind] for kind in ("edge", "face"))]
        inputs += [*positions, topology.vertex_body, planes.point, planes.vertex, planes.body]
        inputs += [separation, radius, *(topology.neighbours if radius is not None else (None, None))]
        step.execution.launch(toi_adjoint.gather_pairs, capacity, inputs, [self._pairs])

    def _new_result(self, result: LaunchResult) -> LaunchResult:
        """The result with copies of the tois, which require gradients."""
        copies: dict[str, Any] = {}
        for name in _TOIS:
            array = getattr(result, name)
            copies[name] = copies["toi"] if array is result.toi and copies else wp.empty_like(array, requires_grad=True)
            wp.copy(copies[name], array)
        return replace(result, **copies)

    def _attain(self, result: LaunchResult) -> None:
        """Find the contact that attains each minimum, the first of several in their order."""
        names = {"vertex": "vertex_toi", "body": "body_toi", "world": "world_toi", "scene": "toi"}
        tois = struct_of(toi_adjoint.Adjoints, {name: getattr(result, of) for name, of in names.items()})
        self._attained = struct_of(
            toi_adjoint.Attained, {name: self._full(len(getattr(result, of))) for name, of in names.items()}
        )
        inputs = [self._pairs, self._step.topology.vertex_world, tois]
        self._step.execution.launch(toi_adjoint.attain, self._capacity, inputs, [self._attained])

    def _backward(self) -> None:
        """Add the gradients of the input."""
        step, launch, capacity, result = self._step, self._step.execution.launch, self._capacity, self.result
        gradient = {"vertex": result.vertex_toi.grad, "body": result.body_toi.grad, "scene": result.toi.grad}
        if result.world_toi is not result.toi:
            gradient["world"] = result.world_toi.grad
        adjoint, order_keys = self._empty(wp.float64), self._empty(wp.int64, 2 * capacity)
        order, column_vertex = self._empty(wp.int32, 2 * capacity), self._empty(wp.int32, 8 * capacity)
        columns = self._empty(wp.int32, 8 * capacity)
        inputs = [self._pairs, step.topology.vertex_world, self._attained, struct_of(toi_adjoint.Adjoints, gradient)]
        launch(toi_adjoint.collect, capacity, inputs, [adjoint, order_keys, order])
        wp.utils.radix_sort_pairs(order_keys, order, capacity)
        mesh = step.topology.mesh
        inputs = [self._pairs, adjoint, order, mesh.num_vertices]
        launch(toi_adjoint.list_columns, capacity, inputs, [column_vertex, columns])
        wp.utils.radix_sort_pairs(column_vertex, columns, 4 * capacity, end_bit=mesh.num_vertices.bit_length())
        slopes = struct_of(
            toi_slope.Slopes, {name: self._empty(dtype) for name, dtype in dtypes_of(toi_slope.Slopes).items()}
        )
        of = self._columns
        inputs = [self._query, -1, *(of[name] for name in ("kinds", "points_t0", "points_t1", "toi", "status"))]
        launch(toi_slope.fill_slopes, capacity, [*inputs, of.get("distances"), of["planes"], adjoint], [slopes])
        rows = specialised("step.toi_adjoint_rows", real=self._form.real, dimension=mesh.dimension)
        out = rows.RowGradients()
        for name, array, count in zip(("vertices_t0", "vertices_t1"), self._given, self._rows, strict=False):
            if array is not None:
                grad = without_worlds(array.grad, name, mesh.rows_by_world, mesh.dimension)
                setattr(out, name, as_positions(grad, name, step.topology.device, {count: "as given"}, mesh.dimension))
        if self._given[2] is not None:
            out.radius = self._given[2].grad
        out.t0_by_vertex, out.t1_by_vertex = int(self._form.t0_by_vertex), int(self._form.t1_by_vertex)
        out.is_displacement = int(self._form.is_displacement)
        inputs = [self._pairs, slopes, adjoint, column_vertex, columns, 4 * capacity, self._moving_row]
        launch(rows.add_rows, mesh.num_vertices, inputs, [out])
