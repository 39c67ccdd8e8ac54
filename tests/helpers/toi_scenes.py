"""What gradients of times of impact are asked of: meshes, and arrays on a tape."""

import numpy as np
import warp as wp

import ccd_warp as ccd

TRIANGLE, FACE = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]])


def scene(**options):
    """All kinds of pairs: two bodies, one of which falls on the other and on two half-spaces, one of them moving."""
    cables = [[-2.0, 0, 0], [-1.5, 0.4, 0.02], [2.0, 0.1, 0.01], [-1.75, 0.2, 0.01], [5.0, 5.0, 0.02]]
    lower = np.array([*TRIANGLE, *cables])
    upper = lower * [0.98, 1.04, 1.0] + [0.02, 0.01, 0.5] + 0.02 * np.random.default_rng(0).random(lower.shape)
    planes = [ccd.HalfSpace([0, 0, -0.35], [0.1, 0.2, 2.0]), ccd.HalfSpace([0, 0, -0.5], [0, 0.1, 1.0])]
    bodies = [*((x, FACE, [[3, 4]]) for x in (lower, upper)), *planes]
    options = {"codimensional_points": True, "self_collision": False, "kinematic": [3]} | options
    mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
    fall, amount = (np.array(x)[mesh.vertex_body, None] for x in ([0.3, 0.75, 0.0, -0.1], [0.05, 0.05, 0, 0]))
    noise = np.random.default_rng(2).standard_normal(mesh.vertices.shape)
    return mesh, mesh.vertices.copy(), mesh.vertices - fall * [0, 0, 1] + amount * noise


def thick_scene():
    """The same with radii."""
    return scene(radius=np.linspace(0.0, 0.02, 17))


def random_scene(seed):
    """Tetrahedra that are thrown into each other and deform, and the options of a call."""
    rng = np.random.default_rng(seed)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    places = 1.5 * rng.standard_normal((5, 3))
    bodies = [(corners + 0.2 * rng.standard_normal((4, 3)) + place, faces) for place in places]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False)
    throws = -0.8 * places + 0.3 * rng.standard_normal((5, 3))
    end = mesh.vertices + throws[mesh.vertex_body] + 0.1 * rng.standard_normal(mesh.vertices.shape)
    options = [{}, {"minimum_distance": 0.02}, {"minimum_separation": 0.02, "length_scale": 1.0}][seed % 3]
    return mesh, mesh.vertices.copy(), end, options


def array(values, dtype=wp.vec3d, requires_grad=True):
    """An array that requires a gradient."""
    return wp.array(values, dtype=dtype, requires_grad=requires_grad)


def taped(call):
    """A tape on which a call is recorded, and what it returns."""
    tape = wp.Tape()
    with tape:
        result = call()
    return tape, result
