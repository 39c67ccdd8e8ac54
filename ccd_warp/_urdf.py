"""Robots from URDF files: joints, and the collision geometry of links as bodies."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.parsers.expat import ParserCreate

import numpy as np
from numpy.typing import ArrayLike

from ccd_warp._display import listed
from ccd_warp._files.mesh import Reading, read_mesh
from ccd_warp._files.opened import PLAIN_BYTES
from ccd_warp._input.arguments import check_path, shown
from ccd_warp._joints import Joint, JointTree
from ccd_warp._robot import Body, Robot

_KINDS = {"floating": "free"}  # what a joint is called here, where URDF has another word
_SIDES = 32  # of a cylinder
_UP = 1.0 + 1e-12  # so that what is around a shape is so in spite of rounding


def read_urdf(
    path: str | Path, *, base: ArrayLike | None = None, packages: Mapping[str, str | Path] | None = None
) -> Robot:
    """Read a robot from a URDF file. Needs the extra ``urdf``.

    The collision geometry of a link is one body. Boxes and meshes are taken as they are, meshes by the readers of this
    library, in float64 and not simplified. Cylinders and spheres become polyhedra around them, which are never smaller:
    a cylinder a prism of 32 sides, at most 0.5 % of its radius larger, a sphere one of 1,280 faces, at most 1 % larger.

    Args:
        path: The file.
        base: Where the root link stands in the world: position and quaternion x y z w, or a matrix [4, 4]; by default
            its frame is that of the world.
        packages: Folders of ROS packages by name, for meshes at ``package://name/…``; those of others are looked for
            in the folders around the file.

    Returns:
        The robot.

    Raises:
        ImportError: If the extra is not installed.
        ValueError: If the file is missing, no URDF, or has a joint that is none of :class:`Joint`'s, such as a planar
            one; if joints form no tree, or a mesh is missing or cannot be read.
    """
    try:
        import yourdfpy
    except ImportError as error:
        raise ImportError("read_urdf needs yourdfpy; install with: pip install 'ccd-warp[urdf]'") from error
    file = check_path("path", path)
    if packages is not None and not isinstance(packages, Mapping):
        raise ValueError(f"packages is {shown(packages)}; expected folders by the names of packages")
    folders = {name: check_path(f"packages[{name!r}]", folder) for name, folder in (packages or {}).items()}
    try:
        # the parser of robots would go on after what is no XML; names of other programs' elements may be of any space
        ParserCreate().Parse(file.read_bytes(), True)
        with _quiet("yourdfpy.urdf"):
            robot = yourdfpy.URDF.load(str(file), build_scene_graph=False, load_meshes=False).robot
    except Exception as error:  # whatever the parser raises where an element is missing
        raise ValueError(f"{file}: is no URDF file ({' '.join(str(error).split()) or type(error).__name__})") from error
    joints, mimics = _joints(file, robot, base)
    try:
        tree = JointTree(joints)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
    lone = [link.name for link in robot.links if link.name not in tree.index]
    if lone:
        raise ValueError(f"{file}: has the links {listed(lone)}, which no joint joins; expected one tree")
    with_shapes = {link.name: link.collisions for link in robot.links if link.collisions}
    bodies = [_body(file, folders, shapes) for shapes in with_shapes.values()]
    neighbours, static = _related(tree, tuple(with_shapes))
    moving = tuple(joint.name for joint in joints if joint.num_coordinates and joint.name not in mimics)
    return Robot(joints, moving, tuple(with_shapes), tuple(bodies), neighbours, static, mimics)


@contextmanager
def _quiet(logger: str) -> Iterator[None]:
    """Keep a library from writing to the log what is an error here."""
    log = logging.getLogger(logger)
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


def _joints(file: Path, robot: Any, base: Any) -> tuple[tuple[Joint, ...], dict[str, tuple[str, float, float]]]:
    """All joints, and those that mimic another one: which, the factor and what is added."""
    joints, mimics = [], {}
    links = {link.name for link in robot.links}
    for joint in robot.joints:
        for name in (joint.parent, joint.child):
            if name not in links:
                raise ValueError(
                    f"{file}: joint {joint.name!r} joins {name!r}, which is no link; expected one of the file"
                )
    carried = {joint.child for joint in robot.joints}
    roots = [link.name for link in robot.links if link.name not in carried]
    if base is not None or not robot.joints:
        world = next(name for name in ("world", *(f"world_{k}" for k in range(len(links) + 1))) if name not in links)
        origin = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0) if base is None else base
        joints += [Joint(f"{world} to {name}", world, name, "fixed", origin=origin) for name in roots]
    for joint in robot.joints:
        kind = _KINDS.get(joint.type, joint.type)
        origin = np.eye(4) if joint.origin is None else joint.origin
        axis = joint.axis.tolist() if kind in ("revolute", "continuous", "prismatic") else None
        try:
            joints.append(Joint(joint.name, joint.parent, joint.child, kind, axis, origin))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from None
        if joint.mimic is not None:
            factor, offset = joint.mimic.multiplier, joint.mimic.offset
            mimics[joint.name] = (joint.mimic.joint, 1.0 if factor is None else factor, offset or 0.0)
    single = {joint.name for joint in joints if joint.num_coordinates == 1}
    for name, (source, _, _) in mimics.items():
        if not {name, source} <= single or source in mimics:
            raise ValueError(
                f"{file}: joint {name!r} mimics {source!r}; expected a joint that turns or slides by itself"
            )
    return tuple(joints), mimics


def _body(file: Path, folders: Mapping[str, Path], shapes: Sequence[Any]) -> Body:
    """The collision geometry of a link, in its frame."""
    vertices, faces, count = [], [], 0
    for shape in shapes:
        v, f = _shape(file, folders, shape.geometry)
        if shape.origin is not None:
            v = v @ shape.origin[:3, :3].T + shape.origin[:3, 3]
        vertices.append(v)
        faces.append(f + count)
        count += len(v)
    return np.concatenate(vertices), np.concatenate(faces)


def _shape(file: Path, folders: Mapping[str, Path], geometry: Any) -> Body:
    from trimesh import creation

    if geometry.mesh is not None:
        mesh = read_mesh(_found(file, folders, geometry.mesh.filename), Reading(PLAIN_BYTES))
        vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
        used, faces = np.unique(faces, return_inverse=True)
        vertices, merged = np.unique(vertices[used], axis=0, return_inverse=True)
        scale = 1.0 if geometry.mesh.scale is None else geometry.mesh.scale
        return vertices * np.asarray(scale, dtype=np.float64), merged.reshape(-1)[faces.reshape(-1, 3)]
    if geometry.box is not None:
        made = creation.box(extents=geometry.box.size)
    elif geometry.cylinder is not None:
        around = geometry.cylinder.radius * (_UP / math.cos(math.pi / _SIDES))
        made = creation.cylinder(radius=around, height=geometry.cylinder.length * _UP, sections=_SIDES)
    else:
        made = creation.icosphere(subdivisions=3)
        nearest = np.einsum("ij,ij->i", made.face_normals, made.triangles[:, 0]).min()
        made.apply_scale(geometry.sphere.radius * _UP / nearest)
    return np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int64)


def _found(file: Path, folders: Mapping[str, Path], name: str) -> Path:
    """The file of a mesh, by its name in the URDF."""
    import yourdfpy

    package, _, inside = name.removeprefix("package://").partition("/")
    if name.startswith("package://") and package in folders:
        return folders[package] / inside
    with _quiet("yourdfpy.urdf"):
        found = Path(yourdfpy.filename_handler_magic(fname=name, dir=str(file.parent)))
    if not found.is_file():
        raise ValueError(f"{file}: has the mesh {name!r}, which is not found; expected packages= to say where it is")
    return found


def _related(tree: JointTree, names: tuple[str, ...]) -> tuple[frozenset[tuple[str, str]], tuple[str, ...]]:
    """Links with geometry that are neighbours, and those that never move."""
    beside: dict[str, set[str]] = {name: set() for name in tree.links}
    fixed: dict[str, str] = {}  # the first link of those that are fixed to each other
    for k in tree.order:
        link, joint = tree.links[k], tree.joints[tree.joint_of[k]] if tree.joint_of[k] >= 0 else None
        fixed[link] = link
        if joint is not None:
            beside[link].add(joint.parent)
            beside[joint.parent].add(link)
            if joint.kind == "fixed":
                fixed[link] = fixed[joint.parent]
    pairs = set()
    for name in names:
        seen, ahead = {name}, list(beside[name])
        while ahead:
            other = ahead.pop()
            if other not in seen:
                seen.add(other)
                ahead += [] if other in names else beside[other]
        near = {other for other in names if other in seen or fixed[other] == fixed[name]} - {name}
        pairs |= {(min(name, other), max(name, other)) for other in near}
    root = tree.links[tree.order[0]]
    return frozenset(pairs), tuple(name for name in names if fixed[name] == root)
