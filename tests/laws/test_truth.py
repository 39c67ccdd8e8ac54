"""What a step finds in a drawn scene is what exact arithmetic over all pairs finds: none missed, late or too early."""

import numpy as np
import pytest

import ccd_warp as ccd
from laws.asked import SEEDS, kinds_of, near_pairs, scene_of
from laws.outputs import tois_of
from laws.touches import check_first, check_unique
from laws.truth import (
    NAMES,
    PLANE,
    UNITS,
    PlaneTruth,
    check_sides,
    distances_at,
    first_times,
    halfway,
    plane_moves,
    sizes,
)

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

STATUS = ccd.CCDStatus
LIMITS = [STATUS.ITERATION_LIMIT, STATUS.RESOLUTION_LIMIT, STATUS.ROUNDING_LIMIT]
INFINITY = np.inf


def exact_contacts(scene, start, end, pairs, t_max):
    """The exact time of each pair of two primitives that comes within its distance: (kind, first, second) to time."""
    found = {}
    is_reduced = isinstance(scene.options["start_gap_fraction"], float)
    for kind, of_kind, corners, distances in near_pairs(scene, start, end, pairs):
        if is_reduced:  # to at most a fraction, which rounding makes less
            distances = np.maximum(0.999 * distances - 2.0**-16 * sizes(start[corners], end[corners]), 0.0)
        if len(corners):
            times = first_times(NAMES[kind], start[corners], end[corners], distances, scene.is_euclidean, t_max)
            found |= {(kind, *pair): time for pair, time in zip(of_kind.tolist(), times, strict=True) if time.hit}
    return found


def check_gaps(scene, start, end, pairs, contacts, unit):
    """At its toi the gap of a contact is no more than its distance, the tolerance and rounding, and as it is told."""
    fraction = scene.options["start_gap_fraction"]
    for kind in range(4):
        chosen = contacts[(contacts.kind == kind) & ~np.isin(contacts.status, LIMITS)]
        if not len(chosen):
            continue
        corners = pairs.corners(kind, chosen.primitives)
        x, y, distances = start[corners], end[corners], scene.distance + pairs.radii(kind, chosen.primitives)
        is_euclidean = scene.is_euclidean and bool(distances.any())
        gaps = distances_at(NAMES[kind], x, y, chosen.toi, is_euclidean)
        if isinstance(fraction, float):
            at_start = distances_at(NAMES[kind], x, y, np.zeros(len(x)), is_euclidean)
            distances = np.minimum(distances, fraction * at_start)
        rounding = 128 * unit * sizes(x, y)
        assert (gaps <= distances + scene.delta + rounding).all()
        if not isinstance(fraction, float):
            assert (gaps <= distances + chosen.gap + 1e-15 * sizes(x, y)).all()
        assert (chosen.gap <= scene.delta + rounding).all()


def check_normals(touches, corners, lost):
    """The normal where there is no gap is across two sides of the face, or both edges, unless these are parallel."""
    ends = np.where(touches.kind[:, None] == 0, [2, 1, 3, 1], [1, 0, 3, 2])
    p = np.take_along_axis(corners, ends[..., None], axis=1)
    sides = np.stack([p[:, 0] - p[:, 1], p[:, 2] - p[:, 3]], axis=1)
    lengths = np.linalg.norm(sides, axis=2)
    is_regular = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) > 1e-3 * lengths.prod(axis=1)
    across = np.abs(np.einsum("md,msd->ms", touches.normal, sides))
    assert (across <= 1e-9 * lengths + lost)[is_regular].all()


def check_places(scene, mesh, start, end, contacts, unit):
    """The normal of a contact is along the gap between its primitives, its point halfway between their surfaces."""
    of_pairs, limit = contacts[contacts.kind != PLANE], np.abs([start, end]).max(initial=0.0) * 2.0**-44
    x, y, t = start[of_pairs.vertices], end[of_pairs.vertices], of_pairs.toi[:, None, None]
    at_toi = (1 - t) * x + t * y
    gap = np.einsum("mk,mkd->md", of_pairs.weights, at_toi)
    velocity = np.einsum("mk,mkd->md", contacts.weights, (end - start)[contacts.vertices])
    velocity -= plane_moves(contacts, mesh, start, end)
    assert np.abs(velocity - contacts.relative_velocity).max(initial=0.0) <= limit
    length = np.linalg.norm(gap, axis=1, keepdims=True)
    # what is within the tolerance along each axis has the normal of its motion
    is_clear = length[:, 0] > 2 * scene.delta + 2**14 * unit * sizes(x, y) + limit
    assert np.abs(gap - length * of_pairs.normal)[is_clear].max(initial=0.0) <= 4 * limit
    along = np.einsum("md,md->m", of_pairs.normal, velocity[contacts.kind != PLANE])
    assert (along[length[:, 0] == 0] <= limit).all()  # where there is no gap, the normal is against the velocity
    if mesh.dimension == 3:
        touches = (length[:, 0] <= limit / 16) & (of_pairs.kind <= int(ccd.PairKind.EDGE_EDGE))
        check_normals(of_pairs[touches], at_toi[touches], limit)
    lengths = np.linalg.norm(contacts.normal, axis=1)
    assert np.all((np.abs(lengths - 1) < 1e-12) | (lengths == 0))
    assert np.abs(halfway(of_pairs, mesh, at_toi) - of_pairs.points).max(initial=0.0) <= limit


def check_planes(scene, mesh, start, end, pairs, found):
    """Vertices meet planes in time, and no earlier than roundings explain."""
    if PLANE not in kinds_of(scene):
        return
    fraction, t_max = scene.options["start_gap_fraction"], scene.options["t_max"]
    distances = scene.distance + pairs.radii(PLANE, pairs.with_planes)
    for (v, k), distance in zip(pairs.with_planes.tolist(), distances.tolist(), strict=True):
        truth, toi = PlaneTruth(mesh, start, end, v, k), found.get((int(PLANE), v, k), INFINITY)
        if isinstance(fraction, float):
            distance = min(distance, fraction * max(float(truth.f[0]), 0.0) / truth.length(scene.is_euclidean))
        assert not truth.is_late(toi, distance * (1 - 1e-9), scene.is_euclidean, t_max), (v, k)
        assert toi == INFINITY or not truth.is_early(toi, distance), (v, k)


def check_minima(mesh, result, pairs):
    """The least toi of each vertex, body and world, and which contact has it."""
    contacts = result.contacts
    rows = np.column_stack([contacts.kind, contacts.primitives])
    assert np.array_equal(rows, np.unique(rows, axis=0))
    vertex, body = np.full(mesh.num_vertices, INFINITY), np.full(mesh.num_bodies, INFINITY)
    of_vertex, of_body = np.full(len(vertex), -1), np.full(len(body), -1)
    world = np.full(mesh.num_worlds, INFINITY)
    for n, ((kind, *pair), toi) in enumerate(zip(rows.tolist(), contacts.toi.tolist(), strict=True)):
        corners = {*pairs.corners(kind, np.array(pair))[0].tolist()}
        touched = {int(mesh.vertex_body[v]) for v in corners}
        if kind == PLANE:
            touched.add(int(mesh.planes.bodies[pair[1]]))
        for table, first, indices in ((vertex, of_vertex, corners), (body, of_body, touched)):
            for i in indices:
                if toi < table[i]:
                    table[i], first[i] = toi, n
        k = mesh.vertex_world[min(pairs.corners(kind, np.array(pair))[0])]
        world[k] = min(world[k], toi)
    for found, expected in (
        (result.vertex_toi, vertex),
        (result.body_toi, body),
        (result.world_toi, world),
        (result.vertex_contact, of_vertex),
        (result.body_contact, of_body),
    ):
        np.testing.assert_array_equal(found, expected)
    assert result.toi == contacts.toi.min(initial=INFINITY)
    check_counts(mesh, result)


def check_counts(mesh, result):
    """What was counted of the scene and of the contacts; static bodies, and those that touch others, are active."""
    counts, contacts = result.counts, result.contacts
    of_kinds = [counts.num_contacts.get(kind, 0) for kind in ccd.PairKind]
    assert of_kinds == np.bincount(contacts.kind, minlength=5).tolist()
    assert counts.num_contacts_at_start == (contacts.status == STATUS.INITIAL_CONTACT).sum()
    assert counts.num_contacts_at_limit == np.isin(contacts.status, LIMITS).sum()
    for name in ("bodies", "vertices", "edges", "faces"):
        assert getattr(counts, f"num_{name}") == getattr(mesh, f"num_{name}")
    of_mesh = mesh.codimensional_edges, mesh.codimensional_points
    assert [counts.num_codimensional_edges, counts.num_codimensional_points] == [*map(len, of_mesh)]
    active = {*np.flatnonzero(mesh.static), *contacts.bodies[contacts.kind != PLANE].ravel()}
    assert len(active) <= counts.num_active_bodies <= mesh.num_bodies


@pytest.mark.parametrize("seed", SEEDS)
def test_contacts_of_a_step(seed, precision):
    scene, mesh, start, end, pairs = scene_of(seed)
    result = ccd.mesh_ccd(mesh, start, end, precision=precision, **scene.options)
    contacts = result.contacts
    found, truth = tois_of(contacts), exact_contacts(scene, start, end, pairs, scene.options["t_max"])
    assert truth.keys() <= found.keys()
    assert not [key for key, time in truth.items() if time.late(found[key])]
    of_kinds = [*pairs.of_kinds, pairs.with_planes]
    assert found.keys() <= {(int(kind), *pair) for kind in kinds_of(scene) for pair in of_kinds[kind].tolist()}
    assert ((contacts.toi >= 0) & (contacts.toi <= scene.options["t_max"])).all()
    at_start = np.isin(contacts.status, [STATUS.INITIAL_CONTACT, STATUS.ROUNDING_LIMIT])
    assert (at_start <= (contacts.toi == 0)).all()
    check_gaps(scene, start, end, pairs, contacts, UNITS[precision])
    check_sides(contacts, pairs)
    check_places(scene, mesh, start, end, contacts, UNITS[precision])
    check_planes(scene, mesh, start, end, pairs, found)
    check_minima(mesh, result, pairs)
    tolerance = 0.0 if contacts._place.touch is None else scene.delta  # which is not told where some start near
    check_unique(mesh, contacts, start, end, tolerance)
    check_first(result)
    is_free = ccd.is_step_collision_free(mesh, start, end, precision=precision, **scene.options)
    assert is_free == (result.toi == INFINITY)
    step = ccd.collision_free_step(mesh, start, end, precision=precision, **scene.options)
    least = min(result.toi, scene.options["t_max"])
    assert step == least or (scene.options["start_gap_fraction"] == "hold" and step > least)


def test_radii_written_on_the_device_are_those_of_the_next_launch():
    for scene, mesh, start, end, _ in map(scene_of, SEEDS):
        if mesh.radius is not None:
            pipeline = scene.pipeline(mesh, "float64")
            for radius in (0.0 * mesh.radius, mesh.radius):
                pipeline.radius.assign(radius)
                found = pipeline.launch(start, end).vertex_toi.numpy().copy()
            np.testing.assert_array_equal(found, ccd.mesh_ccd(mesh, start, end, **scene.options).vertex_toi)
