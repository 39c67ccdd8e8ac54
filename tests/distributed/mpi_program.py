"""What `test_distributed.py` runs on several ranks: cuts of meshes, whose results have the bits of one process.

    mpiexec -n 3 python -m mpi4py tests/distributed/mpi_program.py [--every | CASE ...]

One program goes through all cases, because starting processes and compiling kernels takes most of the time. It prints a
line for each case, on rank 0; run by ``-m mpi4py``, a failure on one rank ends all. Without ``--every`` or names it
leaves some of the scenes out that show in another way what the others do.
"""

import sys
import time
import warnings
from pathlib import Path
from unittest import mock

sys.path.append(str(Path(__file__).resolve().parents[1] / "helpers"))

import numpy as np
import scenes
import trimesh
from mpi4py import MPI
from mpi_parts import Cut, compare, compare_call, whole_mesh

import ccd_warp as ccd
from ccd_warp._engine.mesh import topology
from ccd_warp.distributed import _ranks

COMM = MPI.COMM_WORLD
RANK, SIZE = COMM.Get_rank(), COMM.Get_size()
ALL_CALLS = ["mesh_ccd", "collision_free_step", "is_step_collision_free", "find_candidates"]
IS_EVERY = len(sys.argv) > 1
SEARCHES = ["line_search scene", "line_search world", "line_search body", "line_search vertex"]


def some(scenes, step):
    """Every so many of scenes, from the first on; or all."""
    return scenes if IS_EVERY else scenes[::step]


def interleaved(mesh, seed=0):
    """Every face on a rank by chance."""
    return np.random.default_rng(seed).integers(0, SIZE, mesh.num_faces)


def in_blocks(mesh):
    """Consecutive faces on a rank."""
    return np.arange(mesh.num_faces) * SIZE // max(mesh.num_faces, 1)


def check(scene, rank_of_face, calls, *, with_owners=False, motion=None, **options):
    mesh, start, end = scene
    mesh = whole_mesh(mesh)
    cut = Cut(COMM, mesh, rank_of_face(mesh), np.random.default_rng(RANK), with_owners)
    return compare(COMM, cut, mesh, start, end, calls, options, motion)


def cloth_over_sphere():
    check(scenes.sheet_over_ball(), in_blocks, [*ALL_CALLS, *SEARCHES, "find_proximity"])


def static_floor_and_owners_that_are_given():
    check(scenes.sheet_over_floor(), interleaved, [*ALL_CALLS, "line_search vertex"], with_owners=True)


def pile():
    """Bodies that fall on each other, some of which ignore themselves, and pairs of which ignore each other."""
    rng = np.random.default_rng(1)
    box = trimesh.creation.icosphere(subdivisions=1, radius=0.4)
    at = 1.2 * np.array([(i, j, k) for i in range(3) for j in range(3) for k in range(3)]) + 0.2 * rng.random((27, 3))
    bodies = [(box.vertices + x, box.faces) for x in at]
    pairs = rng.random((27, 27)) < 0.9
    mesh = ccd.CollisionMesh.from_arrays(
        bodies,
        static=[0, 13],
        self_collision=(rng.random(27) < 0.5).tolist(),
        body_pairs=pairs & pairs.T,
        exclude_pairs={"bodies": [[1, 2], [4, 4], [5, 14]]},
    )
    speed = 0.8 * rng.standard_normal((27, 3))
    calls = [*ALL_CALLS, "line_search body", "displacement_bounds"]
    speed[[0, 13]] = 0.0
    check((mesh, mesh.vertices, mesh.vertices + speed[mesh.vertex_body]), in_blocks, calls)


def bodies_that_ignore_themselves():
    """Only bodies that come near another are active."""
    box = trimesh.creation.box(extents=(1, 1, 1))
    bodies = [(box.vertices + [1.5 * k, 0, 0], box.faces) for k in range(6)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False)
    end = mesh.vertices + [[0.9, 0.01, 0.02]] * (mesh.vertex_body == 2)[:, None]
    check((mesh, mesh.vertices, end), interleaved, ALL_CALLS)


def worlds():
    _, mesh, start, end = scenes.cloth_and_ball_in_worlds()
    check((mesh, start, end), in_blocks, ["mesh_ccd", "find_candidates", "line_search world"])


def giant_face():
    """A face that is larger than all regions together."""
    vertices, faces = scenes.sheet(10)
    giant = scenes.TRIANGLE * 50.0 + [0.3, 0.2, -0.2]
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces), (giant, scenes.FACE)], static=[1])
    end = mesh.vertices - [0.01, 0.02, 0.5] * (mesh.vertex_body == 0)[:, None]
    pipeline = check((mesh, mesh.vertices, end), interleaved, ALL_CALLS)
    # the giant face, its edges and vertices are everywhere, but not twice
    part = pipeline._planned.part
    assert pipeline.work.num_primitives >= 7
    for numbers in (part.face_numbers, part.edge_numbers, part.vertex_numbers):
        assert (np.diff(numbers) > 0).all()


def all_faces_on_the_last_rank():
    with mock.patch.object(_ranks, "MOST_BYTES", 5_000):  # what does not fit into a message comes in several
        check(scenes.sheet_over_ball(), lambda mesh: np.full(mesh.num_faces, SIZE - 1), ALL_CALLS)


def one_triangle_falls_on_another():
    """Fewer primitives than samples, and with four ranks empty ones; then it stays, but for the signs of zeros."""
    mesh, start = scenes.stacked(0.0, 0.5)
    end = start - [0, 0, 1.0] * (mesh.vertex_body == 1)[:, None]
    check((mesh, start, end), interleaved, ALL_CALLS + SEARCHES)
    check((mesh, start, np.where(end == 0.0, -0.0, start)), interleaved, ["mesh_ccd", "line_search vertex"])


def nothing_at_all():
    mesh = ccd.CollisionMesh.from_arrays([(np.zeros((0, 3)), scenes.NO_FACES)])
    calls = ["mesh_ccd", "collision_free_step", "find_candidates", "find_intersections"]
    pipeline = check((mesh, mesh.vertices, mesh.vertices), interleaved, calls)
    assert pipeline.mesh_ccd([], []).toi == np.inf  # an empty list has no columns


def cables_particles_and_rings():
    rng = np.random.default_rng(3)
    start, faces, edges = scenes.cables_and_particles(rng, 40, 0.1)
    end = start + 0.15 * rng.standard_normal(start.shape)
    for options in ({"exclusion_rings": 2}, {"exclude_pairs": {"vertices": [[0, 5], [7, 200], [11, 300]]}}):
        mesh = ccd.CollisionMesh.from_arrays([(start, faces, edges)], codimensional_points=True, **options)
        check((mesh, start, end), interleaved, ["mesh_ccd", "find_candidates"])
    vertices, faces = scenes.sheet(6)
    end = vertices + 0.3 * rng.standard_normal(vertices.shape)
    for rings in (3, 100):
        mesh = ccd.CollisionMesh.from_arrays([(vertices, faces)], exclusion_rings=rings)
        check((mesh, vertices, end), interleaved, ["mesh_ccd"])


def vertices_that_take_no_part():
    """Of a list of nodes that two bodies share, and between those of a soup, at no number and far away."""
    rng = np.random.default_rng(5)
    nodes, faces = scenes.soup(rng, 40, 0.25)
    bodies = [(nodes, faces[:20]), (nodes, faces[20:]), scenes.cables_and_particles(rng, 12, 0.2)]
    calls = ["mesh_ccd", "collision_free_step", "find_proximity", "displacement_bounds", *SEARCHES]
    for far, options in ((np.nan, {"radius": 0.01}), (1e200, {"static": [1], "self_collision": False})):
        x = ccd.CollisionMesh.from_arrays(bodies).vertices.copy()
        end = x + 0.2 * rng.standard_normal(x.shape) * [[v >= len(nodes)] for v in range(len(x))]
        end[: len(nodes)] -= [0.0, 0.1, 0.2]
        end[len(nodes) : 2 * len(nodes)] = x[len(nodes) : 2 * len(nodes)]
        unused = ccd.CollisionMesh.from_arrays(bodies).unused_vertices
        x[unused], end[unused] = far, 2.0 * far
        sizes = np.cumsum([len(nodes), len(nodes)])
        parts = [(of, *body[1:]) for of, body in zip(np.split(x, sizes), bodies, strict=True)]
        mesh = ccd.CollisionMesh.from_arrays(parts, **options)
        assert len(unused) == len(mesh.unused_vertices) > len(nodes)
        pipeline = check((mesh, x, end), interleaved, calls)
        assert (
            "take no part" in repr(pipeline.mesh)
            and not np.isin(pipeline._planned.part.vertex_ids, 2 * unused + 5).any()
        )
    turned = ccd.RigidMotion([[0.0, 0, 0, 0, 0, 0, 1]] * 2, [[0.1, 0, 0, 0.1, 0.2, 0, 1], [0, 0, 0, 0, 0, 0, 1]])
    mesh = ccd.CollisionMesh.from_arrays(parts, rigid=[0, 1])
    check((mesh, x, x), interleaved, ["mesh_ccd", *SEARCHES], motion=turned)


def starts(rng):
    """Meshes, and positions at which much of them touches or passes through each other."""
    mesh, start, end = scenes.sheet_over_ball()
    yield mesh, 0.5 * start + 0.5 * end
    # coordinates in eighths: faces in common planes, edges on edges, vertices in one place
    ball, box = trimesh.creation.icosphere(subdivisions=1), trimesh.creation.box().subdivide()
    grid, faces = scenes.sheet(5)
    parts = [np.round(8 * ball.vertices) / 8, box.vertices + rng.integers(-3, 4, 3) / 8, grid + [0, 0, 0.5]]
    parts[2][:, 2] = rng.integers(0, 3, len(grid)) / 8
    bodies = list(zip(parts, (ball.faces, box.faces, faces), strict=True))
    pairs = np.array([[1, 1, 1], [1, 1, 0], [1, 0, 1]], dtype=bool)
    for options in (
        {"static": [1]},
        {"self_collision": False, "body_pairs": pairs & pairs.T},
        {"exclude_pairs": {"bodies": [[1, 2]]}},
        {"vertex_world": np.repeat([1, 1, 0], list(map(len, parts))), "radius": 0.01},
    ):
        mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
        yield mesh, mesh.vertices
    # a strip that is folded flat
    folded = np.column_stack([np.abs(grid[:, 0]), grid[:, 1], np.zeros(len(grid))])
    mesh = ccd.CollisionMesh.from_arrays([(grid, faces)])
    listed = ccd.find_intersections(mesh, folded).vertices[::9, [0, 4]]
    for options in ({"exclusion_rings": 3}, {"exclude_pairs": {"vertices": listed}}):
        yield ccd.CollisionMesh.from_arrays([(grid, faces)], **options), folded
    # cables that touch the far sides of long faces: the pair of a cable and a side may belong to another rank than that
    # of the cable and the face by way of which it is found
    at = np.arange(24)[:, None, None] / 64
    long_faces = [[0, 0.25, 0], [5, 0, 0], [5.5, 0.5, 0]] + at * [0, 1, 0]
    cables = [[0, 0.25, 1], [10.5, 0.25, -1]] + at * [0, 1, 0]
    triangles, segments = np.arange(72).reshape(-1, 3), np.arange(48).reshape(-1, 2)
    bodies = [(long_faces.reshape(-1, 3), triangles), (cables.reshape(-1, 3), scenes.NO_FACES, segments)]
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    yield mesh, mesh.vertices
    # a flat tetrahedron: of the edges that cross, each face of one shares a vertex with the other
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    yield scenes.single(square, [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]]), square
    # cables through sheets, points on cables, on each other and in faces; faces that repeat a vertex
    for size, options in ((3, {}), (5, {"exclusion_rings": 2}), (4, {"codimensional_points": False})):
        x, faces, edges = scenes.cables_and_particles(rng, 12, 0.5)
        faces[0, 2] = faces[0, 1]
        bodies = [(np.round(size * x) / size, faces, edges)]
        mesh = ccd.CollisionMesh.from_arrays(bodies, **({"codimensional_points": True} | options))
        yield mesh, mesh.vertices


def starts_that_are_not_sound():
    """What touches and what passes through, with the faces of every scene interleaved over ranks, and in blocks."""
    rng = np.random.default_rng(9)
    for k, (mesh, x) in enumerate(starts(rng)):
        check((mesh, x, x), (interleaved, in_blocks)[k % 2], ["find_intersections"], with_owners=k % 3 == 0)
    for seed in some(range(6 * (SIZE - 1), 6 * SIZE), 3):
        rng = np.random.default_rng(seed)
        num_faces = int(rng.integers(1, 40))
        x, faces = scenes.soup(rng, num_faces, 10.0 ** rng.uniform(-1, 0), int(rng.integers(3, 3 * num_faces + 1)))
        x = np.round(x * (cells := int(rng.integers(2, 9)))) / cells if seed % 2 else x
        mesh = ccd.CollisionMesh.from_arrays([(x, faces)], codimensional_points=seed % 3 == 0)
        check((mesh, x, x), interleaved, ["find_intersections"])


def starts_of_a_loop():
    """One pipeline looks at starts, which move and come back, and at steps; a plan for work that lies in one place."""
    rng = np.random.default_rng(2)
    calm, faces = scenes.sheet(16)
    crumpled = 0.1 * rng.random(calm.shape) + [2.0, 0, 0]
    crumpled[40:] = calm[40:] + [4.0, 0, 0]
    mesh = whole_mesh(ccd.CollisionMesh.from_arrays([(calm, faces), (crumpled, faces)]))
    cut = Cut(COMM, mesh, in_blocks(mesh), np.random.default_rng(RANK))
    from ccd_warp.distributed import DistributedPipeline

    pipeline, one = (
        DistributedPipeline(cut.mesh, minimum_distance=0.01),
        ccd.CollisionPipeline(mesh, minimum_distance=0.01),
    )
    x, plans, seen = mesh.vertices, [], []
    for _ in range(3):
        compare_call(COMM, cut, pipeline, one, x, x, "find_intersections")
        seen.append((pipeline.work.imbalance, pipeline.work.is_planned))
    end = x + 0.005 * rng.standard_normal(x.shape)
    for call, at in (("mesh_ccd", x), ("find_intersections", x), ("find_intersections", end), ("mesh_ccd", x)):
        compare_call(COMM, cut, pipeline, one, at, end, call)
        plans.append(pipeline.work.is_planned)
    # what the search found weighs the samples of the next plan, and a plan for a start serves a step
    assert SIZE == 1 or (seen[1][1] and seen[1][0] < 0.9 * seen[0][0]), seen
    assert not plans[0], plans


def options():
    """Separations, batches, a spatial hash, and pairs that share the work that is left to them."""
    scene = scenes.sheet_over_ball()
    check(scene, interleaved, ["mesh_ccd", "collision_free_step", "line_search scene"], minimum_distance=0.01)
    check(scene, interleaved, ["mesh_ccd", "find_candidates"], broad_phase="hash")
    check(scene, interleaved, ["mesh_ccd", "collision_free_step"], max_iterations=300, max_work=1)
    # a fixed length has another size in every scene, and the default is that of the whole mesh
    check(scene, in_blocks, ["mesh_ccd"], minimum_separation=0.01, t_max=0.7)


def work_that_open_pairs_share():
    """Pairs of parallel faces that approach each other slowly stay open in the first round, and share what is left."""
    rng = np.random.default_rng(5)
    start, faces = scenes.soup(rng, 30, 0.3)
    mesh = scenes.single(start, faces)
    end = start[rng.permutation(len(start))]
    for max_work in some((1, 5_000_000), 2):
        options = dict(method="bisection", max_work=max_work)
        check((mesh, start, end), interleaved, ["mesh_ccd", "collision_free_step"], **options)
    # some ranks work in many batches, and share all the same
    start, faces = scenes.soup(rng, 120, 1.0)
    mesh = whole_mesh(scenes.single(start, faces))
    cut = Cut(COMM, mesh, interleaved(mesh), np.random.default_rng(RANK))
    limit = {"memory_limit": 280_000} if RANK % 2 == 0 else {}
    from ccd_warp.distributed import DistributedPipeline

    given = {"method": "bisection", "max_work": 3_000}
    pipeline, one = DistributedPipeline(cut.mesh, **given, **limit), ccd.CollisionPipeline(mesh, **given)
    compare_call(COMM, cut, pipeline, one, start, start[rng.permutation(len(start))], "collision_free_step")
    assert COMM.allreduce(pipeline.work.counts.num_batches, op=MPI.MAX) > 2


def random_bodies(seed):
    """Few faces at random places with large motions, in one body or two: bodies, those that are static, the end."""
    rng = np.random.default_rng(seed)
    num_faces = int(rng.integers(1, 40))
    num_vertices = int(rng.integers(3, 3 * num_faces + 1))
    start, faces = scenes.soup(rng, num_faces, 10.0 ** rng.uniform(-2, 0), num_vertices)
    end = start + 10.0 ** rng.uniform(-2, 0) * rng.standard_normal(start.shape)
    cut = int(rng.integers(0, len(start)))
    bodies = [(start, faces)]
    if 0 < cut and not ((faces < cut).any(axis=1) & (faces >= cut).any(axis=1)).any():
        low = (faces < cut).all(axis=1)
        bodies = [(start[:cut], faces[low]), (start[cut:], faces[~low] - cut)]
    return bodies, [0] if len(bodies) > 1 and rng.random() < 0.5 else [], end


def random_scenes(alone=14, meshes=6, worlds=6):
    """Fifty scenes, others for other numbers of ranks, cut at random: some alone, most as worlds of few meshes."""
    seeds = iter(range(50 * (SIZE - 1), 50 * SIZE))
    for k in some(range(alone + meshes), 3):
        bodies, static, ends, world = [], [], [], []
        for w in range(1 if k < alone else worlds):
            scene, fixed, end = random_bodies(next(seeds))
            static += [len(bodies) + b for b in fixed]
            bodies += scene
            ends.append(end)
            world += [w] * len(end)
        mesh = ccd.CollisionMesh.from_arrays(
            bodies, static=static, codimensional_points=k % 3 == 0, vertex_world=np.array(world)
        )
        calls = [["mesh_ccd"], ["collision_free_step"], ["find_candidates"], ["line_search vertex"]][k % 4]
        end = scenes.with_static_at_rest(mesh, mesh.vertices, np.concatenate(ends))
        scene = mesh, mesh.vertices, end
        check(scene, lambda mesh, k=k: interleaved(mesh, k), calls, with_owners=k % 5 == 0)


def radii():
    """Thick sheets and cables, with radii of vertices whose neighbours are on other ranks."""
    rng = np.random.default_rng(4)
    start, faces, edges = scenes.cables_and_particles(rng, 40, 0.1)
    end = start + 0.1 * rng.standard_normal(start.shape)
    bodies, radius = [(start, faces, edges)], 0.03 * rng.random(len(start))
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, radius=radius)
    check((mesh, start, end), interleaved, [*ALL_CALLS, "find_proximity", "displacement_bounds"])
    box = trimesh.creation.box(extents=(1, 1, 1))
    bodies = [(box.vertices + [1.5 * k, 0, 0], box.faces) for k in range(5)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False, radius=[0.2, 0.1, 0.2, 0.01, 0.0])
    end = mesh.vertices + [[0.35, 0.01, 0.02]] * (mesh.vertex_body == 3)[:, None]
    check((mesh, mesh.vertices, end), interleaved, ["mesh_ccd", "line_search vertex"])


def half_spaces():
    """A ground and a wall, whose numbers are among those of other bodies; vertices meet them on one rank each."""
    vertices, faces = scenes.sheet(8)
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.3)
    ground, wall = ccd.HalfSpace([0.3, 0, 0], [0.1, -0.2, 3.0]), ccd.HalfSpace([0.9, 0, 0], [-2e-3, 0, 0])
    bodies = [ground, (vertices + [0, 0, 0.6] + 0.3 * vertices[:, :1] * [0, 0, 1], faces)]
    bodies += [wall, (ball.vertices + [0.4, 0.5, 1.1], ball.faces)]
    pairs = np.ones((4, 4), dtype=bool)
    pairs[2, 3] = pairs[3, 2] = False
    radius = 0.05 * np.random.default_rng(7).random(sum(len(body[0]) for body in bodies[1::2]))
    calls = ["displacement_bounds", "collision_free_step", "find_candidates", "mesh_ccd"]
    for k, given in enumerate([{"self_collision": [True, True, True, False]}, {"radius": radius, "body_pairs": pairs}]):
        mesh = ccd.CollisionMesh.from_arrays(bodies, exclude_pairs={"bodies": [[3, 0], [1, 1]][: 2 * k]}, **given)
        end = mesh.vertices - [-0.2, 0, 0.9]
        pipeline = check((mesh, mesh.vertices, end), interleaved, calls, minimum_distance=0.01)
        found = ccd.mesh_ccd(mesh, mesh.vertices, end, minimum_distance=0.01).counts
        kind = ccd.PairKind.VERTEX_PLANE
        numbers = COMM.allreduce(pipeline.work.counts.num_candidates[kind]), found.num_candidates[kind]
        assert numbers[0] == numbers[1] > 40, numbers
    # the solid holds a vertex of one rank, which is done with its step at once; the others must not wait for it
    deep = mesh.vertices - [0, 0, 0.56]
    calls = [*ALL_CALLS[1:3], "line_search vertex", "find_proximity", "find_intersections"]
    check((mesh, deep, deep - [0, 0, 0.1]), in_blocks, calls)
    assert (ccd.find_intersections(mesh, deep).kind == ccd.IntersectionKind.VERTEX_PLANE).any()


def kinematic_bodies():
    """Bodies that move as they are told, through what is in their way, beside static ones and a ground."""
    rng = np.random.default_rng(9)
    boxes = trimesh.creation.box(extents=(0.4, 0.4, 0.4)).subdivide()
    places = np.array([[i, j, 0.0] for i in range(3) for j in range(3)])
    bodies = [(boxes.vertices + 0.5 * place, boxes.faces) for place in places]
    bodies.append(ccd.HalfSpace([0, 0, -0.25], [0, 0.1, 1]))
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], kinematic=[1, 4, 7], self_collision=False)
    speed = 0.3 * rng.standard_normal((10, 3))
    speed[0] = 0.0
    calls = [*ALL_CALLS, *SEARCHES, "find_proximity", "find_intersections", "displacement_bounds"]
    check((mesh, mesh.vertices, mesh.vertices + speed[mesh.vertex_body]), in_blocks, calls)


def bodies_that_turn():
    """Boxes that tumble over a static one and a ground, under a sheet that falls: less than a slice, and several."""
    box, rng = trimesh.creation.box((1, 1, 1)).subdivide(), np.random.default_rng(3)
    sheet, faces = scenes.sheet(6)
    bodies = [(box.vertices, box.faces)] * 4 + [(2 * sheet - [1, 1, -1.5], faces)]
    bodies.append(ccd.HalfSpace([0, 0, 0], [0, 0, 1]))
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], rigid=[0, 1, 2, 3])
    poses = np.hstack([[[0, 0, 0.6], [1.4, 0, 0.9], [-1.3, 0.5, 0.9], [0.2, 1.5, 1.0]], rng.standard_normal((4, 4))])
    poses[0, 3:] = [0, 0, 0, 1]
    twist = np.hstack([rng.uniform(-0.5, 0.5, (4, 3)) - [0, 0, 0.5], 1.2 * rng.standard_normal((4, 3))])
    twist[0] = 0.0
    end = mesh.vertices + np.where(mesh.rigid[mesh.vertex_body], 0.0, 1.0)[:, None] * [0.1, 0, -0.9]
    motion = ccd.RigidMotion(poses, twist=twist)
    check((mesh, mesh.vertices, end), interleaved, [*ALL_CALLS, "line_search vertex"], motion=motion)
    calls = ["collision_free_step", "line_search body"]
    check((mesh, mesh.vertices, end), in_blocks, calls, motion=motion, minimum_distance=0.02)
    screw = ccd.RigidMotion(poses, motion.shortened(0.1).poses_t1, path="screw")
    pipeline = check((mesh, mesh.vertices, mesh.vertices), interleaved, ["find_candidates", "mesh_ccd"], motion=screw)
    assert not pipeline.work.is_planned  # the boxes of the first call hold those of the second
    rows = pipeline.mesh.vertices
    joint = ccd.Joint("turn", "base", "arm", "revolute", axis=[0, 0, 1])
    for refused, words in (
        (motion.shortened(0.5 if RANK == SIZE - 1 else 1.0), "motion differs between ranks"),
        (ccd.JointMotion([joint], [0.0], [1.0]), "expected a RigidMotion, the same on all ranks"),
        (ccd.RigidMotion(poses[:2], poses[:2]), "2 rows for 4 rigid bodies"),
    ):
        try:
            pipeline.mesh_ccd(rows, rows, motion=refused)
        except ValueError as error:
            assert words in str(error), error
        else:
            assert SIZE == 1 and words == "motion differs between ranks"


def bar_that_sweeps_the_regions_of_all_ranks():
    """A turn of a bar to where it began, over a point on the other side that its tip barely reaches in a slice."""
    x = np.linspace(0.5, 2.0, 41)
    corners = np.concatenate([np.stack([x, 0.0 * x, np.full(41, z)], axis=1) for z in (-0.05, 0.05)])
    k = np.arange(40)
    faces = np.concatenate([np.stack([k, k + 1, k + 41], axis=1), np.stack([k + 1, k + 42, k + 41], axis=1)])
    begins = np.pi - 3.1
    at_rest = [0, 0, 0, 0, 0, np.sin(0.5 * begins), np.cos(0.5 * begins)]
    twist = np.array([[0.0, 0, 0, 0, 0, 6.2]])
    tip = [-1.998, 0.0, 0.0]  # in the middle of a slice, whose chord ends at 1.99
    for points in ([tip], [tip, [0.8 * np.cos(begins + 0.5), 0.8 * np.sin(begins + 0.5), 0.01]]):
        bodies = [(corners, faces), *((np.array([p]), scenes.NO_FACES) for p in points)]
        static = range(1, len(bodies))
        mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, rigid=[0], static=static)
        motion = ccd.RigidMotion([at_rest], twist=twist)
        calls = ["mesh_ccd", "line_search vertex"][: len(points)]
        check((mesh, mesh.vertices, mesh.vertices), interleaved, calls, motion=motion)
    toi = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=motion, device="cpu").body_toi
    assert 0.49 < toi[1] < 0.5 and abs(toi[2] - 0.5 / 6.2) < 1e-9


def spheres_that_roll_on_each_other():
    """Thousands of candidates, some of which end at a coordinate of their boxes."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    mesh = ccd.CollisionMesh.from_arrays([(sphere.vertices, sphere.faces)] * 3, rigid=[0, 1, 2])
    poses = [[0, 0, 0, 0, 0, 0, 1], [1.02, 0, 0, 0, 0, 0, 1], [0.5, 0.9, 3.0, 0, 0, 0, 1]]
    twist = [[0.01, 0, 0, 0, 0, 0.5], [0, 0, 0, 0, 0.1, 0.3], [0, 0, -2.1, 0.4, 0, 0]]
    check((mesh, mesh.vertices, mesh.vertices), interleaved, ALL_CALLS, motion=ccd.RigidMotion(poses, twist=twist))


def what_starts_within_its_distance():
    """Sheets at their thickness, one above the other, which slide, part and press; in both norms."""
    vertices, faces = scenes.sheet(14)
    layers = [(vertices + [0.03 * k, 0.01 * k, 0.02 * k], faces) for k in range(3)]
    motion = np.array([[0.0, 0.0, 0.0], [0.17, -0.11, 0.0], [0.05, 0.1, 0.03]])
    calls = ["collision_free_step", "mesh_ccd", *SEARCHES]
    for radius, given in some([(0.01, {}), (None, {"minimum_separation": 0.02, "length_scale": 1.0})], 2):
        mesh = ccd.CollisionMesh.from_arrays(layers, radius=radius, self_collision=False)
        end = mesh.vertices + motion[mesh.vertex_body]
        check((mesh, mesh.vertices, end), interleaved, calls, **given)
        end[mesh.vertex_body == 2, 2] -= 0.1 * (mesh.vertices[mesh.vertex_body == 2, 0] > 0.2)
        check((mesh, mesh.vertices, end), in_blocks, calls[:2] + calls[-1:], **given)


def planes_and_nothing_else():
    """Particles that meet a ground alone, in worlds; some of them are static."""
    points = np.random.default_rng(6).random((60, 3))
    bodies = [(points[:40], scenes.NO_FACES), (points[40:], scenes.NO_FACES), ccd.HalfSpace([0, 0, 0.1], [0, 0.1, 1])]
    world = np.arange(60) % 3
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], self_collision=False, vertex_world=world)
    end = points - [0, 0, 0.5] * (mesh.vertex_body == 0)[:, None]
    start = points * [1, 1, 0.3] + [0, 0, 0.12]
    end = scenes.with_static_at_rest(mesh, start, end)
    check((mesh, start, end), interleaved, [*ALL_CALLS, "line_search world", "displacement_bounds"])


def copies_of_a_body_that_moves_alone():
    """One body in each world, beside a static one: no two of them share what is between."""
    body = scenes.soup(np.random.default_rng(7), 12, 0.2, spread=0.5)
    one = ccd.CollisionMesh.from_arrays([body, scenes.sheet(3)], static=[1], self_collision=False)
    mesh = one.replicate(3)
    check((mesh, mesh.vertices, mesh.vertices), interleaved, ["displacement_bounds", "mesh_ccd"])


def in_the_plane():
    """Cables, particles and a half-plane: positions, points and normals have two coordinates."""
    rng = np.random.default_rng(8)
    k = np.arange(24)
    cable = np.stack([k / 24, 0.5 + 0.05 * np.sin(k)], axis=1), np.stack([k[:-1], k[1:]], axis=1)
    particles = rng.random((16, 2)) * [1, 0.4], np.zeros((0, 2), dtype=int)
    static = [1.0, 0.3] + rng.random((12, 2)), rng.permutation(12).reshape(-1, 2)
    bodies = [cable, ccd.HalfSpace([0.0, -0.1], [0.1, 1.0]), particles, static]
    for radius, num_worlds in ((None, 1), ([0.01, 0.0, 0.02, 0.0], 2)):
        world = np.repeat([0, num_worlds - 1, 0], [24, 16, 12])
        mesh = ccd.CollisionMesh.from_arrays(bodies, static=[3], radius=radius, vertex_world=world)
        end = mesh.vertices + 0.3 * rng.standard_normal(mesh.vertices.shape) * (mesh.vertex_body != 3)[:, None]
        calls = [*ALL_CALLS, "line_search vertex", "displacement_bounds", "find_proximity", "find_intersections"]
        check((mesh, mesh.vertices, end), interleaved, calls[:: 1 if radius is None else 2])
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[3], rigid=[0, 2])
    twist = [[0.1, -0.2, 0, 0, 0, 1.1], [0.2, 0, 0, 0, 0, -0.5]]
    motion = ccd.RigidMotion([[0, 0.1, 0, 0, 0, 0, 1], [0.1, 0, 0, 0, 0, 0.2, 0.9]], twist=twist)
    calls = [*ALL_CALLS, "line_search vertex"]
    check((mesh, mesh.vertices, mesh.vertices), interleaved, calls, motion=motion)
    lattice = np.round(4 * end) / 4  # edges that cross, vertices on edges, points in one place and in the half-plane
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[3], codimensional_points=True)
    check((mesh, lattice, lattice), interleaved, ["find_intersections"])
    kinds = np.unique(ccd.find_intersections(mesh, lattice).kind).tolist()
    assert kinds == [1, 2, 3, 5], kinds
    # what a rank without vertices has may be an empty list
    from ccd_warp.distributed import DistributedMesh, DistributedPipeline

    x, y, edges = (cable[0], end[:24], cable[1]) if RANK == SIZE - 1 else ([], [], None)
    whole = DistributedMesh(COMM, x, vertex_ids=np.arange(len(x)), edges=edges)
    one = ccd.CollisionMesh.from_arrays([cable])
    assert (whole.dimension, whole.num_edges) == (2, 23)
    assert DistributedPipeline(whole).mesh_ccd(x, y).toi == ccd.mesh_ccd(one, cable[0], end[:24]).toi < 1.0


def coordinates_at_the_ends_of_float64():
    """Scenes that are small beside the least scale of quantized coordinates, far beyond their origin, and without end.

    What is equal in quantized coordinates is then far apart beside the size of the scene.
    """
    start, faces = scenes.soup(np.random.default_rng(6), 20, 0.1)
    for scale, shift in ((1e-318, 1e-305), (1e295, 1.5e308), (1.7e308, 0.0)):
        x = np.clip(2.0 * start - 1.0, -1.0, 1.0) * scale + shift
        options = {"length_scale": min(1e4 * scale, 1e308), "minimum_distance": 1e-3 * scale}
        check((scenes.single(x, faces), x, x), interleaved, ["mesh_ccd", "find_intersections"], **options)


def bound_from_a_sample():
    """A large mesh is sampled first, by primitives that are the same wherever they are; here a small one is.

    The bound cuts off what comes later, also a solution that a limit has left too early, so it must be the same bound.
    """
    vertices, faces = scenes.sheet(20)
    rng = np.random.default_rng(4)
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces), (vertices + [0, 0, 0.3] + 0.003 * rng.random(3), faces)])
    end = (
        mesh.vertices + (0.02 * rng.standard_normal(mesh.vertices.shape) - [0, 0, 1]) * (mesh.vertex_body == 1)[:, None]
    )
    with mock.patch.object(topology, "WORTH_SAMPLING", 1):
        for options in (
            {"max_iterations": 1},
            {"method": "bisection", "max_iterations": 300},
            {"precision": "float32"},
        ):
            check((mesh, mesh.vertices, end), interleaved, ["collision_free_step"], **options)
        options = {"broad_phase": "hash", "max_iterations": 1}
        check((mesh, mesh.vertices, end), interleaved, ["collision_free_step", "is_step_collision_free"], **options)


def many_steps():
    """A plan is kept while boxes stay in it, made anew when they leave it, and static bodies may be moved."""
    mesh, start, _ = scenes.sheet_over_ball()
    mesh = whole_mesh(mesh)
    cut = Cut(COMM, mesh, in_blocks(mesh), np.random.default_rng(RANK))
    from ccd_warp.distributed import DistributedPipeline

    pipeline, one = DistributedPipeline(cut.mesh), ccd.CollisionPipeline(mesh)
    x, velocity = start, [0, 0, -0.02] * (mesh.vertex_body == 0)[:, None]
    num_plans = 0
    for k in range(12):
        if k == 6:
            x = x + [0.001, 0, 0] * (mesh.vertex_body == 1)[:, None]
        if k == 9:
            x = x + [5.0, 0, 0]
        compare_call(COMM, cut, pipeline, one, x, x + velocity, "mesh_ccd")
        num_plans += pipeline.work.is_planned
        x = x + velocity
    assert 2 <= num_plans <= 8, num_plans


def one_rank_more_work_than_the_others():
    """A crumpled part takes most of the work: the plan is made anew, with smaller regions there."""
    if SIZE == 1:
        return  # there are no others
    rng = np.random.default_rng(2)
    calm, faces = scenes.sheet(20)
    crumpled = calm + 0.1 * rng.random(calm.shape) + [2.0, 0, 0]
    mesh = whole_mesh(ccd.CollisionMesh.from_arrays([(calm, faces), (crumpled, faces)]))
    end = mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape) * (mesh.vertex_body == 1)[:, None]
    cut = Cut(COMM, mesh, in_blocks(mesh), np.random.default_rng(RANK))
    from ccd_warp.distributed import DistributedPipeline

    pipeline, one = DistributedPipeline(cut.mesh), ccd.CollisionPipeline(mesh)
    seen = []
    for _ in range(5):
        compare_call(COMM, cut, pipeline, one, mesh.vertices, end, "mesh_ccd")
        seen.append((pipeline.work.imbalance, pipeline.work.is_planned))
    assert seen[0][0] > 1.3 and seen[1][1] and not seen[4][1], seen
    assert seen[4][0] < 0.9 * seen[0][0], seen


CASES = [
    cloth_over_sphere,
    static_floor_and_owners_that_are_given,
    pile,
    bodies_that_ignore_themselves,
    worlds,
    giant_face,
    all_faces_on_the_last_rank,
    one_triangle_falls_on_another,
    nothing_at_all,
    cables_particles_and_rings,
    vertices_that_take_no_part,
    starts_that_are_not_sound,
    starts_of_a_loop,
    options,
    work_that_open_pairs_share,
    radii,
    half_spaces,
    kinematic_bodies,
    what_starts_within_its_distance,
    bodies_that_turn,
    bar_that_sweeps_the_regions_of_all_ranks,
    spheres_that_roll_on_each_other,
    planes_and_nothing_else,
    copies_of_a_body_that_moves_alone,
    in_the_plane,
    random_scenes,
    coordinates_at_the_ends_of_float64,
    bound_from_a_sample,
    many_steps,
    one_rank_more_work_than_the_others,
]


# Says something of the benchmarks, whose simulation it runs.
LONG = [bar_that_sweeps_the_regions_of_all_ranks, spheres_that_roll_on_each_other]


def main(names):
    for case in CASES:
        if case.__name__ in names or names == ["--every"] or (not names and case not in LONG):
            begin = time.perf_counter()
            case()
            if RANK == 0:
                print(f"{case.__name__}: the bits of one process, {time.perf_counter() - begin:.1f} s", flush=True)
    if RANK == 0 and names in ([], ["--every"]):
        print(f"all {len(CASES) - (0 if names else len(LONG))} cases")


if __name__ == "__main__":
    warnings.simplefilter("error")
    main(sys.argv[1:])
