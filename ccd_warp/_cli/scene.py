"""The scene of a command line: the bodies of its files, and the mesh that its arguments make of them."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ccd_warp._calls.pipeline import CollisionPipeline
from ccd_warp._files.bodies import Body, mesh_of, static_bodies
from ccd_warp._files.sequence import FrameSequence
from ccd_warp._files.series import FileSeries, find_series
from ccd_warp._results.intersections import Intersections
from ccd_warp._runtime.display import counted
from ccd_warp._runtime.status import CCDStatus
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.excluded_pairs import ExcludedPairs, joined_pairs, validated_excluded_pairs
from ccd_warp._scene.input.messages import InputError, printable
from ccd_warp._scene.input.names import distinct_names
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh


def open_sequence(arguments: argparse.Namespace, paths: list[Path]) -> FrameSequence:
    """The frames of files, in one order if there are just two of a step."""
    options = {"displacement": arguments.displacement, "surface": arguments.surface}
    is_step = arguments.command == "run"
    series = [FileSeries(paths[0].name, paths, **options)] if is_step else find_series(paths, **options)
    return FrameSequence(series, _obstacles(arguments), partial(make_mesh, arguments), split=arguments.split)


def _obstacles(arguments: argparse.Namespace) -> list[Body]:
    """The bodies of ``--static`` and ``--half-space``; these are called "half-space" where they have no name."""
    bodies = static_bodies(arguments.static, surface=arguments.surface, split=arguments.split)
    for text in arguments.half_space:
        name, _, numbers = text.rpartition("=")
        try:
            x, y, z, nx, ny, nz = map(float, numbers.split(","))
        except ValueError:
            expected = "X,Y,Z,NX,NY,NZ, a point and a normal, or NAME=X,Y,Z,NX,NY,NZ"
            raise InputError(f"--half-space {printable(text)}: expected {expected}") from None
        bodies.append(Body(name or "half-space", half_space=HalfSpace([x, y, z], [nx, ny, nz])))
    return bodies


def make_mesh(arguments: argparse.Namespace, bodies: Sequence[Body]) -> CollisionMesh:
    """The bodies as one mesh."""
    names = distinct_names([body.name for body in bodies])
    moving = [name for name, body in zip(names, bodies, strict=True) if not body.is_static]
    mesh = mesh_of(
        bodies,
        self_collision=not arguments.no_self_collision,
        kinematic=[names.index(moving[_body("--kinematic", name, moving)]) for name in arguments.kinematic],
        radius=_radii(arguments.radius, names, bodies),
        exclusion_rings=arguments.exclusion_rings,
    )
    pairs = [_body_pair(text, names) for text in arguments.exclude]
    return mesh.excluding({"bodies": pairs}) if pairs else mesh


def _body(option: str, name: str, names: Sequence[str]) -> int:
    """The index of the body of this name."""
    if name not in names:
        expected = ", ".join(map(printable, names[:8])) + (", ..." if len(names) > 8 else "")
        raise InputError(f"{option} {printable(name)}: no such body; expected one of {expected}")
    return names.index(name)


def _radii(texts: Sequence[str], names: Sequence[str], bodies: Sequence[Body]) -> list[float] | None:
    """A radius for each body, the last one given for it, 0 where there is none; half-spaces take no part in "all"."""
    radii = [0.0] * len(bodies)
    for text in texts:
        name, is_of_body, number = text.rpartition("=")  # a name may hold the sign itself
        try:
            radius = float(number)
        except ValueError:
            raise InputError(f"--radius {printable(text)}: expected a number, or NAME=NUMBER for one body") from None
        if is_of_body:
            radii[_body("--radius", name, names)] = radius
        else:
            radii = [radius if body.half_space is None else 0.0 for body in bodies]
    return radii if texts else None


def _body_pair(text: str, names: Sequence[str]) -> list[int]:
    """Two bodies, given as ``A,B``; a name may hold a comma itself."""
    words = text.split(",")
    if len(words) < 2:
        raise InputError(f"--exclude {printable(text)}: expected A,B, the names of two bodies")
    cut = next((k for k in range(1, len(words)) if ",".join(words[:k]) in names), 1)
    return [_body("--exclude", ",".join(part), names) for part in (words[:cut], words[cut:])]


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
        with CollisionPipeline._borrowed(mesh, options) as pipeline:
            contacts = pipeline.mesh_ccd(vertices, vertices).contacts
            near = pipeline.find_proximity(vertices, options.minimum_distance + rounding)
            start = pipeline.find_intersections(vertices)
        touching = contacts[contacts.status == int(CCDStatus.INITIAL_CONTACT)]
        pairs = joined_pairs(*(validated_excluded_pairs(pair_list, mesh) for pair_list in (touching, near)))
        return cls(pairs, start.primitives[start.is_crossing])

    def others(self, start: Intersections) -> Intersections:
        """What intersects at the start of a step, without the edges that passed through the same faces at first."""
        now, first = (rows[:, 0].astype(np.int64) << 32 | rows[:, 1] for rows in (start.primitives, self.crossing))
        return start[~(start.is_crossing & np.isin(now, first))]

    def __str__(self) -> str:
        touching = counted(sum(map(len, self.pairs.values())), "pair that touches", "pairs that touch")
        crossing = counted(len(self.crossing), "edge that passes", "edges that pass")
        through = f" and {crossing} through a face" if len(self.crossing) else ""
        return f"{touching}{through} in the first frame (--ignore-start-contacts)"
