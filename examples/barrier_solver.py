"""A strip of jelly, thrown into a glass, folds: incremental potential contact (IPC) with a barrier of your own.

A step of backward Euler minimises inertia, elastic energy and a barrier that grows without bound as surfaces come near
(Li et al. 2020, "Incremental Potential Contact"). scikit-fem assembles the first two; for the barrier `find_proximity`
gives what is near. Newton's method goes downhill from the start of the step, as far as `collision_free_step` allows:
full steps end on the other side of the glass or of a fold, and no barrier knows from which side they came. The scene
runs twice, with CCD and with full steps. barrier_ipctk.py has the same by ipctk, to compare.

    pip install -e '.[examples]' && python examples/barrier_solver.py --output fold

It takes 30 s on two cores.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

import ccd_warp as ccd

try:
    import pyvista  # noqa: F401  # of the picture
    from igl.copyleft import cgal
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import splu
    from skfem import Basis, BilinearForm, ElementTetP1, ElementVector, Functional, LinearForm, MeshTet
    from skfem.helpers import ddot, det, dot, grad, inv, mul, trace, transpose
    from tqdm import tqdm
except ImportError as error:
    sys.exit(f"barrier_solver.py: {error}; install with: pip install 'ccd-warp[examples]'")

Array = NDArray[np.float64]
# Lengths in metres, times in seconds, masses in kilograms.
FRAME_TIME, GRAVITY, THROW = 1.0 / 40.0, np.array([0.0, 0.0, -9.81]), np.array([0.0, 0.0, -2.5])
STRIP, CELLS, HEIGHT, BOW, GLASS = (0.02, 0.04, 0.6), (2, 2, 40), 0.1, 0.02, (0.2, 0.05, 0.25)
DENSITY, YOUNG, POISSON = 1000.0, 2e4, 0.4
MU, LAMBDA = YOUNG / (2.0 + 2.0 * POISSON), YOUNG * POISSON / ((1.0 + POISSON) * (1.0 - 2.0 * POISSON))
RANGE, STIFFNESS = 2e-3, 2e8  # of the barrier, whose energy is of the fourth order in lengths
TOLERANCE, MOST_ITERATIONS = 3e-3, 100  # of Newton's method: the last change, as a velocity
KEY_FRAMES = (1, 3, 5, 7, 11)

INERTIA = BilinearForm(lambda u, v, _: DENSITY / FRAME_TIME**2 * dot(u, v))
# Neo-Hookean energy and its derivatives, by the deformation gradient F, its inverse, and log det F.
ENERGY = Functional(lambda w: MU / 2.0 * (ddot(w.F, w.F) - 3.0) - MU * w.log_j + LAMBDA / 2.0 * w.log_j**2)
GRADIENT = LinearForm(lambda v, w: MU * ddot(w.F, grad(v)) + (LAMBDA * w.log_j - MU) * trace(mul(w.inverse, grad(v))))


@BilinearForm
def HESSIAN(u: Any, v: Any, w: Any) -> Any:
    a, b = mul(w.inverse, grad(u)), mul(w.inverse, grad(v))
    return MU * ddot(grad(u), grad(v)) + (MU - LAMBDA * w.log_j) * ddot(a, transpose(b)) + LAMBDA * trace(a) * trace(b)


class Barrier:
    """Energy of all pairs, -(s - s₀)² log(s / s₀) at a squared distance s < s₀, and the step that is free."""

    def __init__(self, mesh: ccd.CollisionMesh) -> None:
        # a step leaves a tenth of the range between surfaces, or a fifth of what there is
        self.pipeline = ccd.CollisionPipeline(mesh, minimum_distance=0.1 * RANGE, start_gap_fraction=0.2)

    def energy(self, x: Array) -> tuple[float, tuple[ccd.Proximities, Array, Array]]:
        """The energy; pairs, a factor that goes to 0 as edges become parallel and directions jump, its derivative."""
        # all pairs, not unique(): so it has no jump where a closest point goes to the next face
        near = self.pipeline.find_proximity(x, RANGE)
        factor, slope = np.ones(len(near)), np.zeros((len(near), 4, 3))
        edges = near.kind == ccd.PairKind.EDGE_EDGE
        rest, now = (np.diff(y[near.vertices[edges]], axis=1)[:, ::2] for y in (near.mesh.vertices, x))
        cross, limit = np.cross(now[:, 0], now[:, 1]), 1e-3 * (rest**2).sum(axis=2).prod(axis=1)
        share = np.minimum((cross**2).sum(axis=1) / limit, 1.0)
        factor[edges] = share * (2.0 - share)
        turn = np.cross(now[:, ::-1], cross[:, None]) * [[1.0], [-1.0]] * (4.0 * (1.0 - share) / limit)[:, None, None]
        slope[edges] = np.stack([-turn, turn], axis=2).reshape(-1, 4, 3)
        s = near.distance**2
        return -STIFFNESS * (factor @ ((s - RANGE**2) ** 2 * np.log(s / RANGE**2))), (near, factor, slope)

    def derivatives(self, near: ccd.Proximities, factor: Array, slope: Array) -> tuple[Array, csr_array]:
        """Gradient, and Hessian b''(d) n nᵀ of each pair, positive semidefinite: without the curvature of distances."""
        d, s, size = near.distance, near.distance**2, near.positions.size
        log, excess = np.log(s / RANGE**2), s - RANGE**2
        first, second = -2.0 * excess * log - excess**2 / s, -2.0 * log - 4.0 * excess / s + (excess / s) ** 2
        by_corner = near.weights[..., None] * near.direction[:, None]  # the derivative of the distance
        gradient = (2.0 * factor * d * first)[:, None, None] * by_corner - (excess**2 * log)[:, None, None] * slope
        bend = STIFFNESS * factor * (4.0 * s * second + 2.0 * first)
        blocks = bend[:, None, None] * by_corner.reshape(-1, 12, 1) * by_corner.reshape(-1, 1, 12)
        rows = (3 * near.vertices[..., None] + np.arange(3)).reshape(-1, 12)
        entries = blocks.ravel(), (np.repeat(rows, 12, axis=1).ravel(), np.tile(rows, 12).ravel())
        return STIFFNESS * np.bincount(rows.ravel(), gradient.ravel(), size), csr_array(entries, shape=(size, size))

    def free_step(self, x: Array, end: Array) -> float:
        """Up to which fraction of the way nothing passes."""
        return self.pipeline.collision_free_step(x, end)


class Fold:
    """The simulation: positions of the nodes of the strip and of the glass, velocities of the former."""

    def __init__(self, contact: Any = Barrier) -> None:
        box = MeshTet.init_tensor(*map(np.linspace, 3 * [0.0], STRIP, np.add(CELLS, 1)))
        bow = BOW * np.sin(4.0 * (box.p[2] + HEIGHT))  # not quite straight, so that it folds
        strip = MeshTet(box.p + [bow - 0.5 * STRIP[0], 0.0 * bow - 0.5 * STRIP[1], 0.0 * bow + HEIGHT], box.t)
        glass = trimesh.creation.box(GLASS).apply_translation([0.0, 0.0, 0.5 * GLASS[2]])
        glass.update_faces(glass.face_normals[:, 2] < 0.5)  # open above
        self.mesh = ccd.CollisionMesh.from_volume(strip.p.T, strip.t.T, [(glass.vertices, glass.faces)], static=[1])
        self.basis = Basis(strip, ElementVector(ElementTetP1()), intorder=1)
        self.inertia = INERTIA.assemble(Basis(strip, self.basis.elem, intorder=2))
        self.x, self.velocity = self.mesh.vertices.copy(), np.tile(THROW, (strip.nvertices, 1))
        self.contact = contact(self.mesh)

    def state(self, x: Array, aim: Array) -> tuple[float, Array, dict[str, Array], Any]:
        """The energy, the gradient of inertia, and what other derivatives are computed from."""
        away, F = (x[: len(aim)] - aim).ravel(), grad(self.basis.interpolate(x[: len(aim)].ravel()))
        with np.errstate(invalid="ignore", divide="ignore"):  # not a number where an element is turned inside out
            fields = {"F": F, "inverse": inv(F), "log_j": np.log(det(F))}
        (barrier, near), force = self.contact.energy(x), self.inertia @ away
        return 0.5 * away @ force + ENERGY.assemble(self.basis, **fields) + barrier, force, fields, near

    def advance(self) -> list[float]:
        """One step of backward Euler; which fraction each iteration of Newton's method took of its step."""
        aim = self.x[: len(self.velocity)] + FRAME_TIME * (self.velocity + FRAME_TIME * GRAVITY)
        x, change, size, fractions = self.x, np.zeros_like(self.x), aim.size, []
        energy, force, fields, near = self.state(x, aim)
        while len(fractions) < MOST_ITERATIONS:
            push, stiffness = self.contact.derivatives(*near)
            hessian = HESSIAN.assemble(self.basis, **fields) + self.inertia + stiffness[:size, :size]
            gradient = force + GRADIENT.assemble(self.basis, **fields) + push[:size]
            while (uphill := splu(hessian.tocsc()).solve(gradient)) @ gradient < 0.0:
                hessian += self.inertia  # as where something buckles
            change[: len(aim)] = -uphill.reshape(-1, 3)
            if np.abs(change).max() < TOLERANCE * FRAME_TIME:
                break
            fraction = self.contact.free_step(x, x + change)
            while not (trial := self.state(x + fraction * change, aim))[0] <= energy:
                fraction *= 0.5
            x, (energy, force, fields, near) = x + fraction * change, trial
            fractions.append(fraction)
        self.velocity, self.x = (x - self.x)[: len(aim)] / FRAME_TIME, x
        return fractions


def run(name: str, scene: Fold, num_frames: int) -> list[tuple[str, Array]]:
    """Advance, check by CGAL's exact kernel, and print; the positions after each frame with a title."""
    positions, counts, steps, least, seconds = [], [], [], RANGE, 0.0
    for frame in tqdm(range(1, num_frames + 1), name, unit="frame", leave=False, disable=None):
        seconds -= time.perf_counter()
        steps.append(len(scene.advance()))
        seconds += time.perf_counter()
        counts.append(len(cgal.remesh_self_intersections(scene.x, scene.mesh.faces.astype(int), detect_only=True)[2]))
        least = ccd.find_proximity(scene.mesh, scene.x, RANGE).distance.min(initial=least)
        positions.append((f"{name}, frame {frame}:\n{counts[-1]} pairs of faces cross", scene.x))
    newton = np.array(steps)
    print(f"{name}: {num_frames} frames, {np.count_nonzero(counts)} with faces that cross, at most {max(counts)} pairs")
    print(f"  least distance {1e3 * least:.3f} mm; it moves until frame {np.flatnonzero(newton).max(initial=-1) + 1}")
    print(f"  {newton.mean():.1f} Newton steps a frame, at most {newton.max()}; {seconds / num_frames:.2f} s a frame")
    return positions


def draw(path: Path, mesh: ccd.CollisionMesh, rows: list[list[tuple[str, Array]]]) -> None:
    """Draw positions side by side, each run in a row."""
    from key_frames import draw_rows

    def add(pyvista: Any, plotter: Any, x: Array) -> None:
        strip, glass = (pyvista.PolyData.from_regular_faces(x, mesh.faces[mesh.face_body == b]) for b in (0, 1))
        plotter.add_mesh(strip, color="#f0a04b", show_edges=True, edge_color="#b0702b")
        plotter.add_mesh(glass, color="#8fb8d0", opacity=0.2)

    draw_rows(path, rows, add, [(0.25, -1.1, 0.43), (-0.03, 0.0, 0.2), (0.0, 0.0, 1.0)], size=(250, 410))


def main() -> None:
    """Run the scenes, compare, and draw."""
    parser = argparse.ArgumentParser(description="A strip folds in a glass, with CCD and without: 30 s on two cores.")
    parser.add_argument("--frames", type=int, default=100, help="40 a second (default 100)")
    parser.add_argument("--output", type=Path, help="folder for barrier_solver.png (none is drawn without)")
    options = parser.parse_args()
    if options.frames < 1:
        parser.error("expected --frames of at least 1")
    scene, full = Fold(), Fold()
    full.contact.free_step = lambda x, end: 1.0
    rows = [run("with CCD", scene, options.frames), run("without CCD", full, options.frames)]
    if options.output is not None:
        chosen = [k for k in KEY_FRAMES if k < options.frames] + [options.frames]
        draw(options.output / "barrier_solver.png", scene.mesh, [[row[k - 1] for k in chosen] for row in rows])


if __name__ == "__main__":
    main()
