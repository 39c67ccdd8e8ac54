"""What is asked in other units, of bodies in another order, for a larger distance or a shorter step answers alike."""

import numpy as np
import pytest
from expected_warnings import OF_ROUNDING

import ccd_warp as ccd
from laws.calls import PRECISIONS
from laws.outputs import different, outputs_of, tois_of
from laws.scenes import drawn

pytestmark = [OF_ROUNDING, pytest.mark.filterwarnings("ignore:the distance|motion is None:RuntimeWarning")]
# Results that are lengths; the others have no unit.
LENGTHS = ("gap", "points", "distance", "bounds")
every_scene = pytest.mark.parametrize("seed", [*range(40), 9031, 9157])  # in these gaps are in doubt


def remade(mesh, order, scale=1.0, **changed):
    """The mesh with its bodies in another order and of another size, and where its vertices were."""
    bodies, rows, spaces = [], [], dict(zip(mesh.planes.bodies.tolist(), range(len(mesh.planes)), strict=True))
    for b in order:
        first, end = mesh.body_vertex_range[b : b + 2]
        rows += range(first, end)
        if b in spaces:
            bodies.append(ccd.HalfSpace(scale * mesh.planes.points[spaces[b]], mesh.planes.normals[spaces[b]]))
            continue
        edges = mesh.codimensional_edges[mesh.edge_body[mesh.codimensional_edges] == b]
        faces = [mesh.faces[mesh.face_body == b] - first] * (mesh.dimension == 3)
        bodies.append((scale * mesh.vertices[first:end], *faces, mesh.edges[edges] - first))
    of_points = np.isin(np.arange(mesh.num_bodies), mesh.vertex_body[mesh.codimensional_points])
    chosen = {name: np.flatnonzero(getattr(mesh, name)[order]).tolist() for name in ("kinematic", "rigid")}
    chosen["static"] = [k for k, b in enumerate(order) if mesh.static[b] and b not in spaces]
    return ccd.CollisionMesh.from_arrays(
        bodies,
        codimensional_points=of_points[order],
        self_collision=mesh.self_collision[order],
        body_pairs=None if mesh.body_pairs is None else mesh.body_pairs[np.ix_(order, order)],
        exclusion_rings=mesh.exclusion_rings,
        vertex_world=mesh.vertex_world[rows],
        radius=None if mesh.radius is None else scale * mesh.radius[rows],
        **chosen,
        **changed,
    ), np.array(rows)


def made(seed):
    """The scene of a seed, the precision that has its turn, and the order of its bodies."""
    case = drawn(seed)
    mesh, start, end = case.make()
    return case, mesh, start, end, PRECISIONS[seed // 2 % 2], np.arange(mesh.num_bodies)


@every_scene
def test_in_units_that_are_powers_of_two_all_bits_are_the_same(seed):
    case, mesh, start, end, precision, order = made(seed)

    def answers(scale):
        options = case.options | {"length_scale": scale * case.options["length_scale"]}
        options |= {name: scale * length for name, length in case.only("minimum_distance").items()}
        own, _ = remade(mesh, order, scale, exclude_pairs=mesh.exclude_pairs)
        x, y, distance = scale * start, scale * end, 0.05 * scale * case.size
        found = outputs_of(ccd.mesh_ccd(own, x, y, precision=precision, **options), "step")
        found |= outputs_of(ccd.find_candidates(own, x, y, 0.1 * distance, **case.only("broad_phase")), "candidates")
        found |= outputs_of(ccd.find_proximity(own, x, distance), "near")
        found |= outputs_of(ccd.displacement_bounds(own, x, distance), "bounds")
        found |= outputs_of(ccd.find_intersections(own, y), "intersections")
        del found["step.hidden_gaps"]  # a text that names lengths
        is_length = {name: name.rpartition(".")[2] in LENGTHS for name in found}
        return {name: array / scale if is_length[name] else array for name, array in found.items()}

    truth = answers(1.0)
    for exponent in (1, -7, 20):
        assert different(answers(2.0**exponent), truth) == []


@every_scene
def test_bodies_in_another_order_have_the_same_bits(seed):
    case, mesh, start, end, precision, order = made(seed)
    others = np.random.default_rng(seed).permutation(order)
    results = []
    for bodies in (order, others):
        own, rows = remade(mesh, bodies)
        result = ccd.mesh_ccd(own, start[rows], end[rows], precision=precision, **case.options)
        bounds = ccd.displacement_bounds(own, start[rows], 0.05 * case.size)
        places = np.argsort(rows), np.argsort(bodies)
        results.append({
            "vertices": result.vertex_toi[places[0]], "bodies": result.body_toi[places[1]], "worlds": result.world_toi,
            "contacts": np.array(sorted(zip(result.contacts.toi, result.contacts.kind, strict=True))),
            "bounds": bounds[places[0]],
        })  # fmt: skip
    assert different(*results) == []


@every_scene
def test_a_larger_distance_never_comes_later(seed):
    case, mesh, start, end, precision, _ = made(seed)
    name = "minimum_distance" if case.is_euclidean else "minimum_separation"
    unit = case.size if case.is_euclidean else 1.0
    options = {**case.options, "start_gap_fraction": None, "precision": precision}
    found = [
        tois_of(ccd.mesh_ccd(mesh, start, end, **options | {name: distance * unit}).contacts)
        for distance in (0.0, 2.0**-9, 2.0**-6, 0.1)
    ]
    for near, far in zip(found[1:], found, strict=False):
        assert all(near[pair] <= toi for pair, toi in far.items())


@every_scene
def test_a_shorter_step_ends_at_its_end(seed):
    """What it has is the same but for what the tolerance leaves open, and what is gone comes later."""
    case, mesh, start, end, precision, _ = made(seed)
    slack = 2.0**-20 + (case.options["tolerance"] if precision == "float64" else 1e-4)
    options = {**case.options, "precision": precision}
    of_both = [ccd.mesh_ccd(mesh, start, end, **options | {"t_max": t}).contacts for t in (1.0, 0.4)]
    whole, part = map(tois_of, of_both)
    # what rounding hides, or was within the tolerance alone, may be told apart in a shorter step
    is_doubtful = of_both[0].gap > case.size * 2.0 ** (-40 if precision == "float64" else -12)
    doubtful = tois_of(of_both[0][is_doubtful | (of_both[0].status == ccd.CCDStatus.ROUNDING_LIMIT)])
    assert part.keys() <= whole.keys()
    assert all(toi <= 0.4 and abs(toi - whole[pair]) <= slack for pair, toi in part.items())
    assert all(whole[pair] > 0.4 - slack for pair in whole.keys() - part.keys() - doubtful.keys())
