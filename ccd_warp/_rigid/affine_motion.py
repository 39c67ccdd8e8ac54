"""Motions of bodies whose vertices are affine functions of their places: they move on straight lines."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._rigid.poses import checked_rows, read_only, shown_bodies, shown_body
from ccd_warp._runtime.read_only import ReadOnly
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.input.arrays import as_array, as_positions, check_finite, validated_indices


class AffineMotion(ReadOnly):
    """How bodies move in a step whose vertices are affine functions of their places, as in affine body dynamics.

    A body's vertices X stand in its own frame and are at A X + b, with A and b at both ends of the step. In between
    they move on straight lines, as those of any deforming body: nothing but where they start and end is new.

    Args:
        affine_t0: [A | b] at t = 0, [B, 3, 4], or [W, B, 3, 4] with worlds; arrays as of :class:`RigidMotion`.
        affine_t1: Those at t = 1, of as many bodies and worlds.

    Raises:
        ValueError: If shapes do not fit, or a number is not finite. It names the argument and the body.

    A motion does not change; its arrays are read-only.

    Guarantee: calls are never late for the positions that :meth:`positions_t0` and :meth:`positions_t1` give, each
    rounded to float64.
    """

    def __init__(self, affine_t0: ArrayLike, affine_t1: ArrayLike) -> None:
        form = "shape (B, 3, 4), with an axis of worlds before the others if there are several"
        start, self._leading = checked_rows(affine_t0, "affine_t0", ((3, 4),), form)
        end, shape = checked_rows(affine_t1, "affine_t1", ((3, 4),), form)
        if shape != self._leading:
            raise ValueError(f"affine_t1 has shape {(*shape, 3, 4)}; expected {(*self._leading, 3, 4)} like affine_t0")
        self._affine_t0, self._affine_t1 = read_only(start), read_only(end)

    @property
    def num_bodies(self) -> int:
        """Number of bodies, in each world."""
        return self._leading[-1]

    @property
    def num_worlds(self) -> int:
        """Number of worlds; 1 where the maps have no axis of them."""
        return self._leading[0] if len(self._leading) == 2 else 1

    @property
    def affine_t0(self) -> NDArray[np.float64]:
        """The maps at t = 0, float64, shape [B, 3, 4], or [W, B, 3, 4] with worlds."""
        return self._affine_t0.reshape(*self._leading, 3, 4)

    @property
    def affine_t1(self) -> NDArray[np.float64]:
        """The maps at t = 1, of the form of ``affine_t0``."""
        return self._affine_t1.reshape(*self._leading, 3, 4)

    def positions_t0(self, points: ArrayLike, body: ArrayLike) -> NDArray[np.float64]:
        """Places in the world at t = 0 of points of the bodies' frames.

        Args:
            points: In the bodies' frames, shape [n, 3].
            body: Body of each point, integers in [0, B), shape [n].

        Returns:
            Positions, float64, shape [n, 3], or [W, n, 3] with worlds.

        Raises:
            ValueError: If shapes do not fit, a point is not finite, or there is no such body.
        """
        return self._positions(self._affine_t0, points, body)

    @text_completed_by(positions_t0)
    def positions_t1(self, points: ArrayLike, body: ArrayLike) -> NDArray[np.float64]:
        """Places in the world at t = 1 of points of the bodies' frames."""
        return self._positions(self._affine_t1, points, body)

    def _ends(
        self, rows: NDArray[np.float64], first: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places at both ends of rows of the bodies' frames, body after body, which begin at these rows.

        Raises:
            ValueError: If the rows are in the plane, and a map leads out of it.
        """
        counts, columns = np.diff(np.append(first, len(rows))), rows.shape[1]
        ends = []
        for k, maps in enumerate((self._affine_t0, self._affine_t1)):
            across = maps[:, 2, [0, 1, 3]]
            for body in np.flatnonzero(across.any(axis=1))[:1].tolist() if columns == 2 else ():
                raise ValueError(
                    f"affine_t{k} takes {shown_body(body, self._leading)} out of the plane of the mesh: its third row "
                    f"is {maps[body, 2].tolist()}; expected 0 in all of its columns but the third"
                )
            maps_of_rows = np.repeat(maps[:, :columns], counts, axis=0)
            ends.append((maps_of_rows[..., :columns] * rows[:, None]).sum(axis=-1) + maps_of_rows[..., 3])
        return ends[0], ends[1]

    def _positions(self, maps: NDArray[np.float64], points: Any, body: Any) -> NDArray[np.float64]:
        places = as_positions(points, "points", 3)
        check_finite(places, "points")
        indices = as_array(body, "body", "shape (n,)")
        if indices.shape != places.shape[:1]:
            raise ValueError(f"body has shape {indices.shape}; expected {places.shape[:1]}, as many as points")
        bodies = validated_indices(indices[:, None], 1, self.num_bodies, "body")[:, 0]
        maps_of_points = maps.reshape(-1, self.num_bodies, 3, 4)[:, bodies]
        positions = (maps_of_points[..., :3] * places[:, None]).sum(axis=-1) + maps_of_points[..., 3]
        return positions.reshape(*self._leading[:-1], -1, 3)

    def __repr__(self) -> str:
        return f"AffineMotion({shown_bodies(self._leading)})"
