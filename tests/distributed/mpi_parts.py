"""Meshes cut over ranks, the one process that they are compared with, and the comparison."""

import time

import numpy as np
from laws.calls import SCALARS, on_host
from laws.outputs import different

import ccd_warp as ccd
from ccd_warp._results.pairs import PairTable, bodies_of, vertices_of
from ccd_warp.distributed import DistributedMesh

# Of each result: what each rank has of its own vertices, what all have, and the lists of which each has some rows.
_LOCAL = {"mesh_ccd": ["vertex_toi"], "line_search": ["vertices", "vertex_fraction"]}
_SAME = {"mesh_ccd": ["toi", "body_toi", "world_toi"], "line_search": ["fraction", "num_rounds", "is_limited"]}
_LISTS = {"mesh_ccd": ["contacts"], "line_search": ["touching", "struck", "shortened_by"]}
# The columns of tables of pairs, besides those that all have.
_COLUMNS = {
    ccd.Contacts: ("toi", "parameters", "normal", "points", "status", "gap", "width"),
    ccd.Proximities: ("parameters", "distance", "direction", "features"),
    ccd.Intersections: ("parameters", "edge_parameter", "points", "world"),
}
_KEPT = (
    "vertices body_vertex_range static kinematic rigid self_collision body_pairs exclusion_rings vertex_world names "
)
_KEPT += "radius planes"


def whole_mesh(mesh):
    """The same mesh with faces in the order in which ranks number them, each once, and the lists that they take."""
    faces = mesh.faces.astype(np.int64)
    ordered = np.sort(faces, axis=1)
    order = np.lexsort((*faces.T[::-1], *ordered.T[::-1]))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (ordered[order][1:] != ordered[order][:-1]).any(axis=1)
    return ccd.CollisionMesh._of_parts(
        faces=mesh.faces[order[is_first]],
        listed_edges=mesh.edges[mesh.codimensional_edges],
        with_codimensional_points=_has(mesh, mesh.codimensional_points),
        with_inner_vertices=_has(mesh, mesh.inner_vertices),
        exclude_pairs={name: pairs for name, pairs in mesh.exclude_pairs.items() if name in ("vertices", "bodies")},
        **{name: getattr(mesh, name) for name in _KEPT.split()},
    )


def _has(mesh, vertices):
    """Which bodies have some of the vertices."""
    return np.isin(np.arange(mesh.num_bodies), mesh.vertex_body[vertices])


class Cut:
    """The part of a mesh on one rank: the faces that are given to it, and the vertices that they use.

    Vertices in no face go to the rank of their index; codimensional edges to that of their first vertex. ``ids`` are
    twice the indices and five more, so that a number is never an id.
    """

    def __init__(self, comm, mesh, rank_of_face, rng, with_owners=False):
        rank, size = comm.Get_rank(), comm.Get_size()
        faces = mesh.faces[rank_of_face == rank]
        # faces of another rank, too, with their corners in the last order: they count once, as the first has them
        others = mesh.faces[rng.random(len(mesh.faces)) < 0.05 * (rank + 1)]
        faces = np.concatenate([faces, np.sort(others, axis=1)[:, ::-1]])
        edges = mesh.edges[mesh.codimensional_edges]
        edges = edges[edges[:, 0] % size == rank]
        if len(faces):  # also some that faces have, perhaps of another rank, and which are none of their own then
            edges = np.concatenate([edges, mesh.edges[rng.random(len(mesh.edges)) < 0.02]])
        is_used = ~np.isin(np.arange(mesh.num_vertices), mesh.faces) & (np.arange(mesh.num_vertices) % size == rank)
        is_used[faces], is_used[edges] = True, True
        self.rows = rng.permutation(np.flatnonzero(is_used))
        place = np.full(mesh.num_vertices, -1)
        place[self.rows] = np.arange(len(self.rows))
        owned = None
        if with_owners:  # the highest rank that has it
            owned = (size - 1 - np.argmax(np.stack(comm.allgather(is_used))[::-1], axis=0))[self.rows] == rank
        planes = zip(mesh.planes.bodies, mesh.planes.points, mesh.planes.normals, strict=True)
        self.mesh = DistributedMesh(
            comm,
            mesh.vertices[self.rows],
            place[faces],
            vertex_ids=2 * self.rows + 5,
            edges=place[edges],
            bodies=mesh.vertex_body[self.rows],
            static=np.setdiff1d(np.flatnonzero(mesh.static), mesh.planes.bodies).tolist(),
            kinematic=np.flatnonzero(mesh.kinematic).tolist(),
            self_collision=mesh.self_collision,
            codimensional_points=_has(mesh, mesh.codimensional_points),
            body_pairs=mesh.body_pairs,
            exclude_pairs={
                name: 2 * pairs.astype(np.int64) + 5 if name == "vertices" else pairs
                for name, pairs in mesh.exclude_pairs.items()
            },
            vertex_world=mesh.vertex_world[self.rows],
            radius=None if mesh.radius is None else mesh.radius[self.rows],
            owned=owned,
            half_spaces={int(b): ccd.HalfSpace(point, normal) for b, point, normal in planes},
        )

    def local(self, positions):
        """Positions of the vertices on this rank; those of ghosts are spoiled, as they are not to be read."""
        values = positions[self.rows].copy()
        ghosts = np.flatnonzero(~self.mesh.is_owned)
        values[ghosts] = np.resize([np.nan, 0.0, np.inf, -1e308], len(ghosts))[:, None]
        return values


def wait_for_all(comm):
    """A barrier at which ranks sleep: elsewhere MPI asks all the time, on cores that the others need."""
    request, pause = comm.Ibarrier(), 5e-5
    while not request.Test():
        time.sleep(pause)
        pause = min(1.2 * pause, 2e-3)


def compare_call(comm, cut, pipeline, one, start, end, call):
    """Make one call on all ranks and in one process, and compare every bit."""
    name = call.split()[0]
    distance, is_root = 0.05 * cut.mesh.length_scale, comm.Get_rank() == 0
    found = on_host(call, pipeline, cut.local(start), cut.local(end), distance)
    expected = on_host(call, one, start, end, distance) if is_root else None
    wait_for_all(comm)
    expected = comm.bcast(expected)
    ours, theirs, lists = {}, {}, [(name, found, expected)] * hasattr(found, "to_root")
    if name in (*SCALARS, "displacement_bounds"):
        ours[name], theirs[name] = found, expected if name in SCALARS else expected[cut.rows]
    for key in _LOCAL.get(name, []) + _SAME.get(name, []):
        ours[key], value = getattr(found, key), getattr(expected, key)
        theirs[key] = value[cut.rows] if key in _LOCAL[name] else value
    lists += [(key, getattr(found, key), getattr(expected, key)) for key in _LISTS.get(name, [])]
    for key, part, whole in lists:
        part = part.to_root()
        if is_root:
            ours |= {f"{key}.{column}": values for column, values in part.columns.items()}
            theirs |= {f"{key}.{column}": values for column, values in _by_ids(whole, one.mesh).items()}
            assert part.total == len(part), key
    assert different(*({k: np.asarray(v) for k, v in each.items()} for each in (ours, theirs))) == [], call
    wait_for_all(comm)


def _by_ids(pairs, mesh):
    """The columns of what one process has found, with ids in place of rows, in their order."""
    if isinstance(pairs, ccd.Candidates):
        lists = [getattr(pairs, kind.name.lower()) for kind in ccd.PairKind]
        kind = np.repeat(np.array(ccd.PairKind, dtype=np.int32), [len(found) for found in lists])
        pairs = PairTable(kind, np.concatenate(lists))
        vertices = vertices_of(mesh, ccd.PairKind, kind, pairs.primitives)
        columns = {"kind": kind, "bodies": bodies_of(mesh, ccd.PairKind, kind, pairs.primitives, vertices)}
    else:
        columns = {name: getattr(pairs, name) for name in ("kind", "bodies", *_COLUMNS[type(pairs)])}
        vertices = pairs.vertices
    columns["vertices"] = 2 * vertices.astype(np.int64) + 5
    order = np.lexsort((*columns["bodies"].T, *columns["vertices"].T[::-1], columns["kind"]))
    return {name: values[order] for name, values in columns.items()}
