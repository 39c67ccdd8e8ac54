"""A fluid on a trampoline: particles meet a flexible membrane that moves up and down, and none gets to its other side.

The fluid is position-based (an incompressible particle method), the membrane a sheet of springs whose rim follows a
prescribed motion, up to several edge lengths a step, which throws the fluid up and catches it. Both are stored in one
float32 array on the device, and ccd_warp works on it in place:

1. `launch` finds which particles come near which faces on the desired path; each such pair is kept apart along its
   normal, with corrections according to the masses of the particle and of the three corners of the face;
2. `launch_line_search(per="vertex")` shortens the displacements that would still lead to contact. It gives the
   guarantee: every accepted path has been found free, between exactly the numbers that the arrays hold. The path of the
   rim is shortened, too, where fluid is in the way, and the rim catches up later.

A particle has a radius, and the mesh knows it: every gap is one between the membrane and the surface of a particle.
Only pairs of points and faces are searched (`pair_kinds=["vertex_face"]`): the others have no search, capacity or
launch.

An independent check counts particles on the wrong side: the generalised winding number (libigl) of the membrane, closed
by walls and a lid. With `--no-ccd` the contacts are what `launch_proximity` finds near at the end of a step, and
nothing is shortened.

    pip install -e '.[examples]' && python examples/fsi_membrane.py --output fsi

Sources: Macklin and Müller 2013, "Position based fluids"; Wendland 1995 (the kernel); Jacobson et al. 2013, "Robust
inside-outside segmentation using generalized winding numbers".
"""

import argparse
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import warp as wp
from numpy.typing import NDArray

import ccd_warp as ccd
from ccd_warp.viz import drawing_without_display

wp.set_module_options({"enable_backward": False})

# Lengths in metres, times in seconds, masses in kilograms.
FRAME_TIME = 1.0 / 60.0
GRAVITY = wp.vec3(0.0, 0.0, -9.81)
SIDE, DEPTH, DENSITY = 1.0, 0.15, 1000.0
SHEET_MASS = 40.0
STROKE, STROKE_FREQUENCY, FIRST_STROKE = 0.25, 2.0, 30
REACH = 2.2  # of the fluid's kernel, in spacings
PASSES, ITERATIONS, SWEEPS = 3, 8, 8
VISCOSITY = 0.05
# In spacings of particles: their radius, and the gaps before it at which contacts act and at which they aim.
RADIUS, ACTIVATION, MARGIN = 0.02, 0.58, 0.28
KEY_FRAMES = (29, 36, 44, 52, 60)


@wp.func
def kernel_value(distance: float, reach: float) -> float:
    """Wendland's C2, which is 0 from the reach on."""
    q = wp.min(distance / reach, 1.0)
    s = (1.0 - q) * (1.0 - q)
    return 21.0 / (2.0 * wp.pi * reach * reach * reach) * s * s * (4.0 * q + 1.0)


@wp.func
def kernel_gradient(way: wp.vec3, reach: float) -> wp.vec3:
    """Its gradient."""
    s = 1.0 - wp.min(wp.length(way) / reach, 1.0)
    square = reach * reach
    return -210.0 / (wp.pi * square * square * reach) * s * s * s * way


@wp.kernel
def predict(
    x: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    inverse_mass: wp.array[float],
    rest: wp.array[wp.vec3],
    rim_height: float,
    dt: float,
    # out
    wished: wp.array[wp.vec3],
):
    """Predict positions by inertia and gravity; the rim follows its prescribed motion."""
    i = wp.tid()
    if inverse_mass[i] > 0.0:
        wished[i] = x[i] + dt * (velocity[i] + dt * GRAVITY)
    else:
        wished[i] = rest[i] + wp.vec3(0.0, 0.0, rim_height)


@wp.kernel
def find_multipliers(
    grid: wp.uint64,
    x: wp.array[wp.vec3],
    reach: float,
    rest_density: float,
    softness: float,
    # out
    multiplier: wp.array[float],
    compression: wp.array[float],
):
    """Compute the multipliers that keep the density of each particle from rising above the rest density."""
    i = wp.tid()
    density = wp.float32(0.0)
    own = wp.vec3()
    squares = wp.float32(0.0)
    for j in wp.hash_grid_query(grid, x[i], reach):
        way = x[i] - x[j]
        density += kernel_value(wp.length(way), reach)
        gradient = kernel_gradient(way, reach) / rest_density
        own += gradient
        squares += wp.dot(gradient, gradient)
    excess = density / rest_density - 1.0
    compression[i] = excess
    multiplier[i] = -wp.max(excess, 0.0) / (squares + wp.dot(own, own) + softness)


@wp.kernel
def push_apart(
    grid: wp.uint64,
    x: wp.array[wp.vec3],
    reach: float,
    rest_density: float,
    multiplier: wp.array[float],
    wall: float,
    # out
    moved: wp.array[wp.vec3],
):
    """Move particles by the multipliers, between the walls."""
    i = wp.tid()
    push = wp.vec3()
    for j in wp.hash_grid_query(grid, x[i], reach):
        push += (multiplier[i] + multiplier[j]) / rest_density * kernel_gradient(x[i] - x[j], reach)
    y = x[i] + push
    moved[i] = wp.vec3(wp.clamp(y[0], -wall, wall), wp.clamp(y[1], -wall, wall), y[2])


@wp.kernel
def pull_springs(
    x: wp.array[wp.vec3],
    inverse_mass: wp.array[float],
    first: wp.array[int],
    other: wp.array[int],
    rest_length: wp.array[float],
    # out
    moved: wp.array[wp.vec3],
):
    """Move each vertex of the membrane by the mean of the corrections of its springs."""
    i = wp.tid()
    pull = wp.vec3()
    for k in range(first[i], first[i + 1]):
        way = x[i] - x[other[k]]
        length = wp.length(way)
        if inverse_mass[i] > 0.0 and length > 0.0:
            share = inverse_mass[i] / (inverse_mass[i] + inverse_mass[other[k]])
            pull += share * (rest_length[k] - length) / length * way
    moved[i] = x[i] + 2.0 / float(first[i + 1] - first[i]) * pull


@wp.kernel
def push_pairs(
    count: wp.array[int],
    primitives: wp.array[wp.vec2i],
    parameters: wp.array[wp.vec2d],
    directions: wp.array[wp.vec3d],
    faces: wp.array[wp.vec3i],
    distance: float,
    inverse_mass: wp.array[float],
    x: wp.array[wp.vec3],
    # out
    push: wp.array[wp.vec3],
    num_pushes: wp.array[int],
):
    """Add up the corrections of particles and faces that are near: momentum is conserved, and nothing bounces."""
    c = wp.tid()
    if c >= wp.min(count[0], primitives.shape[0]):
        return
    f = faces[primitives[c][1]]
    corners = wp.vec4i(primitives[c][0], f[0], f[1], f[2])
    u, v = float(parameters[c][0]), float(parameters[c][1])
    weights = wp.vec4(1.0, u + v - 1.0, -u, -v)
    direction = wp.vec3(directions[c])
    gap = wp.vec3()
    total = wp.float32(0.0)
    for k in range(4):
        gap += weights[k] * x[corners[k]]
        total += inverse_mass[corners[k]] * weights[k] * weights[k]
    depth = distance - wp.dot(direction, gap)
    if depth > 0.0:
        for k in range(4):
            i = corners[k]
            wp.atomic_add(push, i, inverse_mass[i] * weights[k] * depth / total * direction)
            wp.atomic_add(num_pushes, i, 1)


@wp.kernel
def apply_pushes(push: wp.array[wp.vec3], num_pushes: wp.array[int], x: wp.array[wp.vec3]):
    """Move each vertex by the mean of its pushes, and reset these."""
    i = wp.tid()
    if num_pushes[i] > 0:
        x[i] = x[i] + push[i] / float(num_pushes[i])
    push[i] = wp.vec3()
    num_pushes[i] = 0


@wp.kernel
def accept(wished: wp.array[wp.vec3], dt: float, x: wp.array[wp.vec3], velocity: wp.array[wp.vec3]):
    """Accept the positions of the line search, and the velocity that leads to them."""
    i = wp.tid()
    velocity[i] = (wished[i] - x[i]) / dt
    x[i] = wished[i]


@wp.kernel
def smooth_velocity(
    grid: wp.uint64,
    x: wp.array[wp.vec3],
    velocity: wp.array[wp.vec3],
    reach: float,
    rest_density: float,
    # out
    smoothed: wp.array[wp.vec3],
):
    """A little viscosity (XSPH)."""
    i = wp.tid()
    v = velocity[i]
    for j in wp.hash_grid_query(grid, x[i], reach):
        v += VISCOSITY * kernel_value(wp.length(x[i] - x[j]), reach) / rest_density * (velocity[j] - velocity[i])
    smoothed[i] = v


def sheet(resolution: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A square sheet of ``resolution`` cells on each side around the origin: vertices and faces."""
    k = SIDE * (np.arange(resolution + 1) / resolution - 0.5)
    vertices = np.stack([*np.meshgrid(k, k, indexing="ij"), np.zeros((len(k), len(k)))], axis=-1).reshape(-1, 3)
    a = (np.arange(resolution)[:, None] * len(k) + np.arange(resolution)).ravel()
    b, c, d = a + len(k), a + 1, a + len(k) + 1
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([c, b, d], axis=1)])


def fluid(num_particles: int, gap: float) -> tuple[NDArray[np.float64], float]:
    """At least ``num_particles`` particles in layers above the sheet, and the spacing between them."""
    spacing = (SIDE**2 * DEPTH / num_particles) ** (1 / 3)
    n = int(SIDE / spacing)
    k = spacing * (np.arange(n) - 0.5 * (n - 1))
    z = spacing * (gap + np.arange(-(-num_particles // n**2)))
    lattice = np.stack(np.meshgrid(k, k, z, indexing="ij"), axis=-1).reshape(-1, 3)
    return lattice + np.random.default_rng(0).uniform(-0.01, 0.01, lattice.shape) * spacing, spacing


def spring_rows(vertices: NDArray[np.float64], resolution: int) -> list[NDArray]:
    """Springs to the neighbours, across the cells, and over two cells: begin of each row, other ends, lengths."""
    number = np.arange((resolution + 1) ** 2).reshape(resolution + 1, -1)
    pairs = []
    for i, j in ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2)):
        a = number[: len(number) - i, max(0, -j) : len(number) - max(0, j)]
        b = number[i:, max(0, j) : len(number) + min(0, j)]
        pairs += [np.stack([a.ravel(), b.ravel()], axis=1), np.stack([b.ravel(), a.ravel()], axis=1)]
    one, other = np.concatenate(pairs).T
    order = np.argsort(one, kind="stable")
    lengths = np.linalg.norm(vertices[one] - vertices[other], axis=1)
    return [np.searchsorted(one[order], np.arange(number.size + 1)), other[order], lengths[order]]


def rim_height(frame: int) -> float:
    """Height of the rim: constant while the fluid settles, then up and down."""
    t = max(frame - FIRST_STROKE, 0) * FRAME_TIME
    return 0.5 * STROKE * (1.0 - np.cos(2.0 * np.pi * STROKE_FREQUENCY * t))


class Trampoline:
    """The simulation. Vertices are those of the membrane first, then the particles."""

    def __init__(self, num_particles: int, resolution: int, *, with_ccd: bool = True) -> None:
        membrane, faces = sheet(resolution)
        particles, self.spacing = fluid(num_particles, gap=0.6)
        self.with_ccd, self.num_membrane = with_ccd, len(membrane)
        self.edge_length = SIDE / resolution
        self.reach = REACH * self.spacing
        self.mesh = ccd.CollisionMesh.from_arrays(
            [(membrane, faces), (particles, np.zeros((0, 3), dtype=int))],
            self_collision=False,
            codimensional_points=[False, True],
            radius=[0.0, RADIUS * self.spacing],
        )
        # lengths in metres; the tolerance is small beside the radius, so that what is close can still move
        lengths = {"length_scale": 1.0, "tolerance": 1e-8, "pair_kinds": ["vertex_face"]}
        self.finder = ccd.CollisionPipeline(self.mesh, minimum_distance=ACTIVATION * self.spacing, **lengths)
        self.guard = ccd.CollisionPipeline(self.mesh, **lengths)
        count = self.mesh.num_vertices
        self.max_contacts = 16 * len(particles)
        self.found = self.finder.reserve(max_pairs=2 * self.max_contacts, max_contacts=self.max_contacts)
        self.looked = self.guard.reserve(max_pairs=2 * self.max_contacts)

        self.rest = wp.array(self.mesh.vertices, dtype=wp.vec3)
        self.x, self.wished, self.moved = (wp.clone(self.rest) for _ in range(3))
        self.velocity, self.smoothed, self.push = (wp.zeros(count, dtype=wp.vec3) for _ in range(3))
        self.num_pushes = wp.zeros(count, dtype=int)
        inverse_mass = np.full(count, 1.0 / (DENSITY * self.spacing**3))
        inverse_mass[: self.num_membrane] = self.num_membrane / SHEET_MASS
        inverse_mass[: self.num_membrane][np.abs(membrane[:, :2]).max(axis=1) > 0.5 * SIDE - 1e-6] = 0.0
        self.inverse_mass = wp.array(inverse_mass, dtype=float)
        self.faces = wp.array(self.mesh.faces, dtype=wp.vec3i)
        first, other, lengths = spring_rows(membrane, resolution)
        self.springs = [wp.array(first, dtype=int), wp.array(other, dtype=int), wp.array(lengths, dtype=float)]
        self.grid = wp.HashGrid(64, 64, 64)
        self.multiplier, self.compression = (wp.zeros(len(particles), dtype=float) for _ in range(2))
        # the kernel summed over a cubic lattice; and what keeps the multiplier of a lone particle finite
        k = np.arange(-3, 4) * self.spacing
        q = np.minimum(np.linalg.norm(np.stack(np.meshgrid(k, k, k)), axis=0) / self.reach, 1.0)
        self.rest_density = float((21.0 / (2.0 * np.pi * self.reach**3) * (1.0 - q) ** 4 * (4.0 * q + 1.0)).sum())
        self.softness = 0.05 / self.spacing**2

    def fluid_part(self, array: wp.array) -> wp.array:
        """The rows of the particles, in the same memory."""
        return array[self.num_membrane :]

    def advance(self, frame: int) -> None:
        """One frame."""
        inputs = [self.x, self.velocity, self.inverse_mass, self.rest, rim_height(frame + 1), FRAME_TIME]
        wp.launch(predict, dim=len(self.x), inputs=inputs, outputs=[self.wished])
        for _ in range(PASSES):
            if self.with_ccd:
                found = self.finder.launch(self.x, self.wished).contacts
                direction = found.normal
            else:  # only what is near at one instant is known
                found = self.found = self.finder.launch_proximity(self.wished, ACTIVATION * self.spacing)
                direction = found.direction
            pairs = [found.count, found.primitives, found.parameters, direction]
            self.grid.build(self.fluid_part(self.wished), self.reach)
            for _ in range(ITERATIONS):
                self.relax(pairs)
        if self.with_ccd:
            self.guard.launch_line_search(self.x, self.wished, per="vertex")
        wp.launch(accept, dim=len(self.x), inputs=[self.wished, FRAME_TIME], outputs=[self.x, self.velocity])
        particles, velocity = self.fluid_part(self.x), self.fluid_part(self.velocity)
        self.grid.build(particles, self.reach)
        inputs = [self.grid.id, particles, velocity, self.reach, self.rest_density]
        wp.launch(smooth_velocity, dim=len(particles), inputs=inputs, outputs=[self.fluid_part(self.smoothed)])
        wp.copy(velocity, self.fluid_part(self.smoothed))

    def relax(self, pairs: list[wp.array]) -> None:
        """Solve the fluid once, then springs and pairs in turn."""
        particles, moved = self.fluid_part(self.wished), self.fluid_part(self.moved)
        shared = [self.grid.id, particles, self.reach, self.rest_density]
        num_particles = len(particles)
        outputs = [self.multiplier, self.compression]
        wp.launch(find_multipliers, dim=num_particles, inputs=[*shared, self.softness], outputs=outputs)
        wall = 0.5 * SIDE - 0.5 * self.spacing
        wp.launch(push_apart, dim=num_particles, inputs=[*shared, self.multiplier, wall], outputs=[moved])
        wp.copy(particles, moved)
        pushes = [self.push, self.num_pushes]
        for _ in range(SWEEPS):
            inputs = [self.wished, self.inverse_mass, *self.springs]
            wp.launch(pull_springs, dim=self.num_membrane, inputs=inputs, outputs=[self.moved])
            wp.copy(self.wished, self.moved, count=self.num_membrane)
            inputs = [*pairs, self.faces, (RADIUS + MARGIN) * self.spacing, self.inverse_mass, self.wished]
            wp.launch(push_pairs, dim=self.max_contacts, inputs=inputs, outputs=pushes)
            wp.launch(apply_pushes, dim=len(self.wished), outputs=[*pushes, self.wished])

    def check_capacity(self) -> None:
        """Raise an error if contacts exceeded the capacity, rather than continue without them."""
        flags = int(self.found.flags.numpy()[0]) | int(self.looked.flags.numpy()[0])
        if flags:
            raise RuntimeError(f"{ccd.LaunchFlag(flags)!r}; expected capacity for all pairs and contacts")


def wrong_side(scene: Trampoline, vertices: NDArray[np.float64]) -> int:
    """Number of particles below the membrane: outside of the surface that it makes with four walls and a lid."""
    from igl import winding_number  # imported here, so that everything else runs without it

    m = scene.num_membrane
    faces = scene.mesh.faces.astype(np.int64)
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, first, number = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    a, b = sides[first[number == 1]].T  # along the rim, as the faces go around
    rim = np.unique(a)
    lifted = np.searchsorted(rim, [a, b]) + m
    wall = np.concatenate([np.stack([b, a, lifted[0]], axis=1), np.stack([b, lifted[0], lifted[1]], axis=1)])
    lid = np.stack([lifted[1], lifted[0], np.full(len(a), m + len(rim))], axis=1)
    top = vertices[:, 2].max() + 1.0
    points = np.concatenate([vertices[:m], vertices[rim] * [1, 1, 0] + [0, 0, top], [[0, 0, top]]])
    numbers = winding_number(points, np.concatenate([faces, wall, lid]), vertices[m:].copy())
    return int((np.abs(numbers) < 0.5).sum())


def longest_edge(scene: Trampoline, vertices: NDArray[np.float64]) -> float:
    """The 99th percentile of the lengths of the membrane's edges, as multiples of their lengths at rest."""
    edges = scene.mesh.edges
    lengths = [np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (scene.mesh.vertices, vertices)]
    return float(np.quantile(lengths[1] / lengths[0], 0.99))


def write_frame(path: Path, scene: Trampoline, vertices: NDArray[np.float64], toi: NDArray[np.float64]) -> None:
    """A frame for ParaView: faces and particles, with the velocity and toi of each vertex."""
    import meshio

    particles = np.arange(scene.num_membrane, len(vertices))[:, None]
    data = {"velocity": scene.velocity.numpy(), "toi": np.minimum(toi, 1.0)}
    cells = [("triangle", scene.mesh.faces), ("vertex", particles)]
    meshio.Mesh(vertices, cells, point_data=data).write(path, binary=True)


def write_series(path: Path, names: list[str]) -> None:
    """The list of frames that ParaView opens."""
    sets = [f'<DataSet timestep="{k * FRAME_TIME:.6f}" file="{name}"/>' for k, name in enumerate(names)]
    text = "\n".join(['<VTKFile type="Collection" version="0.1"><Collection>', *sets, "</Collection></VTKFile>", ""])
    path.write_text(text, encoding="utf-8")


def draw(path: Path, scene: Trampoline, pictures: list[tuple[str, NDArray[np.float64]]]) -> None:
    """Write key frames side by side, particles coloured by height above the rim."""
    m = scene.num_membrane
    with drawing_without_display() as pyvista:
        columns = (len(pictures) + 1) // 2
        plotter = pyvista.Plotter(off_screen=True, shape=(2, columns), window_size=(columns * 520, 900), border=False)
        for k, (title, vertices) in enumerate(pictures):
            plotter.subplot(*divmod(k, columns))
            membrane = pyvista.PolyData.from_regular_faces(vertices[:m], scene.mesh.faces, deep=True)
            plotter.add_mesh(membrane, color="#f0a04b", show_edges=True, edge_color="#c07a2b", line_width=0.5)
            drops = pyvista.PolyData(vertices[m:])
            style = {"point_size": 7, "render_points_as_spheres": True, "cmap": "Blues_r", "show_scalar_bar": False}
            plotter.add_mesh(drops, scalars=vertices[m:, 2], clim=(-0.4, 0.8), **style)
            plotter.add_text(title, font_size=11, color="#222222")
            plotter.camera_position = [(2.0, -2.5, 1.1), (0.0, 0.0, 0.25), (0.0, 0.0, 1.0)]
            plotter.background_color = "white"
        plotter.screenshot(path)
        plotter.close()


def main() -> None:
    """Run, check, and write the results."""
    parser = argparse.ArgumentParser(description="Particles on a membrane that moves, with CCD or without.")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--particles", type=int, default=4000)
    parser.add_argument("--resolution", type=int, default=40, help="cells along a side of the membrane (default 40)")
    parser.add_argument("--no-ccd", action="store_true", help="contacts at the end of each step only")
    parser.add_argument("--output", type=Path, default=Path("fsi_membrane"), help="folder (default fsi_membrane)")
    options = parser.parse_args()
    if min(options.frames, options.particles) < 1 or options.resolution < 3:
        parser.error("expected --frames and --particles of at least 1 and --resolution of at least 3")
    missing = [name for name in ("igl", "meshio", "tqdm", "pyvista") if find_spec(name) is None]
    if missing:
        sys.exit(f"fsi_membrane.py needs {', '.join(missing)}; install with: pip install 'ccd-warp[examples]'")
    from tqdm import trange

    options.output.mkdir(parents=True, exist_ok=True)
    wp.config.log_level = wp.LOG_WARNING
    scene = Trampoline(options.particles, options.resolution, with_ccd=not options.no_ccd)
    key_frames = {frame for frame in KEY_FRAMES if frame < options.frames} | {options.frames - 1}
    pictures: list[tuple[str, NDArray[np.float64]]] = []
    counts, names, seconds, longest, excess, stretch = [], [], [], 0.0, [], []
    before = scene.x.numpy()
    with trange(options.frames, unit="frame") as bar:
        for frame in bar:
            begin = time.perf_counter()
            scene.advance(frame)
            vertices = scene.x.numpy().astype(np.float64)
            seconds.append(time.perf_counter() - begin)
            scene.check_capacity()
            counts.append(wrong_side(scene, vertices))
            excess.append(float(np.quantile(scene.compression.numpy(), 0.95)))
            stretch.append(longest_edge(scene, vertices))
            moves = np.linalg.norm(vertices - before, axis=1)
            longest, before = max(longest, float(moves.max())), vertices
            names.append(f"frame_{frame:04d}.vtu")
            write_frame(options.output / names[-1], scene, vertices, scene.looked.vertex_toi.numpy())
            if frame in key_frames:
                pictures.append((f"frame {frame}: {counts[-1]} on the wrong side", vertices))
            bar.set_postfix(wrong=counts[-1])
    write_series(options.output / "fsi_membrane.pvd", names)
    num_particles = scene.mesh.num_vertices - scene.num_membrane
    print(f"{num_particles} particles, {len(scene.mesh.faces)} faces, way of a vertex up to", end=" ")
    print(f"{longest / scene.edge_length:.1f} edge lengths a frame")
    print(f"{len(counts)} frames, on the wrong side at most {max(counts)} particles, at the end {counts[-1]}")
    print(f"compression of 95 in 100 particles: {np.median(excess):.1%} in the median frame, {max(excess):.1%} at most")
    print(f"99 in 100 edges shorter than {np.median(stretch):.3f} of their rest length in the median frame,", end=" ")
    print(f"{max(stretch):.3f} at most")
    print(f"{np.median(seconds):.2f} s a frame without the check")
    draw(options.output / "fsi_membrane.png", scene, pictures)


if __name__ == "__main__":
    main()
