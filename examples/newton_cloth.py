"""A newton cloth that is thrown at a ball and a thin plate, ten edge lengths a step, and passes through neither.

newton's SolverVBD moves the cloth; ccd_warp bounds its motion, vertex by vertex, on newton's own float32 arrays. The
interface is newton's: a solver owns a `newton.CollisionPipeline` and calls its `collide` before every iteration, with
the positions that the iteration begins from. With Divide-and-Truncate enabled (`rigid_soft_enable_dat`) it continues
from the positions after that call. `CCDCollisionPipeline` is such a pipeline. Each call

1. finds by `launch` the contacts on the path to these positions, and passes them to newton, where they become forces;
2. shortens the path by `launch_line_search(per="vertex")`, in place.

The motion of the last iteration is bounded after the step. Each step is checked independently: for vertices below the
plate, and for faces that intersect by CGAL's exact arithmetic. docs/newton.md describes the limits of the interface.

    pip install -e '.[newton]' && python examples/newton_cloth.py
"""

import argparse
import time
from collections.abc import Iterator

import newton
import numpy as np
import trimesh
import warp as wp
from newton.solvers import SolverVBD
from numpy.typing import NDArray

import ccd_warp as ccd

# Lengths in metres, times in seconds.
STEP_TIME = 1.0 / 30.0
ITERATIONS = 8
CLOTH_SIDE, CLOTH_HEIGHT, CLOTH_SPEED = 1.0, 0.55, 12.0
BALL_RADIUS, PLATE_SIZE, PLATE_TOP = 0.25, (2.0, 2.0, 0.01), -0.35
# The distance at which contacts act, and the least distance along any path.
THICKNESS, SEPARATION = 8e-3, 5e-4
STIFFNESS = 2e3  # of contacts, newton per metre
MAX_CONTACTS = 1 << 16
MODES = {
    "iterations": "bounded by ccd_warp before every iteration, with its contacts as newton's forces",
    "end": "bounded by ccd_warp once, at the end of a step, without contacts",
    "newton": "newton's own contacts",
    "none": "no contacts at all",
}
EDGE_EDGE = wp.constant(int(ccd.PairKind.EDGE_EDGE))


def obstacle_meshes() -> list[trimesh.Trimesh]:
    """The ball and the plate below it; all corners are float32 numbers, so that both codes see the same surface."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=BALL_RADIUS)
    plate = trimesh.creation.box(extents=PLATE_SIZE)
    plate.apply_translation([0.0, 0.0, PLATE_TOP - PLATE_SIZE[2] / 2])
    for mesh in (ball, plate):
        mesh.vertices = mesh.vertices.astype(np.float32)
    return [ball, plate]


def cloth_model(resolution: int, device: str = "cpu") -> newton.Model:
    """A cloth of ``resolution`` cells on each side above the obstacles, coloured for VBD."""
    builder = newton.ModelBuilder()
    cell = CLOTH_SIDE / resolution
    builder.add_cloth_grid(
        pos=wp.vec3(-CLOTH_SIDE / 2, -CLOTH_SIDE / 2, CLOTH_HEIGHT),
        rot=wp.quat_from_axis_angle(wp.normalize(wp.vec3(0.3, 1.0, 0.2)), 0.15),
        vel=wp.vec3(0.0, 0.0, -CLOTH_SPEED),
        dim_x=resolution,
        dim_y=resolution,
        cell_x=cell,
        cell_y=cell,
        mass=0.2 * cell**2,
        tri_ke=1e3,
        tri_ka=1e3,
        tri_kd=1e-2,
        edge_ke=1e-2,
        edge_kd=1e-3,
        particle_radius=THICKNESS,
    )
    contact = newton.ModelBuilder.ShapeConfig(ke=STIFFNESS, kd=0.0, mu=0.3, margin=0.0)
    for mesh in obstacle_meshes():
        shape = newton.Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32).ravel())
        builder.add_shape_mesh(body=-1, mesh=shape, cfg=contact)
    builder.color(include_bending=True)
    model = builder.finalize(device=device)
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = STIFFNESS, 0.0, 0.3
    return model


def collision_mesh(model: newton.Model) -> ccd.CollisionMesh:
    """Body 0: the particles of the model and their triangles; the others: its static mesh shapes, in their order."""
    bodies = [(model.particle_q.numpy().astype(np.float64), model.tri_indices.numpy())]
    bodies += [(mesh.vertices, mesh.faces) for mesh in obstacle_meshes()]
    return ccd.CollisionMesh.from_arrays(bodies, static=range(1, len(bodies)))


class MotionBound:
    """Restricts particles to motions that are certain to be free of collisions.

    Attributes:
        start: Positions after the last call of :meth:`apply`, from which the next motion must start.
    """

    def __init__(self, model: newton.Model, mesh: ccd.CollisionMesh) -> None:
        # Every remaining gap is certain to be larger than the separation, with the same options, so the next start is
        # free. The tolerance is small beside the separation, so that close primitives can move.
        self.pipeline = ccd.CollisionPipeline(
            mesh, minimum_separation=SEPARATION, tolerance=1e-8, length_scale=1.0, device=model.device
        )
        self.pipeline.reserve(max_pairs=1 << 18)
        self.start = wp.clone(model.particle_q)

    def apply(self, wished: wp.array) -> None:
        """Shorten the path from ``start`` to the desired positions in place; the rows are those of the particles."""
        result = self.pipeline.launch_line_search(self.start, wished, per="vertex")
        flags = int(result.flags.numpy()[0])
        if flags:  # rather than particles that stop for no visible reason
            raise RuntimeError(f"{ccd.LaunchFlag(flags)!r}; reserve more")
        wp.copy(self.start, wished)


@wp.kernel
def report_contacts(
    # in: what ccd_warp found
    count: wp.array[wp.int32],
    kind: wp.array[wp.int32],
    primitives: wp.array[wp.vec2i],
    parameters: wp.array[wp.vec2d],
    normal: wp.array[wp.vec3d],
    # in: the mesh; particles come first
    edges: wp.array[wp.vec2i],
    faces: wp.array[wp.vec3i],
    vertex_body: wp.array[wp.int32],
    rest: wp.array[wp.vec3f],
    num_particles: int,
    # out: newton's soft contacts
    soft_count: wp.array[wp.int32],
    soft_indices: wp.array[wp.vec3i],
    soft_particle: wp.array[wp.int32],
    soft_barycentric: wp.array[wp.vec3f],
    soft_shape: wp.array[wp.int32],
    soft_position: wp.array[wp.vec3f],
    soft_normal: wp.array[wp.vec3f],
):
    """Write a contact of particles with an obstacle as one of newton's: a plane at the obstacle."""
    i = wp.tid()
    if i >= wp.min(count[0], kind.shape[0]):
        return
    pair = primitives[i]
    u = wp.float32(parameters[i][0])
    v = wp.float32(parameters[i][1])
    corners = wp.vec4i()
    weights = wp.vec4f()
    if kind[i] == EDGE_EDGE:
        a = edges[pair[0]]
        b = edges[pair[1]]
        corners = wp.vec4i(a[0], a[1], b[0], b[1])
        weights = wp.vec4f(1.0 - u, u, v - 1.0, -v)
    else:
        f = faces[pair[1]]
        corners = wp.vec4i(pair[0], f[0], f[1], f[2])
        weights = wp.vec4f(1.0, u + v - 1.0, -u, -v)

    indices = wp.vec3i(-1, -1, -1)
    barycentric = wp.vec3f()
    shape = wp.int32(-1)
    on_obstacle = wp.vec3f()
    n = wp.int32(0)
    for k in range(4):
        c = corners[k]
        w = wp.abs(weights[k])
        if c < num_particles:
            if n < 3:
                indices[n] = c
                barycentric[n] = w
            n += 1
        else:
            on_obstacle += w * rest[c]
            shape = vertex_body[c] - 1
    direction = wp.vec3f(normal[i])  # from the second primitive to the first
    if corners[0] >= num_particles:
        direction = -direction
    if n == 4 or wp.length(direction) == 0.0:
        return  # newton has no contact of this kind for cloth with cloth
    slot = wp.atomic_add(soft_count, 0, 1)
    soft_indices[slot] = indices
    soft_particle[slot] = wp.where(n == 1, indices[0], -1)
    soft_barycentric[slot] = barycentric
    soft_shape[slot] = shape
    soft_position[slot] = on_obstacle
    soft_normal[slot] = direction


class CCDCollisionPipeline(newton.CollisionPipeline):
    """A newton pipeline that bounds the motion of particles, and reports contacts with static shapes along it.

    Call :meth:`begin` before and :meth:`finish` after each ``SolverVBD.step``. The solver must own it, with
    ``rigid_soft_enable_dat=True``, and with the slot RIGID scheduled before every iteration.
    """

    def __init__(self, model: newton.Model, mesh: ccd.CollisionMesh) -> None:
        # The gap sets DAT's budget of motion, and nothing else here: this pipeline does the detection. With more than
        # a step ever moves, the budget never binds.
        super().__init__(model, soft_contact_gap=1e3, soft_contact_max=MAX_CONTACTS, contact_matching="latest")
        self.bound = MotionBound(model, mesh)
        self.finder = ccd.CollisionPipeline(
            mesh, minimum_separation=THICKNESS, tolerance=1e-8, length_scale=1.0, device=model.device
        )
        self.finder.reserve(max_pairs=1 << 18, max_contacts=MAX_CONTACTS)
        as_vectors = ((mesh.edges, wp.vec2i), (mesh.faces, wp.vec3i), (mesh.vertex_body, wp.int32))
        self.topology = [wp.array(values, dtype=dtype, device=model.device) for values, dtype in as_vectors]
        self.rest = wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3f, device=model.device)
        self.begin_q = wp.clone(model.particle_q)

    def begin(self, state: newton.State) -> None:
        """Store the start positions of a step, because newton changes its input state during the step."""
        wp.copy(self.bound.start, state.particle_q)
        wp.copy(self.begin_q, state.particle_q)

    def collide(self, state: newton.State, contacts: newton.Contacts, **_) -> None:
        """Find the contacts on the path to the iterate, and bound the iterate in place."""
        found = self.finder.launch(self.bound.start, state.particle_q).contacts
        contacts.clear()
        wp.launch(
            report_contacts,
            dim=MAX_CONTACTS,
            inputs=[found.count, found.kind, found.primitives, found.parameters, found.normal]
            + [*self.topology, self.rest, len(state.particle_q)],
            outputs=[
                contacts.soft_contact_count,
                contacts.soft_contact_indices,
                contacts.soft_contact_particle,
                contacts.soft_contact_barycentric,
                contacts.soft_contact_shape,
                contacts.soft_contact_body_pos,
                contacts.soft_contact_normal,
            ],
            device=self.rest.device,
        )
        self.bound.apply(state.particle_q)

    def finish(self, state: newton.State, dt: float) -> None:
        """Bound the motion of the last iteration, and set the velocities of the output state."""
        self.bound.apply(state.particle_q)
        set_velocities(self.begin_q, state, dt)


@wp.kernel
def divide_difference(a: wp.array[wp.vec3f], b: wp.array[wp.vec3f], dt: float, out: wp.array[wp.vec3f]):
    i = wp.tid()
    out[i] = (b[i] - a[i]) / dt


def set_velocities(start: wp.array, state: newton.State, dt: float) -> None:
    """Set the velocities of a state that was reached from a start in one step."""
    arrays = [start, state.particle_q, dt, state.particle_qd]
    wp.launch(divide_difference, dim=len(start), inputs=arrays, device=start.device)


class ClothThrow:
    """The simulation in one of the ``MODES``."""

    def __init__(self, mode: str, resolution: int = 24, device: str = "cpu") -> None:
        if mode not in MODES:
            raise ValueError(f"mode is {mode!r}; expected one of {', '.join(map(repr, MODES))}")
        self.mode = mode
        self.model = cloth_model(resolution, device)
        self.mesh = collision_mesh(self.model)
        self.pipeline: newton.CollisionPipeline | None = None
        owned: dict = {}
        if mode == "iterations":
            slot, frequency = SolverVBD.CollisionSlot.RIGID, SolverVBD.CollisionFrequencyType.ITERATIONS
            self.pipeline = CCDCollisionPipeline(self.model, self.mesh)
            owned = {"collision_pipeline": self.pipeline, "collision_frequency_type": {slot: frequency}}
            owned["rigid_soft_enable_dat"] = True
        elif mode == "end":
            self.bound = MotionBound(self.model, self.mesh)
        elif mode == "newton":
            self.pipeline = newton.CollisionPipeline(self.model)
        self.contacts = self.pipeline.contacts() if mode == "newton" else None
        self.solver = SolverVBD(self.model, iterations=ITERATIONS, **owned)
        self.state, self.next_state = self.model.state(), self.model.state()

    def step(self) -> NDArray[np.float64]:
        """One step; positions of all vertices of the mesh after it, shape [V, 3]."""
        self.state.clear_forces()
        start = wp.clone(self.state.particle_q)
        if self.mode == "iterations":
            self.pipeline.begin(self.state)
        elif self.mode == "newton":
            self.pipeline.collide(self.state, self.contacts)
        self.solver.step(self.state, self.next_state, None, self.contacts, STEP_TIME)
        if self.mode == "iterations":
            self.pipeline.finish(self.next_state, STEP_TIME)
        elif self.mode == "end":
            self.bound.apply(self.next_state.particle_q)
            set_velocities(start, self.next_state, STEP_TIME)
        self.state, self.next_state = self.next_state, self.state
        return np.vstack([self.state.particle_q.numpy(), self.mesh.vertices[len(start) :]])

    def frames(self, num_steps: int) -> Iterator[NDArray[np.float64]]:
        """Positions after each step."""
        for _ in range(num_steps):
            yield self.step()


def vertices_below_plate(mesh: ccd.CollisionMesh, vertices: NDArray[np.float64]) -> int:
    """Particles under the level of the plate's bottom and within its outline, by exact comparisons."""
    plate = mesh.vertices[mesh.body_vertex_range[-2] :]
    particles = vertices[mesh.vertex_body == 0]
    within = (particles[:, :2] > plate[:, :2].min(axis=0)).all(axis=1)
    within &= (particles[:, :2] < plate[:, :2].max(axis=0)).all(axis=1)
    return int((within & (particles[:, 2] < plate[:, 2].min())).sum())


def intersecting_pairs(mesh: ccd.CollisionMesh, vertices: NDArray[np.float64]) -> int:
    """Number of pairs of faces that intersect beyond a vertex or an edge that they share, by CGAL's exact kernel."""
    from igl.copyleft import cgal  # imported here, so that everything else runs without it

    found = cgal.remesh_self_intersections(vertices, mesh.faces.astype(np.int64), detect_only=True)
    return len(found[2])


def stretch(mesh: ccd.CollisionMesh, vertices: NDArray[np.float64]) -> float:
    """The 99th percentile of the lengths of the cloth's edges, as multiples of their rest lengths."""
    edges = mesh.edges[mesh.edge_body == 0]
    lengths = [np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (mesh.vertices, vertices)]
    return float(np.quantile(lengths[1] / lengths[0], 0.99))


def main() -> None:
    """Run one mode and print the results of the check."""
    parser = argparse.ArgumentParser(
        description="A newton cloth thrown at obstacles, with ccd_warp or without.",
        epilog="; ".join(f"{name}: {meaning}" for name, meaning in MODES.items()),
    )
    parser.add_argument("--mode", choices=MODES, default="iterations")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--resolution", type=int, default=24, help="cells along a side of the cloth (default 24)")
    parser.add_argument("--device", default="cpu", help="Warp device (default cpu)")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    throw = ClothThrow(options.mode, options.resolution, options.device)
    print(f"{throw.model.particle_count} particles, {len(throw.mesh.faces)} faces, mode {options.mode}")
    seconds = []
    begin = time.perf_counter()
    worst_below, worst_pairs, worst_stretch, num_bad = 0, 0, 0.0, 0
    for k, vertices in enumerate(throw.frames(options.steps)):
        seconds.append(time.perf_counter() - begin)
        below, pairs = vertices_below_plate(throw.mesh, vertices), intersecting_pairs(throw.mesh, vertices)
        last_stretch = stretch(throw.mesh, vertices)
        worst_below, worst_pairs, num_bad = max(worst_below, below), max(worst_pairs, pairs), num_bad + (pairs > 0)
        worst_stretch = max(worst_stretch, last_stretch)
        speed = np.linalg.norm(throw.state.particle_qd.numpy(), axis=1)
        height = vertices[: throw.model.particle_count, 2]
        print(
            f"step {k}: {below} below the plate, {pairs} pairs intersect, z {height.min():.3f} to {height.max():.3f}, "
            f"speed up to {speed.max():.2f}, stretch {last_stretch:.2f}, {seconds[-1]:.2f} s"
        )
        begin = time.perf_counter()
    print(f"{np.median(seconds):.3f} s a step (median), first {seconds[0]:.1f} s")
    print(f"stretch of 99 in 100 edges: {worst_stretch:.1f} at most, {last_stretch:.1f} at the end")
    print(
        f"{options.mode}: at most {worst_below} vertices below the plate, "
        f"{num_bad} of {options.steps} steps with intersecting faces, at most {worst_pairs} pairs of them"
    )


if __name__ == "__main__":
    main()
