"""What the command line says of the mesh beside its bodies: radii, kinematic bodies, excluded pairs."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ccd_warp import CollisionPipeline
from ccd_warp._cli.radii import radii_of
from ccd_warp._display import counted
from ccd_warp._files.frames import Body
from ccd_warp._input.excluded_pairs import ExcludedPairs, joined_pairs, validated_excluded_pairs
from ccd_warp._input.messages import InputError, printable
from ccd_warp._input.names import distinct_names
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh
from ccd_warp._status import CCDStatus

if TYPE_CHECKING:
    from ccd_warp._intersections import Intersections


@dataclass(frozen=True)
class SceneArguments:
    """The arguments of the command line of which, with the bodies, a mesh is made.

    Attributes:
        self_collision: Whether a body may collide with itself.
        radius: Of all bodies, or of one, see :func:`radii_of`.
        kinematic: Names of bodies that move as they are told.
        exclusion_rings: As of ``CollisionMesh.from_arrays``.
        exclude: File of pairs that are excluded; None if there is none.
    """

    self_collision: bool = True
    radius: Sequence[str] = ()
    kinematic: Sequence[str] = ()
    exclusion_rings: int = 1
    exclude: Path | None = None

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> "SceneArguments":
        """Those that are given."""
        return cls(
            not arguments.no_self_collision,
            arguments.radius,
            arguments.kinematic,
            arguments.exclusion_rings,
            arguments.exclude,
        )

    def mesh(self, bodies: Sequence[Body], *, rigid: Sequence[int] = ()) -> CollisionMesh:
        """The bodies as one mesh, of which some are rigid."""
        from ccd_warp._frames import mesh_of

        names = distinct_names([body.name for body in bodies])
        mesh = mesh_of(
            bodies,
            self_collision=self.self_collision,
            kinematic=_kinematic_bodies(self.kinematic, names, bodies),
            radius=radii_of(self.radius, names, [body.half_space is not None for body in bodies]),
            exclusion_rings=self.exclusion_rings,
            rigid=rigid,
        )
        if self.exclude is None:
            return mesh
        from ccd_warp._cli.exclusions import read_exclusions

        return read_exclusions(self.exclude, mesh)

    def plain(self) -> dict[str, Any]:
        """What JSON holds of them: the text of the file is its business."""
        return {**vars(self), "exclude": self.exclude and str(self.exclude)}


def _kinematic_bodies(given: Sequence[str], names: Sequence[str], bodies: Sequence[Body]) -> list[int]:
    """The bodies that ``--kinematic`` names, each of which moves."""
    moving = [name for name, body in zip(names, bodies, strict=True) if not body.is_static]
    for name in given:
        if name not in moving:
            known = ", ".join(map(printable, moving[:8])) + (", …" if len(moving) > 8 else "")
            raise InputError(
                f"--kinematic {printable(name)}: no body that moves has this name; expected one of {known}"
            )
    return [names.index(name) for name in given]


@dataclass(frozen=True)
class StartContacts:
    """What is in contact in the first frame, which ``--ignore-start-contacts`` leaves out of every step.

    Attributes:
        pairs: Pairs of primitives that touch, or nearly so, by kind, as ``CollisionMesh.excluding`` takes them.
        crossing: Edges and the faces through which they pass, shape [k, 2].
    """

    pairs: ExcludedPairs
    crossing: np.ndarray

    @classmethod
    def of(cls, mesh: CollisionMesh, vertices: np.ndarray, options: Options) -> "StartContacts":
        """Of positions: what touches where nothing moves, what is nearer than the tolerance, and what crosses."""
        rounding = options.tolerance * (mesh.length_scale if options.length_scale is None else options.length_scale)
        with CollisionPipeline.borrowed(mesh, options) as pipeline:
            contacts = pipeline.mesh_ccd(vertices, vertices).contacts
            near = pipeline.find_proximity(vertices, options.minimum_distance + rounding)
            start = pipeline.find_intersections(vertices)
        touching = contacts[contacts.status == int(CCDStatus.INITIAL_CONTACT)]
        pairs = joined_pairs(*(validated_excluded_pairs(found, mesh) for found in (touching, near)))
        return cls(pairs, start.primitives[start.is_crossing])

    def others(self, start: "Intersections") -> "Intersections":
        """What intersects at the start of a step, without the edges that passed through the same faces at first."""
        now, first = (each[:, 0].astype(np.int64) << 32 | each[:, 1] for each in (start.primitives, self.crossing))
        return start[~(start.is_crossing & np.isin(now, first))]

    def __str__(self) -> str:
        touching = counted(sum(map(len, self.pairs.values())), "pair that touches", "pairs that touch")
        crossing = counted(len(self.crossing), "edge that passes", "edges that pass")
        through = f" and {crossing} through a face" if len(self.crossing) else ""
        return f"{touching}{through} in the first frame (--ignore-start-contacts)"
