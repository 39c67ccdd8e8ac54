"""A newton cloth that is thrown at a ball and a thin plate, ten edge lengths a step, and passes through neither.

newton's SolverVBD moves the cloth; ccd_warp bounds its motion, vertex by vertex, on newton's own float32 arrays. The
interface is newton's: a solver owns a `newton.CollisionPipeline` and calls its `collide` before every iteration, with
the positions that the iteration begins from. With Divide-and-Truncate enabled (`rigid_soft_enable_dat`) it continues
from the positions after that call. `CCDCollisionPipeline` is such a pipeline. Each call

1. finds by `launch` the contacts on the path to these positions, and passes them on: newton makes forces of them;
2. shortens the path by `launch_line_search(per="vertex")`, in place.

The motion of the last iteration is bounded after the step. The cloth is thrown twice more: with its motion bounded
after a step alone, and with newton's own contacts, where it falls through the plate. docs/newton.md says more.

    pip install -e '.[newton]' && python examples/newton_cloth.py --output newton

takes 20 s on two cores, and the first time a minute more to compile newton's kernels; it draws newton/newton_cloth.png.
"""

import argparse
from pathlib import Path

import numpy as np
import trimesh
import warp as wp
from numpy.typing import NDArray

import ccd_warp as ccd

try:
    import newton
    from newton.solvers import SolverVBD
except ImportError:
    raise SystemExit("newton_cloth.py needs newton; install it with: pip install 'ccd-warp[newton]'") from None

# Lengths in metres, times in seconds.
STEP_TIME, ITERATIONS = 1.0 / 30.0, 8
CLOTH_SIDE, CLOTH_HEIGHT, CLOTH_SPEED = 1.0, 0.55, 12.0
BALL_RADIUS, PLATE_SIZE, PLATE_TOP = 0.25, (2.0, 2.0, 0.01), -0.35
# The distance at which contacts act, and the least distance along any path.
THICKNESS, SEPARATION = 8e-3, 5e-4
STIFFNESS, MAX_CONTACTS = 2e3, 1 << 16  # of contacts, the stiffness in newton per metre
MODES = {"iterations": "before each iteration", "end": "after a step", "newton": "newton's contacts"}
KEY_FRAMES = (0, 1, 3)


def obstacle_meshes() -> list[trimesh.Trimesh]:
    """The ball and the plate below it; all corners are float32 numbers, so that both codes see the same surface."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=BALL_RADIUS)
    plate = trimesh.creation.box(extents=PLATE_SIZE)
    plate.apply_translation([0.0, 0.0, PLATE_TOP - PLATE_SIZE[2] / 2])
    for mesh in (ball, plate):
        mesh.vertices = mesh.vertices.astype(np.float32)
    return [ball, plate]


def cloth_model(resolution: int, device: str) -> newton.Model:
    """A cloth of ``resolution`` cells on each side above the obstacles, coloured for VBD."""
    builder, cell = newton.ModelBuilder(), CLOTH_SIDE / resolution
    place = {"pos": wp.vec3(-CLOTH_SIDE / 2, -CLOTH_SIDE / 2, CLOTH_HEIGHT), "vel": wp.vec3(0.0, 0.0, -CLOTH_SPEED)}
    place["rot"] = wp.quat_from_axis_angle(wp.normalize(wp.vec3(0.3, 1.0, 0.2)), 0.15)
    sizes = {"dim_x": resolution, "dim_y": resolution, "cell_x": cell, "cell_y": cell, "mass": 0.2 * cell**2}
    material = {"tri_ke": 1e3, "tri_ka": 1e3, "tri_kd": 1e-2, "edge_ke": 1e-2, "edge_kd": 1e-3}
    builder.add_cloth_grid(**place, **sizes, **material, particle_radius=THICKNESS)
    contact = newton.ModelBuilder.ShapeConfig(ke=STIFFNESS, kd=0.0, mu=0.3, margin=0.0)
    for mesh in obstacle_meshes():
        shape = newton.Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32).ravel())
        builder.add_shape_mesh(body=-1, mesh=shape, cfg=contact)
    builder.color(include_bending=True)
    model = builder.finalize(device=device)
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = STIFFNESS, 0.0, 0.3
    return model


class CCDCollisionPipeline(newton.CollisionPipeline):
    """A newton pipeline that bounds the motion of particles, and reports contacts with static shapes along it."""

    def __init__(self, model: newton.Model, mesh: ccd.CollisionMesh) -> None:
        # The gap sets DAT's budget of motion, and nothing else here: with more than a step ever moves, it never binds.
        super().__init__(model, soft_contact_gap=1e3, soft_contact_max=MAX_CONTACTS, contact_matching="latest")
        # Every remaining gap is certain to be larger than the separation, so the next start is free. The tolerance is
        # small beside it, so that close primitives can move.
        lengths = {"tolerance": 1e-8, "length_scale": 1.0, "device": model.device}
        self.guard = ccd.CollisionPipeline(mesh, minimum_separation=SEPARATION, **lengths)
        self.guard.reserve(max_pairs=1 << 18)
        self.finder = ccd.CollisionPipeline(mesh, minimum_separation=THICKNESS, **lengths)
        self.finder.reserve(max_pairs=1 << 18, max_contacts=MAX_CONTACTS)
        self.mesh, self.start = mesh, wp.clone(model.particle_q)  # where the next motion starts

    def collide(self, state: newton.State, contacts: newton.Contacts, **_) -> None:
        """Find the contacts on the path to the iterate, and bound the iterate in place."""
        found = self.finder.launch(self.start, state.particle_q).to_host().contacts
        found = found[found.bodies.max(axis=1) > 0]  # newton has no contact of this kind for cloth with cloth
        first = np.argsort(found.vertices >= len(self.start), axis=1, kind="stable")  # the corners of the cloth first
        corners, weights = (np.take_along_axis(a, first, axis=1) for a in (found.vertices, np.abs(found.weights)))
        of_cloth = corners < len(self.start)
        indices = np.where(of_cloth, corners, -1)[:, :3]
        rows = {"indices": indices, "barycentric": np.where(of_cloth, weights, 0.0)[:, :3]}
        rows["particle"] = np.where(of_cloth.sum(axis=1) == 1, indices[:, 0], -1)
        rows["shape"] = found.bodies.max(axis=1) - 1  # the cloth is body 0
        rows["body_pos"] = np.einsum("ck,ckx->cx", weights * ~of_cloth, self.mesh.vertices[corners])
        rows["normal"] = np.where(found.bodies[:, :1] == 0, found.normal, -found.normal)
        contacts.clear()
        contacts.soft_contact_count.fill_(len(found))
        for name, values in rows.items():
            getattr(contacts, f"soft_contact_{name}")[: len(found)].assign(values)
        self.bound(state)

    def bound(self, state: newton.State) -> None:
        """Shorten the path from the start to the positions in place, from where the next iteration goes on."""
        result = self.guard.launch_line_search(self.start, state.particle_q, per="vertex")
        if flags := int(result.flags.numpy()[0]):  # rather than particles that stop for no visible reason
            raise RuntimeError(f"{ccd.LaunchFlag(flags)!r}; reserve more")
        wp.copy(self.start, state.particle_q)


class ClothThrow:
    """The simulation in one of the ``MODES``. The particles are the first vertices of the mesh."""

    def __init__(self, mode: str, resolution: int = 24, device: str = "cpu") -> None:
        self.model = cloth_model(resolution, device)
        cloth = (self.model.particle_q.numpy().astype(np.float64), self.model.tri_indices.numpy())
        obstacles = [(mesh.vertices, mesh.faces) for mesh in obstacle_meshes()]
        self.mesh = ccd.CollisionMesh.from_arrays([cloth, *obstacles], static=[1, 2])
        self.with_ccd, owned = mode != "newton", {}
        if self.with_ccd:
            self.pipeline = CCDCollisionPipeline(self.model, self.mesh)
        else:
            self.pipeline = newton.CollisionPipeline(self.model)
        if mode == "iterations":
            slot, frequency = SolverVBD.CollisionSlot.RIGID, SolverVBD.CollisionFrequencyType.ITERATIONS
            owned = {"collision_pipeline": self.pipeline, "collision_frequency_type": {slot: frequency}}
            owned["rigid_soft_enable_dat"] = True
        self.contacts = None if self.with_ccd else self.pipeline.contacts()
        self.solver = SolverVBD(self.model, iterations=ITERATIONS, **owned)
        self.state, self.next_state = self.model.state(), self.model.state()

    def step(self) -> NDArray[np.float64]:
        """One step; positions of all vertices of the mesh after it, shape [V, 3]."""
        self.state.clear_forces()
        start = self.state.particle_q.numpy().copy()
        if self.with_ccd:
            wp.copy(self.pipeline.start, self.state.particle_q)
        else:
            self.pipeline.collide(self.state, self.contacts)
        self.solver.step(self.state, self.next_state, None, self.contacts, STEP_TIME)
        if self.with_ccd:
            self.pipeline.bound(self.next_state)
            self.next_state.particle_qd.assign((self.next_state.particle_q.numpy() - start) / STEP_TIME)
        self.state, self.next_state = self.next_state, self.state
        return np.vstack([self.state.particle_q.numpy(), self.mesh.vertices[len(start) :]])


def vertices_below_plate(mesh: ccd.CollisionMesh, vertices: NDArray[np.float64]) -> int:
    """Particles under the level of the plate's bottom, by exact comparisons."""
    return int((vertices[mesh.vertex_body == 0, 2] < mesh.vertices[mesh.vertex_body == 2, 2].min()).sum())


def stretch(mesh: ccd.CollisionMesh, vertices: NDArray[np.float64]) -> float:
    """The 99th percentile of the lengths of the cloth's edges, as multiples of their rest lengths."""
    now, rest = (np.subtract(*x[mesh.edges[mesh.edge_body == 0].T]) for x in (vertices, mesh.vertices))
    return float(np.quantile(np.linalg.norm(now, axis=1) / np.linalg.norm(rest, axis=1), 0.99))


def draw(pyvista, plotter, state: tuple[ccd.CollisionMesh, NDArray[np.float64]]) -> None:
    """Add the cloth, the ball and the plate."""
    mesh, vertices = state
    for body, color in enumerate(("#f0a04b", "#b8b8b8", "#9fb8a5")):
        surface = pyvista.PolyData.from_regular_faces(vertices, mesh.faces[mesh.face_body == body])
        plotter.add_mesh(surface, color=color, smooth_shading=body == 1, ambient=0.15)


def main() -> None:
    """Throw with ccd_warp and with newton's own contacts, count, print, and draw."""
    parser = argparse.ArgumentParser(description="A newton cloth thrown at obstacles, with CCD and without, in 20 s.")
    parser.add_argument("--frames", type=int, default=20, help="default 20")
    parser.add_argument("--resolution", type=int, default=24, help="cells along a side of the cloth (default 24)")
    parser.add_argument("--output", type=Path, help="folder for newton_cloth.png (none is drawn without)")
    options = parser.parse_args()
    rows, wp.config.log_level = [[] for _ in MODES], wp.LOG_WARNING
    for row, (mode, title) in zip(rows, MODES.items(), strict=True):
        throw, num_bad, longest = ClothThrow(mode, options.resolution), 0, 0.0
        for frame in range(options.frames):
            vertices = throw.step()
            below, now = vertices_below_plate(throw.mesh, vertices), stretch(throw.mesh, vertices)
            num_bad, longest = num_bad + (len(ccd.find_intersections(throw.mesh, vertices)) > 0), max(longest, now)
            if frame in {*KEY_FRAMES, options.frames - 1}:
                row.append((f"{title}, frame {frame}: {below} below", (throw.mesh, vertices)))
        print(f"{mode:10} {below} of {throw.model.particle_count} vertices end below the plate,", end=" ")
        print(f"{num_bad} of {options.frames} frames with intersections,", end=" ")
        print(f"stretch at most {longest:.1f}, at the end {now:.1f}")
    if options.output:
        from key_frames import draw_rows

        draw_rows(options.output / "newton_cloth.png", rows, draw, [(1.6, -2.6, 1.1), (0, 0, -0.15), (0, 0, 1)])


if __name__ == "__main__":
    main()
