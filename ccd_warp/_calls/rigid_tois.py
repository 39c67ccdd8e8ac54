"""The earliest tois of worlds of rigid bodies by their poses, and how they change, as PyTorch and JAX ask for them."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._calls.motions import worlds_of
from ccd_warp._calls.pipeline import CollisionPipeline
from ccd_warp._results.results import MeshResult
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._runtime.display import counted
from ccd_warp._runtime.lazy import lazy_property

Array = NDArray[np.float64]


class RigidTois:
    """The earliest toi of each world of a motion.

    Attributes:
        toi: The tois, float64, of the shape of the worlds; inf where nothing touches.
    """

    def __init__(self, pipeline: CollisionPipeline, pivot: ArrayLike | None, is_twist: bool, *ends: Array) -> None:
        """Search the step of poses at the start and poses, or twists, at the end, shape [..., B, 7] or [..., B, 6].

        Raises:
            ValueError: If the numbers, or the bodies of the mesh, do not fit.
        """
        self._ends, self._is_twist, worlds = ends, is_twist, ends[0].shape[:-2]
        if worlds:  # whatever the number of their axes
            rows = int(np.prod(worlds))
            ends = tuple(end.reshape(rows, *end.shape[-2:]) for end in ends)
            pivot = np.reshape(pivot, (rows, -1, 3)) if pivot is not None and np.ndim(pivot) > 2 else pivot
        step: dict[str, Any] = {"twist": ends[1]} if is_twist else {"poses_t1": ends[1]}
        self._motion = RigidMotion(ends[0], pivot=pivot, **step)
        result = _first_contacts(pipeline, self._motion)
        toi, contact = result.world_toi, result.world_contact
        if not worlds:
            toi, contact = np.array([result.toi]), contact[[np.argmin(toi)]]
        elif len(toi) != rows:
            raise ValueError(
                f"poses_t0 is of {counted(rows, 'world', 'worlds')}; expected {len(toi)}, which the mesh has, or a "
                "mesh of one"
            )
        self.toi = toi.reshape(worlds)
        self._contacts = result.contacts[contact[contact >= 0]]

    @lazy_property
    def gradients(self) -> tuple[Array, Array]:
        """d toi / d poses at the start, and by poses, or twists, at the end, of the shapes of these.

        A quaternion counts with the length that it has, on which nothing depends.
        """
        gradient, motion = self._contacts.toi_gradient(), self._motion
        of_contacts = motion.gradient_by_twist(gradient) if self._is_twist else motion.gradient_by_poses(gradient)
        points = motion._turning_points(gradient)
        first, second = (np.zeros(end.shape) for end in self._ends)
        for of_ends, end, of_sides in zip((first, second), self._ends, of_contacts, strict=True):
            if points is not None:
                contacts, sides = np.nonzero(points.rows >= 0)
                of_ends.reshape(-1, end.shape[-1])[points.rows[contacts, sides]] = of_sides[contacts, sides]
            if end.shape[-1] == 7:
                of_ends[..., 3:] /= np.hypot.reduce(end[..., 3:], axis=-1, keepdims=True)
        return first, second


def _first_contacts(pipeline: CollisionPipeline, motion: RigidMotion) -> MeshResult:
    """What `mesh_ccd` finds; where many worlds are searched, of each only contacts among which its first is."""
    x = pipeline.mesh.vertices
    worlds = worlds_of(pipeline, x, x, motion, check_start=False)
    if worlds is None:
        return pipeline._contacts(x, x, motion)
    result = worlds.result(is_of_first=True)
    pipeline.counts, pipeline.timings = result.counts, result.timings
    return result


def checked_end(poses_t0: Any, poses_t1: Any, twist: Any) -> Any:
    """The poses at the end, or the twists, of tensors or arrays whose types and shapes fit.

    Raises:
        ValueError: If they do not.
    """
    if (poses_t1 is None) == (twist is None):
        which = "both" if twist is not None else "neither"
        raise ValueError(f"{which} of poses_t1 and twist is given; expected one of them")
    end = ("twist", twist, 6) if poses_t1 is None else ("poses_t1", poses_t1, 7)
    bodies = tuple(getattr(poses_t0, "shape", ()))[:-1]
    for name, array, columns in (("poses_t0", poses_t0, 7), end):
        dtype, shape = getattr(array, "dtype", None), tuple(getattr(array, "shape", ()))
        if str(dtype).removeprefix("torch.") not in ("float32", "float64") or not bodies or shape != (*bodies, columns):
            expected = "shape (..., B, 7)" if array is poses_t0 else f"shape {(*bodies, columns)} as of poses_t0"
            raise ValueError(f"{name} has dtype {dtype} and shape {shape}; expected float32 or float64 and {expected}")
    return end[1]
