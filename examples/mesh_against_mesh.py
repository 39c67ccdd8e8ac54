"""Two deforming meshes approach: when do they touch, where, and how much of the step is safe to take?

A ball that stretches flies at a larger one that is squashed. `mesh_ccd` returns all contacts of the step and their
times; `collision_free_step` returns only the fraction that is certain to be free, which is what a line search needs.

    python examples/mesh_against_mesh.py

takes some seconds, the loading of the kernels included. With `--output balls` and `pip install -e '.[viz]'` it draws
balls/mesh_against_mesh.png: the step at its start, at the first contact, and at its end, where the balls are in each
other.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh

import ccd_warp as ccd


def shown(vector: np.ndarray) -> str:
    """A vector as a person reads it."""
    return "(" + ", ".join(f"{number:.3f}" for number in vector) + ")"


def main() -> None:
    """Ask for all contacts of the step and for the free part of it, print, and draw."""
    parser = argparse.ArgumentParser(description="Two balls that deform and meet in one step; some seconds.")
    parser.add_argument("--output", type=Path, help="folder for mesh_against_mesh.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    small = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    large = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    mesh = ccd.CollisionMesh.from_trimesh([small, large], names=["small ball", "large ball"])

    # One array for all bodies, in the order in which they were given.
    vertices_t0 = np.vstack([small.vertices + [-3.0, 0.2, 0.1], large.vertices])
    vertices_t1 = np.vstack([small.vertices * [1.5, 0.8, 0.8] + [1.0, 0.2, 0.1], large.vertices * [0.8, 1.1, 1.1]])

    result = ccd.mesh_ccd(mesh, vertices_t0, vertices_t1)
    first = result.first
    names = first.kind.name.lower().split("_")
    sides = [
        f"{name} {k} of the {body}" for name, k, body in zip(names, first.primitives, first.body_names, strict=True)
    ]
    print(f"first contact  toi = {result.toi:.5f}, {' and '.join(sides)}")
    print(f"  place        {shown(first.point)}, normal {shown(first.normal)}")
    print(f"contacts       {len(result.contacts.toi):,} pairs of primitives touch during the whole step")

    # Stop a little before the contact: positions are rounded when they are advanced, and the gap allows for that.
    step = ccd.collision_free_step(mesh, vertices_t0, vertices_t1, minimum_separation=1e-3)
    for title, fraction in (("free step", step), ("whole step", 1.0)):
        vertices = vertices_t0 + fraction * (vertices_t1 - vertices_t0)
        count = len(ccd.find_intersections(mesh, vertices))
        print(f"{title:14} {fraction:.5f}, {count} intersections at its end")
    if options.output:
        from ccd_warp.viz import render_step

        options.output.mkdir(parents=True, exist_ok=True)
        render_step(mesh, vertices_t0, vertices_t1, result, options.output / "mesh_against_mesh.png", size=(1200, 420))


if __name__ == "__main__":
    main()
