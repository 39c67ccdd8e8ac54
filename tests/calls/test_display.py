"""What objects show in a session: a line or two each, however large they are, tables in notebooks, and help."""

import inspect
import math
import pydoc
from xml.etree import ElementTree

import numpy as np
import pytest
import warp as wp
from scenes import crowd, random_pairs, sheet_over_ball

import ccd_warp as ccd
from ccd_warp import datasets
from ccd_warp._display import point_text


def _named():
    unnamed, start, end = sheet_over_ball()
    low = int(unnamed.body_vertex_range[1])
    faces = [unnamed.faces[unnamed.face_body == b] - b * low for b in (0, 1)]
    bodies = [(start[:low], faces[0]), (start[low:], faces[1])]
    return ccd.CollisionMesh.from_arrays(bodies, static=["ball"], names=["cloth", "ball"]), start, end


@pytest.fixture(scope="module")
def public():
    """An object of every public class that holds something."""
    mesh, start, end = crowd(np.random.default_rng(0), num_faces=1500)
    result = ccd.mesh_ccd(mesh, start, end, device="cpu")
    pipeline = ccd.CollisionPipeline(mesh, minimum_separation=1e-3, device="cpu")
    launched = pipeline.launch(start, end)
    points, points_t1 = random_pairs("edge_edge", 5000)
    sources = (("a.csv", 2500), ("b.csv", 2500))
    return {
        "mesh": mesh,
        "replicated mesh": _named()[0].replicate(1000),
        "pipeline": pipeline,
        "result": result,
        "first": result.first,
        "contacts": result.contacts,
        "counts": result.counts,
        "launched": launched,
        "contacts on the device": launched.contacts,
        "launched, on the host": launched.to_host(),
        "line search": ccd.line_search(mesh, start, end, device="cpu"),
        "candidates": ccd.find_candidates(mesh, start, end, device="cpu"),
        "pairs": ccd.edge_edge_ccd(points, points_t1, device="cpu"),
        "queries": datasets.Queries("spikes", "edge-edge", points, points, None, sources),
        "step": datasets.SimulationStep(start, end, mesh.faces),
        "motion": ccd.RigidMotion(np.ones((50, 40, 7)), np.ones((50, 40, 7)), path="screw"),
        "affine motion": ccd.AffineMotion(np.ones((50, 40, 3, 4)), np.ones((50, 40, 3, 4))),
    }


def test_every_public_object_shows_itself_in_a_line_or_two(public):
    for name, value in public.items():
        text = repr(value)
        assert text.startswith(f"{type(value).__name__}(") and text.endswith(")"), name
        assert len(text) < 240 and text.count("\n") <= 1, f"{name}: {text}"
        assert "array(" not in text and "object at" not in text, text


def test_long_names_are_cut():
    mesh, start, end = _named()
    low = int(mesh.body_vertex_range[1])
    bodies = [(start[:low], mesh.faces[mesh.face_body == 0]), (start[low:], mesh.faces[mesh.face_body == 1] - low)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], names=["c" * 500, "b" * 500])
    result = ccd.mesh_ccd(mesh, start, end, device="cpu")
    assert len(repr(mesh)) < 240 and len(repr(result)) < 240


def test_a_result_says_toi_contacts_and_the_first_by_name():
    result = ccd.mesh_ccd(*_named(), device="cpu")
    text = repr(result)
    assert text.startswith(f"MeshResult(toi={result.toi!r}, {len(result.contacts):,} contacts, first: vertex-face of ")
    assert " of ball and cloth at (" in text
    assert repr(ccd.mesh_ccd(*_named(), device="cpu", t_max=0.1)) == "MeshResult(toi=inf, no contact)"


def test_pairs_and_pipelines_say_what_they_are(public):
    pairs = public["pairs"]
    assert repr(pairs) == (
        f"PairResult(5,000 pairs, {np.isfinite(pairs.toi).sum():,} touching, earliest toi={float(pairs.toi.min())!r})"
    )
    on_device = ccd.edge_edge_ccd(*(wp.zeros((3, 4), dtype=wp.vec3d, device="cpu") for _ in range(2)))
    assert repr(on_device) == "PairResult(3 pairs, arrays on cpu)"
    assert repr(public["pipeline"]).endswith(", minimum_separation=0.001, device='cpu', on cpu)")


@pytest.mark.parametrize("name", ["mesh", "replicated mesh", "result", "contacts", "counts", "launched, on the host"])
def test_tables_for_notebooks_are_short_and_well_formed(public, name):
    html = public[name]._repr_html_()
    table = ElementTree.fromstring(f"<div>{html}</div>").find("table")
    assert table is not None and 1 <= len(table.find("tbody")) <= 30 and len(html) < 10_000


def test_names_are_escaped_in_tables():
    mesh = ccd.CollisionMesh.from_arrays([(np.eye(3), [[0, 1, 2]])], names=["<script>"])
    assert "<script>" not in mesh._repr_html_() and "&lt;script&gt;" in mesh._repr_html_()


def public_calls():
    """Every public function, and every method and property of a public class, by its name."""
    calls = {}
    for module in (ccd, ccd.viz, ccd.datasets):
        for name in module.__all__:
            value = getattr(module, name)
            if not inspect.isclass(value):
                calls |= {name: value} if callable(value) else {}
                continue
            for part in dir(value):
                if part == "__init__" or not part.startswith("_"):
                    found = inspect.getattr_static(value, part)
                    found = getattr(value, part) if isinstance(found, (classmethod, staticmethod)) else found
                    calls |= {f"{name}.{part}": found} if callable(found) or isinstance(found, property) else {}
    return calls


def test_help_of_every_call_fits_on_a_screen_or_two():
    calls = public_calls()
    assert {"mesh_ccd", "CollisionPipeline.launch", "DeviceContacts.points", "render_step", "find_queries"} <= set(
        calls
    )
    for name, call in calls.items():
        text = pydoc.plain(pydoc.render_doc(call))
        # lines as a terminal shows them that is 120 columns wide: a signature is one line of the text
        assert sum(max(1, math.ceil(len(line) / 120)) for line in text.splitlines()) <= 80, name


def test_a_place_shows_no_rounding():
    assert point_text([1.0, 6e-17, -0.0]) == "(1, 0, 0)" and point_text([0.0, -0.0, 0.0]) == "(0, 0, 0)"
    assert point_text([1e-300, 2e-300, -1e-311]) == "(1e-300, 2e-300, -1e-311)"
    assert point_text([np.inf, 1.0, np.nan]) == "(inf, 1, nan)"
