"""Meshes cut over ranks, the one process that they are compared with, and the comparison."""

import time

import numpy as np

import ccd_warp as ccd
from ccd_warp.distributed import DistributedMesh, DistributedPipeline

FIELDS = ("kind", "primitives", "toi", "parameters", "normal", "status", "gap", "width", "points", "vertices", "bodies")

PROXIMITY_FIELDS = ("kind", "primitives", "parameters", "distance", "direction", "features", "vertices")
INTERSECTION_FIELDS = (
    "kind",
    "primitives",
    "parameters",
    "edge_parameter",
    "points",
    "vertices",
    "bodies",
    "world",
    "is_crossing",
)


def whole_mesh(mesh):
    """The same mesh with faces in the order in which the ranks number them, each once."""
    faces = mesh.faces.astype(np.int64)
    ordered = np.sort(faces, axis=1)
    order = np.lexsort((*faces.T[::-1], *ordered.T[::-1]))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (ordered[order][1:] != ordered[order][:-1]).any(axis=1)
    with_points = np.zeros(mesh.num_bodies, dtype=bool)
    with_points[mesh.vertex_body[mesh.codimensional_points]] = True
    with_inner = np.zeros(mesh.num_bodies, dtype=bool)
    with_inner[mesh.vertex_body[mesh.inner_vertices]] = True
    state = {name: getattr(mesh, name) for name in ("vertices", "body_vertex_range", "static", "kinematic", "rigid")}
    state |= {
        name: getattr(mesh, name)
        for name in ("self_collision", "body_pairs", "exclusion_rings", "vertex_world", "names", "radius", "planes")
    }
    return ccd.CollisionMesh(
        faces=mesh.faces[order[is_first]],
        given_edges=mesh.edges[mesh.codimensional_edges],
        with_codimensional_points=with_points,
        with_inner_vertices=with_inner,
        exclude_pairs=mesh.exclude_pairs,
        **state,
    )


class Cut:
    """The part of a mesh on one rank: the faces that are given to it, and the vertices that they use.

    Vertices in no face go to the rank of their index; codimensional edges to that of their first vertex. ``ids`` are
    twice the indices and five more, so that a number is never an id.
    """

    def __init__(self, comm, mesh, rank_of_face, rng, with_owners=False):
        rank, size = comm.Get_rank(), comm.Get_size()
        faces = mesh.faces[rank_of_face == rank]
        # a face of another rank, too, with its corners in another order: it counts once, as the first has it
        faces = np.concatenate([faces, mesh.faces[rng.random(len(mesh.faces)) < 0.05 * (rank + 1)]])
        edges = mesh.edges[mesh.codimensional_edges]
        edges = edges[edges[:, 0] % size == rank]
        is_used = np.zeros(mesh.num_vertices, dtype=bool)
        is_in_face = np.zeros(mesh.num_vertices, dtype=bool)
        is_in_face[mesh.faces] = True
        is_used[faces], is_used[edges] = True, True
        is_used[~is_in_face & (np.arange(mesh.num_vertices) % size == rank)] = True
        self.rows = rng.permutation(np.flatnonzero(is_used))
        place = np.full(mesh.num_vertices, -1)
        place[self.rows] = np.arange(len(self.rows))
        with_points = np.zeros(mesh.num_bodies, dtype=bool)
        with_points[mesh.vertex_body[mesh.codimensional_points]] = True
        owned = None
        if with_owners:
            holders = np.stack(comm.allgather(is_used))
            owner = size - 1 - np.argmax(holders[::-1], axis=0)  # the highest rank that has it
            owned = owner[self.rows] == rank
        self.mesh = DistributedMesh(
            comm,
            mesh.vertices[self.rows],
            place[faces],
            vertex_ids=2 * self.rows + 5,
            edges=place[edges],
            bodies=mesh.vertex_body[self.rows],
            static=np.setdiff1d(np.flatnonzero(mesh.static), mesh.planes.bodies).tolist(),
            kinematic=np.flatnonzero(mesh.kinematic).tolist(),
            rigid=np.flatnonzero(mesh.rigid).tolist(),
            self_collision=mesh.self_collision,
            codimensional_points=with_points,
            body_pairs=mesh.body_pairs,
            exclusion_rings=mesh.exclusion_rings,
            exclude_pairs={
                key: 2 * pairs.astype(np.int64) + 5 if key == "vertices" else pairs
                for key, pairs in mesh.exclude_pairs.items()
            },
            vertex_world=mesh.vertex_world[self.rows],
            radius=None if mesh.radius is None else mesh.radius[self.rows],
            owned=owned,
            half_spaces={
                int(b): ccd.HalfSpace(point, normal)
                for b, point, normal in zip(mesh.planes.bodies, mesh.planes.points, mesh.planes.normals, strict=True)
            },
        )

    def local(self, positions):
        """Positions of the vertices on this rank; those of ghosts are spoiled, as they are not to be read."""
        values = positions[self.rows].copy()
        ghosts = np.flatnonzero(~self.mesh.is_owned)
        values[ghosts] = np.resize([np.nan, 0.0, np.inf, -1e308], len(ghosts))[:, None]
        return values


def assert_same_bits(name, found, expected):
    found, expected = np.ascontiguousarray(found), np.ascontiguousarray(expected)
    assert found.shape == expected.shape, f"{name}: {found.shape} in place of {expected.shape}"
    if found.dtype.kind == "f":
        found, expected = found.view(np.int64), expected.view(np.int64)
    differs = np.flatnonzero((found != expected).any(axis=tuple(range(1, found.ndim))))
    assert len(differs) == 0, f"{name} differs in {len(differs)} of {len(found)}, first at {differs[0]}"


def compare(comm, cut, mesh, start, end, calls, options, motion=None):
    """Make the calls on all ranks and in one process, and compare; returns the pipeline of the ranks."""
    start, end = (np.asarray(x).reshape(-1, mesh.dimension) for x in (start, end))
    pipeline = DistributedPipeline(cut.mesh, **options)
    one = ccd.CollisionPipeline(mesh, **options)
    for call in calls:
        compare_call(comm, cut, pipeline, one, start, end, call, motion)
    return pipeline


def wait_for_all(comm):
    """A barrier at which ranks sleep: elsewhere MPI asks all the time, on cores that the others need."""
    request = comm.Ibarrier()
    while not request.Test():
        time.sleep(1e-3)


def compare_call(comm, cut, pipeline, one, start, end, call, motion=None):
    """Make one call on all ranks and in one process, and compare."""
    moves = {} if motion is None else {"motion": motion}
    is_root = comm.Get_rank() == 0

    def of_root(make):
        """What rank 0 makes in one process."""
        made = make() if is_root else None
        wait_for_all(comm)
        return comm.bcast(made)

    here = cut.local(start), cut.local(end)
    if call == "mesh_ccd":
        found = pipeline.mesh_ccd(*here, **moves)
        every = found.contacts.to_root()
        expected = of_root(lambda: one.mesh_ccd(start, end, **moves))
        assert found.toi == expected.toi, f"toi {found.toi} in place of {expected.toi}"
        assert_same_bits("vertex_toi", found.vertex_toi, expected.vertex_toi[cut.rows])
        assert_same_bits("body_toi", found.body_toi, expected.body_toi)
        assert_same_bits("world_toi", found.world_toi, expected.world_toi)
        assert found.num_contacts == len(expected.contacts)
        if is_root:
            compare_contacts(every, expected.contacts)
    elif call == "find_candidates":
        every = pipeline.find_candidates(*here, 0.01, **moves).to_root()
        if is_root:
            for name, pairs in vars(one.find_candidates(start, end, 0.01, **moves).sorted()).items():
                assert_same_bits(name, getattr(every, name), pairs)
    elif call == "find_proximity":
        distance = 0.05 * cut.mesh.length_scale
        every = pipeline.find_proximity(here[0], distance).to_root()
        if is_root:
            compare_pairs(every, one.find_proximity(start, distance), PROXIMITY_FIELDS)
    elif call == "displacement_bounds":
        distance = 0.1 * cut.mesh.length_scale
        found = pipeline.displacement_bounds(here[0], distance)
        expected = of_root(lambda: one.displacement_bounds(start, distance))
        assert_same_bits("bounds", found, expected[cut.rows])
        assert len(np.unique(expected)) > 3  # some tell of what is near
    elif call == "find_intersections":
        found = pipeline.find_intersections(here[0])
        every = found.to_root()
        num_crossing = comm.allreduce(found.num_crossing)
        if is_root:
            expected = one.find_intersections(start)
            compare_pairs(every, expected, INTERSECTION_FIELDS)
            assert found.num_intersections == every.num_intersections == len(expected)
            assert (num_crossing, every.num_touching) == (expected.num_crossing, expected.num_touching)
    elif call.startswith("line_search"):
        found = pipeline.line_search(*here, per=call.partition(" ")[2], **moves)
        expected = of_root(lambda: one.line_search(start, end, per=call.partition(" ")[2], **moves))
        assert_same_bits("vertices", found.vertices, expected.vertices[cut.rows])
        assert_same_bits("vertex_fraction", found.vertex_fraction, expected.vertex_fraction[cut.rows])
        assert (found.fraction, found.num_rounds) == (expected.fraction, expected.num_rounds)
        assert found.is_limited == expected.is_limited
        if motion is not None:
            assert_same_bits("poses", found.motion.poses_t1, expected.motion.poses_t1)
        for name in ("touching", "struck"):
            every = getattr(found, name).to_root()
            if is_root:
                compare_contacts(every, getattr(expected, name))
    else:
        found = getattr(pipeline, call)(*here, **moves)
        expected = of_root(lambda: getattr(one, call)(start, end, **moves))
        assert found == expected, f"{call} is {found} in place of {expected}"
    wait_for_all(comm)


def compare_contacts(found, expected):
    compare_pairs(found, expected, FIELDS)


def compare_pairs(found, expected, names):
    for name in names:
        values = getattr(expected, name)
        if name == "vertices":
            values = 2 * values.astype(np.int64) + 5
        assert_same_bits(name, getattr(found, name), values.astype(getattr(found, name).dtype))
