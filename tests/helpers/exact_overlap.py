"""What intersects in a mesh, by linear programs in rational numbers over all pairs: no determinant and no tree."""

import itertools
import sys
from fractions import Fraction
from functools import cache

import numpy as np
from kept import kept
from oracles import taking_part

import ccd_warp as ccd


def hulls_meet(a, b):
    """Whether the convex hulls of two lists of points of rational numbers have a common point.

    They do if 0 is a convex combination of the differences: the first phase of the simplex method, by Bland's rule.
    """
    for axis in zip(*a, *b, strict=True):
        if max(axis[: len(a)]) < min(axis[len(a) :]) or max(axis[len(a) :]) < min(axis[: len(a)]):
            return False
    columns = [[*(x - y for x, y in zip(p, q, strict=True)), Fraction(1)] for p in a for q in b]
    rows = len(columns[0])
    # right-hand side (0, …, 0, 1), one artificial variable a row, whose sum is to become 0
    table = [[column[r] for column in columns] + [Fraction(int(r == rows - 1))] for r in range(rows)]
    basis = [None] * rows
    while True:
        cost = [sum(table[r][k] for r in range(rows) if basis[r] is None) for k in range(len(columns) + 1)]
        if cost[-1] == 0:
            return True
        enter = next((k for k in range(len(columns)) if cost[k] > 0), None)
        if enter is None:
            return False
        ratios = [
            (table[r][-1] / table[r][enter], -1 if basis[r] is None else basis[r], r)
            for r in range(rows)
            if table[r][enter] > 0
        ]
        leave = min(ratios)[2]
        pivot = table[leave][enter]
        table[leave] = [x / pivot for x in table[leave]]
        for r in range(rows):
            if r != leave and table[r][enter] != 0:
                factor = table[r][enter]
                table[r] = [x - factor * y for x, y in zip(table[r], table[leave], strict=True)]
        basis[leave] = enter


def _all_intersections(mesh, x):
    """Every (kind, first, second) that `find_intersections` is to find, for a mesh without lists or rings."""
    points = [tuple(map(Fraction, row)) for row in np.asarray(x, dtype=np.float64).tolist()]
    faces, edges = ([tuple(row) for row in table.tolist()] for table in (mesh.faces, mesh.edges))
    kinds = ccd.IntersectionKind

    @cache
    def meet(a, b):
        return not {*a} & {*b} and hulls_meet([points[v] for v in a], [points[v] for v in b])

    def may_meet(a, b):
        body = [mesh.vertex_body[c[0]] for c in (a, b)]
        world = [mesh.vertex_world[c[0]] for c in (a, b)]
        if {*a} & {*b} or mesh.static[body].all() or world[0] != world[1]:
            return False
        return body[0] != body[1] or mesh.self_collision[body[0]]

    def passes(e, f):
        """Through the inside: the edge meets the face, but no end of it does, and no side of the face."""
        sides = itertools.combinations(f, 2)  # a face may repeat a vertex, and then a side is that vertex
        return meet(e, f) and not any(meet((v,), f) for v in e) and not any(meet(e, side) for side in sides)

    vertices, takes_part = [(v,) for v in range(mesh.num_vertices)], {*taking_part(mesh)}
    is_point = np.isin(np.arange(mesh.num_vertices), mesh.codimensional_points)
    is_cable = np.isin(np.arange(len(edges)), mesh.codimensional_edges)
    in_plane = mesh.dimension == 2
    found = []

    def search(kind, first, second, test, chosen=lambda i, j: True):
        for (i, a), (j, b) in itertools.product(enumerate(first), enumerate(second)):
            if chosen(i, j) and may_meet(a, b) and test(a, b):
                found.append((int(kind), i, j))

    search(kinds.VERTEX_FACE, vertices, faces, meet, lambda i, j: i in takes_part)
    if in_plane:
        search(
            kinds.EDGE_EDGE,
            edges,
            edges,
            lambda a, b: meet(a, b) and not any(meet((v,), b) for v in a) and not any(meet((v,), a) for v in b),
            lambda i, j: i < j,
        )
    else:
        search(kinds.EDGE_EDGE, edges, edges, meet, lambda i, j: i < j)
    search(
        kinds.POINT_SEGMENT,
        vertices,
        edges,
        meet,
        lambda i, j: i in takes_part and (in_plane or (is_point[i] and is_cable[j])),
    )
    search(kinds.POINT_POINT, vertices, vertices, meet, lambda i, j: i < j and is_point[i] and is_point[j])
    search(kinds.EDGE_FACE, edges, faces, passes)
    return sorted(found)


def _question(mesh, x):
    """All that the answer depends on."""
    return (
        x,
        *(mesh.faces, mesh.edges, mesh.vertex_body, mesh.vertex_world, mesh.static, mesh.self_collision),
        *(mesh.codimensional_points, mesh.codimensional_edges, mesh.dimension),
    )


all_intersections = kept(_all_intersections, sys.modules[__name__], question_of=_question)
