"""The arrays of a caller that get gradients in a backward pass."""

from dataclasses import dataclass
from typing import Any

import warp as wp

from ccd_warp._engine.device.input import Form
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._scene.input.interop import as_positions, without_worlds


@dataclass(frozen=True)
class CallerArrays:
    """The arrays of a caller that get gradients, None for those that do not require one, and what their rows are.

    Attributes:
        vertices_t0: Start positions.
        vertices_t1: End positions or displacements.
        radius: Radii of vertices.
        form: The form of the launch that has read them.
        rows: How many rows the positions have.
    """

    vertices_t0: wp.array | None
    vertices_t1: wp.array | None
    radius: wp.array | None
    form: Form
    rows: tuple[int, int]

    @classmethod
    def of(cls, positions: tuple[Any, Any], radius: Any, form: Form, rows: tuple[int, int]) -> "CallerArrays":
        """Of the arguments of a launch, and the radii."""
        t0, t1, r = (x if isinstance(x, wp.array) and x.requires_grad else None for x in (*positions, radius))
        return cls(t0, t1, r, form, rows)

    @property
    def arrays(self) -> list[wp.array]:
        """Those that get gradients."""
        return [x for x in (self.vertices_t0, self.vertices_t1, self.radius) if x is not None]

    def gradients(self, topology: Topology) -> tuple[wp.array | None, wp.array | None]:
        """The gradients of the positions, with a row for each as a launch reads them."""
        mesh, device = topology.mesh, topology.device
        gradients: list[wp.array | None] = []
        for name, count in zip(("vertices_t0", "vertices_t1"), self.rows, strict=True):
            array = getattr(self, name)
            if array is not None:
                grad = without_worlds(array.grad, name, mesh.rows_by_world, mesh.dimension)
                array = as_positions(grad, name, device, {count: "as given"}, mesh.dimension)
            gradients.append(array)
        return gradients[0], gradients[1]
