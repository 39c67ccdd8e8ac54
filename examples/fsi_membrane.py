"""A fluid on a trampoline: the membrane throws particles up and catches them, and none gets to its other side.

Position-based dynamics moves fluid and membrane, rows of one float32 array on the device, by up to 2.5 edge lengths of
the membrane a frame: edges keep their lengths, and particles push each other apart. ccd_warp works on the same arrays:

1. `launch` finds which particles meet which faces on the way to where they would go; the pairs are kept apart;
2. `launch_line_search(per="vertex")` shortens, in place, the displacements that would still lead to contact. Every
   accepted path is certain to be free, between exactly the numbers that the arrays hold.

The same scene runs once more without CCD: the pairs are those that are near at the end of a frame, and nothing is
shortened. Particles that are lower than all of the membrane are counted.

    pip install -e '.[viz]' && python examples/fsi_membrane.py --output fsi

takes 20 s on two cores and draws fsi/fsi_membrane.png.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import warp as wp

import ccd_warp as ccd

wp.set_module_options({"enable_backward": False})
# Lengths in metres, times in seconds; all vertices have the same mass.
FRAME_TIME, GRAVITY = 1.0 / 60.0, wp.vec3(0.0, 0.0, -9.81)
SIDE, LAYERS = 1.0, 4  # of the box; of particles in it
STROKE, PERIOD, FIRST_STROKE = 0.25, 30, 10  # of the rim, up and down; the last two in frames
PASSES, ITERATIONS, SWEEPS = 3, 8, 8
# In spacings of particles: their radius, the gap at which a pair acts, and the one at which it aims.
RADIUS, ACTIVATION, MARGIN = 0.02, 0.58, 0.28
MEMBRANE, RIM, FLUID = range(3)
KEY_FRAMES = (9, 32, 52)


@wp.struct
class State:
    x: wp.array[wp.vec3]  # where everything is to go
    push: wp.array[wp.vec3]  # the sum of the pushes that move it there
    kind: wp.array[int]
    num_membrane: int
    spacing: float


@wp.kernel
def predict(x: wp.array[wp.vec3], before: wp.array[wp.vec3], rim: float, s: State):
    """Where inertia and gravity take everything from the last two positions; the rim is at a prescribed height."""
    i = wp.tid()
    s.x[i] = 2.0 * x[i] - before[i] + FRAME_TIME * FRAME_TIME * GRAVITY
    if s.kind[i] == RIM:
        s.x[i] = wp.vec3(x[i][0], x[i][1], rim)
    before[i] = x[i]


@wp.kernel
def push_particles(grid: wp.uint64, s: State):
    """Add up what keeps particles apart."""
    i = wp.tid() + s.num_membrane
    for k in wp.hash_grid_query(grid, s.x[i], s.spacing):
        way = s.x[i] - s.x[k + s.num_membrane]
        s.push[i] += 0.25 * wp.max(s.spacing - wp.length(way), 0.0) * wp.normalize(way)


@wp.kernel
def pull_edges(edges: wp.array[wp.vec2i], rest: wp.array[float], s: State):
    """Add up what gives the edges of the membrane their lengths."""
    i, j = edges[wp.tid()][0], edges[wp.tid()][1]
    change = 0.2 * (rest[wp.tid()] - wp.length(s.x[i] - s.x[j])) * wp.normalize(s.x[i] - s.x[j])
    wp.atomic_add(s.push, i, change)
    wp.atomic_add(s.push, j, -change)


@wp.kernel
def push_pairs(
    count: wp.array[int], corners: wp.array[wp.vec4i], uv: wp.array[wp.vec2d], normal: wp.array[wp.vec3d], s: State
):
    """Add up what keeps particles and faces at a distance."""
    c = wp.tid()
    if c < wp.min(count[0], corners.shape[0]):
        u, v, n = float(uv[c][0]), float(uv[c][1]), wp.vec3(normal[c])
        weights = wp.vec4(1.0, u + v - 1.0, -u, -v)
        depth = (RADIUS + MARGIN) * s.spacing
        for k in range(4):
            depth -= weights[k] * wp.dot(n, s.x[corners[c][k]])
        for k in range(4):
            push = 0.3 * wp.max(depth, 0.0) / wp.dot(weights, weights) * weights[k]
            wp.atomic_add(s.push, corners[c][k], push * n)


@wp.kernel
def apply_pushes(s: State):
    """Move vertices but those of the rim by their pushes, particles within the walls, and reset these."""
    i = wp.tid()
    if s.kind[i] != RIM:
        s.x[i] += s.push[i]
    if s.kind[i] == FLUID:
        wall = 0.5 * (SIDE - s.spacing)
        s.x[i] = wp.vec3(wp.clamp(s.x[i][0], -wall, wall), wp.clamp(s.x[i][1], -wall, wall), s.x[i][2])
    s.push[i] = wp.vec3()


class Trampoline:
    """The simulation. Vertices are those of the membrane first, then the particles, as far apart as its vertices."""

    def __init__(self, resolution: int, *, with_ccd: bool = True) -> None:
        self.with_ccd, self.spacing, n = with_ccd, SIDE / resolution, resolution + 1
        membrane = np.insert(self.spacing * np.mgrid[:n, :n].reshape(2, -1).T - 0.5 * SIDE, 2, 0.0, axis=1)
        a = np.arange(n * n).reshape(n, n)[:-1, :-1].reshape(-1, 1)
        faces = np.concatenate([a + [0, n, 1], a + [n, n + 1, 1]])
        particles = np.mgrid[: n - 1, : n - 1, :LAYERS].reshape(3, -1).T + [0.5, 0.5, 0.6]
        particles += np.random.default_rng(0).uniform(-0.1, 0.1, particles.shape)
        bodies = [(membrane, faces), (self.spacing * particles - [0.5 * SIDE, 0.5 * SIDE, 0.0], np.empty((0, 3), int))]
        self.mesh = ccd.CollisionMesh.from_arrays(
            bodies, self_collision=False, codimensional_points=[False, True], radius=[0.0, RADIUS * self.spacing]
        )
        # the tolerance, here in metres, is small beside the radius, so that what is close can still move
        lengths = {"length_scale": 1.0, "tolerance": 1e-8, "pair_kinds": ["vertex_face"]}
        self.finder = ccd.CollisionPipeline(self.mesh, minimum_distance=ACTIVATION * self.spacing, **lengths)
        self.guard = ccd.CollisionPipeline(self.mesh, **lengths)
        capacity = {"max_pairs": 32 * len(particles), "max_contacts": 16 * len(particles)}
        self.results = [pipeline.reserve(**capacity) for pipeline in (self.finder, self.guard)]
        self.state = State()
        self.x, self.before, self.state.x = (wp.array(self.mesh.vertices, dtype=wp.vec3) for _ in range(3))
        self.state.push, self.state.spacing = wp.zeros_like(self.x), self.spacing
        kind = np.full(len(self.x), FLUID)
        kind[: n * n] = np.where(np.abs(membrane).max(axis=1) > 0.5 * SIDE - 1e-6, RIM, MEMBRANE)
        self.state.kind = wp.array(kind, dtype=int)
        self.state.num_membrane = self.num_membrane = n * n
        rest = np.linalg.norm(np.subtract(*membrane[self.mesh.edges.T]), axis=1)
        self.edges = [wp.array(self.mesh.edges, dtype=wp.vec2i), wp.array(rest, dtype=float)]
        self.grid = wp.HashGrid(64, 64, 64)

    def advance(self, frame: int) -> None:
        """One frame."""
        rim = 0.5 * STROKE * (1.0 - np.cos(2.0 * np.pi * max(frame + 1 - FIRST_STROKE, 0) / PERIOD))
        wp.launch(predict, len(self.x), [self.x, self.before, rim, self.state])
        wish, m = self.state.x, self.num_membrane
        for _ in range(PASSES):
            if self.with_ccd:
                near = self.finder.launch(self.x, wish).contacts
            else:  # only what is near at one instant is known
                near = self.finder.launch_proximity(wish, ACTIVATION * self.spacing)
            pairs = [near.count, near.vertices, near.parameters, near.normal]
            self.grid.build(wish[m:], self.spacing)
            for _ in range(ITERATIONS):
                self.relax(push_particles, len(wish) - m, self.grid.id)
                for _ in range(SWEEPS):
                    self.relax(pull_edges, len(self.mesh.edges), *self.edges)
                    self.relax(push_pairs, len(near.kind), *pairs)
        if self.with_ccd:
            self.guard.launch_line_search(self.x, wish, per="vertex")
        wp.copy(self.x, wish)

    def relax(self, kernel: wp.Kernel, dim: int, *inputs: wp.array) -> None:
        """Add up pushes of one kind, and move all vertices by them."""
        wp.launch(kernel, dim, [*inputs, self.state])
        wp.launch(apply_pushes, len(self.x), [self.state])


def draw(pyvista, plotter, state: tuple[Trampoline, np.ndarray]) -> None:
    """Add the membrane, the particles, and the walls of the box."""
    (scene, x), m = state, state[0].num_membrane
    plotter.add_mesh(pyvista.PolyData.from_regular_faces(x[:m], scene.mesh.faces), color="#f0a04b", show_edges=True)
    ball = pyvista.Sphere(radius=0.5 * scene.spacing, theta_resolution=12, phi_resolution=12)
    plotter.add_mesh(pyvista.PolyData(x[m:]).glyph(geom=ball, scale=False, orient=False), color="#6fb1f0", ambient=0.2)
    plotter.add_mesh(pyvista.Box(0.5 * SIDE * np.array([-1, 1, -1, 1, -0.8, 1.6])), style="wireframe", color="#888888")


def main() -> None:
    """Run with CCD and without, count, print, and draw."""
    parser = argparse.ArgumentParser(description="A fluid on a membrane, with CCD and without, in 20 s.")
    parser.add_argument("--frames", type=int, default=90, help="default 90")
    parser.add_argument("--resolution", type=int, default=20, help="cells along a side of the membrane (default 20)")
    parser.add_argument("--output", type=Path, help="folder for fsi_membrane.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    rows, wp.config.log_level = ([], []), wp.LOG_WARNING
    for with_ccd, title in ((True, "with CCD"), (False, "without CCD")):
        scene = Trampoline(options.resolution, with_ccd=with_ccd)
        for frame in range(options.frames):
            scene.advance(frame)
            x = scene.x.numpy().copy()
            assert not any(result.flags.numpy()[0] for result in scene.results), "expected capacity for all pairs"
            below = int((x[scene.num_membrane :, 2] < x[: scene.num_membrane, 2].min()).sum())
            if frame in {*KEY_FRAMES, options.frames - 1}:
                rows[not with_ccd].append((f"{title}, frame {frame}: {below} below", (scene, x)))
        print(f"{title}: {below} of {len(x) - scene.num_membrane} particles are below the membrane in the end")
    if options.output:
        from key_frames import draw_rows

        draw_rows(options.output / "fsi_membrane.png", rows, draw, [(2.4, -3, 1.2), (0, 0, 0.15), (0, 0, 1)])


if __name__ == "__main__":
    main()
