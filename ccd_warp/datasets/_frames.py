"""Frames of the public data: the mesh at both ends of a step."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.frames import read_frames, write_mesh
from ccd_warp._input.arguments import check_instance, check_path, shown
from ccd_warp._input.arrays import as_array, as_float64
from ccd_warp.datasets._paths import DEPTHS, replacing, root_folder, scene_name


@dataclass(frozen=True, eq=False)
class SimulationStep:
    """A mesh at both ends of a step.

    Attributes:
        vertices_t0: Positions at the start, in the file's length unit, float64, shape [V, 3].
        vertices_t1: Positions at the end, same shape.
        faces: Vertex indices, int32, shape [F, 3].
    """

    vertices_t0: np.ndarray
    vertices_t1: np.ndarray
    faces: np.ndarray

    def __repr__(self) -> str:
        return f"SimulationStep({len(self.vertices_t0):,} vertices, {len(self.faces):,} faces)"


def read_step(start_path: str | Path, end_path: str | Path, *, max_bytes: int = MAX_BYTES) -> SimulationStep:
    """Read the two frames of a step.

    Args:
        start_path: PLY file of the start positions; OBJ, STL, OFF, GLB and archives of them are accepted, too.
        end_path: PLY file of the end positions, with the same faces.
        max_bytes: Limit on the unpacked size of an archive; a plain file may have as much, or 1 GiB.

    Returns:
        The mesh at both ends, with vertices and faces in the order of the files.

    Raises:
        ValueError: If a file is missing, damaged or cut short, unpacks to more than the limit, holds no triangles or
            non-finite vertices, or the two differ in their faces.

    References:
        Belgrod et al. 2023.
    """
    start, end = check_path("start_path", start_path), check_path("end_path", end_path)
    body = read_frames(start, end, max_bytes=max_bytes)
    return SimulationStep(body.vertices_t0, body.vertices_t1, body.faces.astype(np.int32))


def write_step(start_path: str | Path, end_path: str | Path, step: SimulationStep) -> None:
    """Write the two frames of a step as PLY, float64, little endian.

    Args:
        start_path: PLY file of the start positions, replaced where it exists.
        end_path: PLY file of the end positions, the same.
        step: The mesh at both ends.

    Raises:
        ValueError: If a path does not end in .ply, the positions differ in shape, are not finite or not exactly
            float64, or a face refers to a vertex that does not exist.
        OSError: If a file cannot be written.

    References:
        Belgrod et al. 2023.

    Guarantee: `read_step` gives the same numbers back; after an error neither file is half-written.
    """
    start, end = check_path("start_path", start_path), check_path("end_path", end_path)
    check_instance("step", step, SimulationStep)
    for name, path in (("start_path", start), ("end_path", end)):
        if path.suffix.lower() != ".ply":
            raise ValueError(f"{name} is {path}; expected a name that ends in .ply")
    if start.resolve() == end.resolve():
        raise ValueError(f"end_path is {end}, as start_path is; expected another file")
    frames: list[np.ndarray] = []
    for name in ("vertices_t0", "vertices_t1"):
        given = getattr(step, name)
        vertices = as_array(given, name, "shape (V, 3)")
        shape = (len(frames[0] if frames else vertices), 3)
        if vertices.shape != shape:
            raise ValueError(f"{name} has shape {vertices.shape}; expected {shape}")
        frames.append(as_float64(vertices, name, given))
        bad = np.flatnonzero(~np.isfinite(frames[-1]).all(axis=1))
        if bad.size:
            raise ValueError(f"{name}[{bad[0]}] is {frames[-1][bad[0]].tolist()}; expected finite positions")
    faces = as_array(step.faces, "faces", "integers of shape (F, 3)")
    if faces.dtype.kind not in "iu":
        raise ValueError(f"faces has dtype {shown(faces.dtype)}; expected integers")
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise ValueError(f"faces has shape {faces.shape}; expected (F, 3) with one face or more")
    if faces.min() < 0 or faces.max() >= shape[0]:
        raise ValueError(f"faces holds indices from {faces.min()} to {faces.max()}; expected 0 to {shape[0] - 1}")
    with replacing(start) as unfinished_start, replacing(end) as unfinished_end:
        write_mesh(unfinished_start, frames[0], faces)
        write_mesh(unfinished_end, frames[1], faces)


def find_steps(folder: str | Path) -> dict[str, tuple[Path, Path]]:
    """Find the frames of every simulation step under a folder of public data.

    Args:
        folder: The root of the data, its part "simulation", or a single scene.

    Returns:
        The first and the second frame of each scene that has frames, in the order of their numbers, for `read_step`; by
        the name of the scene relative to the folder, such as "simulation/cloth-funnel", sorted. Empty where no scene
        has frames.

    Raises:
        ValueError: If the folder is missing, or a scene does not have two frames that are named by numbers.

    References:
        Belgrod et al. 2023.
    """
    root = root_folder(folder)
    scenes: dict[str, list[Path]] = {}
    for path in sorted(path for depth in DEPTHS for path in root.glob(f"{depth}frames/*.ply")):
        scenes.setdefault(scene_name(path.parents[1], root), []).append(path)
    steps = {}
    for name, paths in sorted(scenes.items()):
        if len(paths) != 2 or not all(path.stem.isdecimal() for path in paths):
            names = ", ".join(path.name for path in paths)
            raise ValueError(f"{paths[0].parent} holds {names}; expected two frames named by numbers, such as 1.ply")
        start, end = sorted(paths, key=lambda path: int(path.stem))
        steps[name] = (start, end)
    return steps
