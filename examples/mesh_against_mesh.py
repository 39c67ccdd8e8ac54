"""Two deforming meshes approach: when do they touch, where, and how much of the step is safe to take?

A ball that stretches flies at a larger one that is squashed. `mesh_ccd` returns all contacts of the step and their
times; `collision_free_step` returns only the fraction that is certain to be free, which is what a line search needs.

Run it: python examples/mesh_against_mesh.py
"""

import numpy as np
import trimesh

import ccd_warp as ccd

small = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
large = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
mesh = ccd.CollisionMesh.from_trimesh([small, large])

# One array for all bodies, in the order in which they were given.
vertices_t0 = np.vstack([small.vertices + [-3.0, 0.2, 0.1], large.vertices])
vertices_t1 = np.vstack([small.vertices * [1.5, 0.8, 0.8] + [1.0, 0.2, 0.1], large.vertices * [0.8, 1.1, 1.1]])

result = ccd.mesh_ccd(mesh, vertices_t0, vertices_t1)
print(f"scene toi      {result.toi}")
for body, toi in enumerate(result.body_toi):
    print(f"body {body} toi     {float(toi)}")
print(f"contacts       {len(result.contacts.toi)} in the whole step")
first = result.first
print(f"first contact  {first.kind.name.lower().replace('_', '-')} {first.primitives.tolist()}")
print(f"  normal       {first.normal.round(6).tolist()}")

# Stop a little before the contact: positions are rounded when they are advanced, and the gap allows for that.
step = ccd.collision_free_step(mesh, vertices_t0, vertices_t1, minimum_separation=1e-3)
vertices = vertices_t0 + step * (vertices_t1 - vertices_t0)
print(f"free step      {step}")
print("surfaces touch after it:", np.isfinite(ccd.mesh_ccd(mesh, vertices, vertices).toi))
