"""A valve: a flow opens two leaflets every beat, and they close on each other and never cross.

Fluid-structure interaction by the immersed boundary method, in cm, g and s, about a vein that is 1 cm wide:

1. The flow is plane and incompressible, driven by a pressure at the inlet that pulsates. scikit-fem assembles
   Taylor-Hood elements; inertia is carried along the paths of the fluid (Pironneau 1982), and a term on the divergence
   (Olshanskii 2002) keeps the fluid from leaking through leaflets. The matrix never changes and is factored once.
2. The leaflets are elastic lines without mass. Their vertices move with the fluid, and their forces act on it where the
   vertices are at the start of a frame (Peskin 2002, "The immersed boundary method", Acta Numerica). Newton's method
   solves for both, with `influence`: the velocities of the nodes of the mesh that a unit force at each of them causes.
3. Springs keep apart what `find_proximity` finds near at the start of a frame, and come too late for some of what
   closes fast. `line_search` moves each leaflet as far as is certain to be free; the second run leaves this line out.

Without CCD the tips hook into each other when the valve first closes, and it stays shut; with frames half as long
(`PER_BEAT = 48`) the springs suffice. It is a model and no vein: plane, with rigid walls and a given pressure, and it
does not resolve what happens within a cell of the mesh (0.5 mm) or a frame (0.04 s). It takes 20 s on two cores.

    pip install -e '.[examples]' && python examples/valve.py --output valve
"""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # for small matrices a second thread would only wait

import numpy as np

import ccd_warp as ccd

try:
    import skfem as fem
    from matplotlib.figure import Figure
    from scipy import ndimage, sparse
    from tqdm import tqdm
except ImportError as error:
    sys.exit(f"valve.py needs {error.name}; install with: pip install -e '.[examples]'")

DENSITY, VISCOSITY, DIVERGENCE = 1.0, 0.04, 10.0  # of blood; the last is the factor of the term on the divergence
LENGTH, COLUMNS, ROWS, PRESSURE = 3.0, 60, 20, 150.0  # of the channel; cells of its mesh; the amplitude in dyn/cm²
PER_BEAT, KEY_FRAMES = 24, (10, 18, 22, 29, 36)  # frames in a beat of 1 s; those of the picture
HINGE, BEGIN, END = 0.8, 0.7, 1.6  # where the leaflets leave the walls, and between what they move
SEGMENTS, STRETCHING, BENDING = 32, 2000.0, 2.0  # of a leaflet; in dyn, in dyn cm
RADIUS, KEEP, REACH, SPRING = 0.0075, 0.0225, 0.05, 4000.0  # half of what is kept; what springs keep; from where on


def half_width(x: np.ndarray | float) -> np.ndarray:
    """Half of the width of the channel, with a sinus behind the leaflets."""
    return 0.5 + 0.2 * np.exp(-(((x - 1.35) / 0.35) ** 2))


class Flow:
    """The flow: velocities `u` at the nodes of the mesh, [2, N], which lie on a lattice of half cells."""

    def __init__(self) -> None:
        mesh = fem.MeshQuad.init_tensor(np.linspace(0.0, LENGTH, COLUMNS + 1), np.linspace(-1.0, 1.0, ROWS + 1))
        mesh = fem.MeshQuad(np.stack([mesh.p[0], mesh.p[1] * half_width(mesh.p[0])]), mesh.t)
        self.basis = basis = fem.Basis(mesh, fem.ElementQuad2(), intorder=4)
        pressures = basis.with_element(fem.ElementQuad1())
        mass = fem.BilinearForm(lambda u, v, w: u * v)
        dx, dy = (fem.BilinearForm(lambda u, q, w, a=a: u.grad[a] * q).assemble(basis, pressures) for a in (0, 1))
        forms = [fem.BilinearForm(lambda u, v, w, a=a: u.grad[a % 2] * v.grad[a // 2]) for a in range(4)]
        xx, xy, yx, yy = (form.assemble(basis) for form in forms)
        self.inertia = DENSITY * PER_BEAT * mass.assemble(basis)
        both = self.inertia + VISCOSITY * (xx + yy)
        rows = [both + DIVERGENCE * xx, DIVERGENCE * xy, -dx.T], [DIVERGENCE * yx, both + DIVERGENCE * yy, -dy.T]
        matrix = sparse.bmat([*rows, [-dx, -dy, -1e-9 * mass.assemble(pressures)]]).tocsc()  # 1e-9 spares pivoting
        self.dt, self.size, self.u = 1.0 / PER_BEAT, matrix.shape[0], np.zeros_like(basis.doflocs)
        x, y = self.nodes = basis.doflocs
        i, j = np.rint(2 * COLUMNS / LENGTH * x), np.rint(ROWS * (y / half_width(x) + 1.0))
        self.lattice = np.lexsort((j, i)).reshape(2 * COLUMNS + 1, 2 * ROWS + 1)
        inside, between = (j > 0) & (j < 2 * ROWS), (i > 0) & (i < 2 * COLUMNS)  # u = 0 on walls, and v = 0 at the ends
        self.free = np.flatnonzero(np.concatenate([inside, inside & between, np.ones(pressures.N, dtype=bool)]))
        options = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        self.factors = sparse.linalg.splu(matrix[self.free][:, self.free], **options)
        inlet = basis.boundary(mesh.facets_satisfying(lambda p: p[0] < 1e-9))
        self.inlet = fem.LinearForm(lambda v, w: v).assemble(inlet)
        self.near = np.flatnonzero(np.tile(inside & (x > BEGIN) & (x < END), 2))
        units = (np.eye(1, self.size, node)[0] for node in tqdm(self.near, "influence", disable=None))
        self.influence = np.stack([self.solve(unit).ravel()[self.near] for unit in units])

    def load(self, pressure: float) -> np.ndarray:
        """What drives the fluid: the velocity that it brings along to each node, and the pressure at the inlet."""
        carried = self.u
        for part in (0.5, 1.0):  # back to the middle of its path, then to the start
            x, y = self.nodes - part * self.dt * carried
            where = [2 * COLUMNS / LENGTH * x, ROWS * (y / half_width(x) + 1.0)]
            old = (u[self.lattice] for u in self.u)
            carried = np.stack([ndimage.map_coordinates(u, where, order=1, mode="nearest") for u in old])
        forces = (self.inertia @ carried.T).T + [pressure * self.inlet, 0.0 * self.inlet]
        return np.append(forces, np.zeros(self.size - forces.size))

    def solve(self, load: np.ndarray) -> np.ndarray:
        """The velocities that a load leads to."""
        found = np.zeros(self.size)
        found[self.free] = self.factors.solve(load[self.free])
        return found[: self.nodes.size].reshape(2, -1)


class Valve:
    """The leaflets in a flow, at rest at first. Positions are those of both, the lower one's first."""

    def __init__(self, flow: Flow, *, with_ccd: bool = True) -> None:
        along, width = np.linspace(0.0, 1.0, SEGMENTS + 1)[:, None], half_width(HINGE)
        lines = ((-width, [0.6, width - 0.03]), (width, [0.57, 0.04 - width]))  # the upper one is a little shorter
        bodies = [([HINGE, y] + along * way, np.arange(SEGMENTS)[:, None] + [0, 1]) for y, way in lines]
        self.mesh = ccd.CollisionMesh.from_arrays(bodies, names=["lower", "upper"], radius=RADIUS)
        self.pipeline = ccd.CollisionPipeline(self.mesh, device="cpu")
        self.flow, self.with_ccd, self.x, self.time = flow, with_ccd, self.mesh.vertices, 0.0
        flow.u = np.zeros_like(flow.nodes)
        self.ways, bends = (np.kron(np.eye(2), np.diff(np.eye(SEGMENTS + 1), n, axis=0)) for n in (1, 2))
        self.rest = np.linalg.norm(self.ways @ self.x, axis=1)
        self.bending = BENDING / self.rest.mean() ** 3 * bends.T @ bends
        self.moves = np.tile(np.arange(SEGMENTS + 1) > 1, 2)  # the first segment is clamped
        self.unknowns = np.flatnonzero(np.tile(self.moves, 2))

    def slopes(self, x: np.ndarray, pairs: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivatives of the energy of stretching, of springs between near pairs, and of bending."""
        along = self.ways @ x / np.linalg.norm(self.ways @ x, axis=1, keepdims=True)
        rows, directions = np.vstack([self.ways, pairs]), np.vstack([along, directions])
        excess = (rows @ x * directions).sum(axis=1) - np.append(self.rest, np.full(len(pairs), KEEP))
        stiffness = np.append(STRETCHING / self.rest, SPRING * (excess[len(along) :] < 0.0))
        first = self.bending @ x + rows.T @ ((stiffness * excess)[:, None] * directions)
        rows = np.hstack([rows * directions[:, :1], rows * directions[:, 1:]])
        second = np.kron(np.eye(2), self.bending) + (rows.T * stiffness) @ rows
        return first.T.ravel()[self.unknowns], second[np.ix_(self.unknowns, self.unknowns)]

    def advance(self) -> None:
        """One frame."""
        flow, dt, self.time = self.flow, self.flow.dt, self.time + self.flow.dt
        load = flow.load(PRESSURE * np.sin(2.0 * np.pi * self.time))
        at_vertices = sparse.block_diag(2 * [flow.basis.probes(self.x[self.moves].T)]).tocsr()
        carried = at_vertices @ flow.solve(load).ravel()  # velocities of vertices without forces of the leaflets
        mobility = at_vertices[:, flow.near] @ (at_vertices[:, flow.near] @ flow.influence).T  # and by a unit of each
        near = self.pipeline.find_proximity(self.x, REACH, unique=True)
        pairs = np.zeros((len(near.vertices), len(self.x)))
        np.add.at(pairs, (np.arange(len(pairs))[:, None], near.vertices), near.weights)
        self.wish, velocity = self.x.copy(), carried
        for _ in range(30):
            self.wish[self.moves] = self.x[self.moves] + dt * velocity.reshape(2, -1).T
            first, second = self.slopes(self.wish, pairs, near.direction)
            residual = velocity - carried + mobility @ first
            if np.abs(residual).max() < 1e-4:
                break
            velocity = velocity - np.linalg.solve(np.eye(len(velocity)) + dt * mobility @ second, residual)
        load[: flow.nodes.size] -= at_vertices.T @ first
        flow.u = flow.solve(load)
        self.x = self.pipeline.line_search(self.x, self.wish, per="body").vertices if self.with_ccd else self.wish


def num_crossings(mesh: ccd.CollisionMesh, x: np.ndarray) -> int:
    """Number of pairs of segments that cross, without the library: the line of each parts the ends of the other."""
    a, b = (x @ [1.0, 1.0j])[mesh.edges.T]  # the plane as complex numbers
    side_a, side_b = (np.sign(((b - a).conj()[:, None] * (end - a[:, None])).imag) for end in (a, b))
    parts = side_a * side_b < 0.0
    return int((parts & parts.T).sum()) // 2


def draw(path: Path, flow: Flow, pictures: list[tuple]) -> None:
    """Write key frames, a row for each run: the speed of the flow, and the leaflets."""
    count, grid, bare = len(pictures) // 2, flow.nodes[:, flow.lattice], {"aspect": "equal", "xticks": [], "yticks": []}
    axes = Figure(figsize=(3.0 * count, 4.2), layout="tight").subplots(2, count, squeeze=False, subplot_kw=bare)
    for axis, (title, x, u) in zip(axes.flat, pictures, strict=True):
        axis.contourf(*grid, np.hypot(*u)[flow.lattice], np.linspace(0.0, 16.0, 17), cmap="Blues", extend="max")
        axis.plot(*grid[:, :, [0, -1]], color="#555555")
        for leaflet, color in zip(np.split(x, 2), ("#d95f02", "#222222"), strict=True):
            axis.plot(*leaflet.T, color=color, linewidth=2.5)
        axis.set(xlim=(0.4, 2.4), frame_on=False, title=title)
    path.parent.mkdir(parents=True, exist_ok=True)
    axes[0, 0].figure.savefig(path)


def main() -> None:
    """Run, check, print, and draw."""
    parser = argparse.ArgumentParser(description="A valve in a flow, with CCD and without: 20 s on two cores.")
    parser.add_argument("--frames", type=int, default=5 * PER_BEAT, help=f"{PER_BEAT} are a beat (default: 5 beats)")
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder of the picture (none is drawn without)")
    options = parser.parse_args()
    if options.frames < 1:
        parser.error("expected --frames of at least 1")
    flow, pictures = Flow(), []
    for name in ("with CCD", "without CCD"):
        valve, table = Valve(flow, with_ccd=name == "with CCD"), []
        for frame in tqdm(range(options.frames), name, disable=None):
            valve.advance()
            crossings = num_crossings(valve.mesh, valve.x)
            table.append([flow.dt * flow.inlet @ flow.u[0], crossings > 0, (valve.x != valve.wish).any()])
            if frame in {*KEY_FRAMES, options.frames - 1}:
                pictures.append((f"{name}, {valve.time:.2f} s, crossings: {crossings}", valve.x, flow.u))
        print(f"{name}: {options.frames} frames, {np.sum(table, axis=0)[1]:.0f} with crossings")
        for beat, k in enumerate(range(0, options.frames, PER_BEAT), start=1):
            volume, crossed, cut = np.sum(table[k : k + PER_BEAT], axis=0)
            print(f"  beat {beat}: {volume:z5.2f} cm² of flow, crossings in {crossed:2.0f} frames, {cut:.0f} shortened")
    if options.output:
        draw(options.output / "valve.png", flow, pictures)


if __name__ == "__main__":
    main()
