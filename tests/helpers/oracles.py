"""What steps are compared with: exact arithmetic over all pairs, and contacts as a table."""

import itertools

import numpy as np
from exact import exact_tois

import ccd_warp as ccd
from ccd_warp._pairs import pair_vertices


def rows(contacts):
    """Contacts as a mapping from kind and primitives to toi."""
    keys = np.column_stack([contacts.kind, contacts.primitives]).tolist()
    return dict(zip(map(tuple, keys), contacts.toi.tolist(), strict=True))


def exact_contacts(mesh, start, end):
    """Pairs that share no vertex, have a vertex that moves, and touch: (kind, vertices…), by exact arithmetic."""
    moved = (start != end).any(axis=1)
    found = []
    for kind, pairs in (
        ("vertex-face", [(v, *f) for v in range(len(start)) for f in mesh.faces.tolist()]),
        ("edge-edge", [(*a, *b) for a, b in itertools.combinations(mesh.edges.tolist(), 2)]),
    ):
        corners = np.array([c for c in pairs if len(set(c)) == 4 and moved[list(c)].any()], dtype=int).reshape(-1, 4)
        if len(corners):
            exact = exact_tois(kind, start[corners], end[corners])
            found += [(kind, *c) for c, e in zip(corners.tolist(), exact, strict=True) if e.hit]
    return found


def num_touching(mesh, start, end, **options):
    """Contacts of vertices that move, by `mesh_ccd` on the host."""
    corners = pair_vertices(mesh, ccd.mesh_ccd(mesh, start, end, **options).contacts)
    return int((start[corners] != end[corners]).any(axis=(1, 2)).sum())
