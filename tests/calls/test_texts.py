"""What calls and results say of themselves: docstrings, a line or two in a session, tables in notebooks, and help."""

import inspect
import math
import pydoc
import re
from dataclasses import fields, is_dataclass
from xml.etree import ElementTree

import numpy as np
import pytest
import warp as wp
from scenes import FACE, TRIANGLE, crowd, named_cloth_and_ball, random_pairs

import ccd_warp as ccd
from ccd_warp import distributed
from ccd_warp._runtime.display import point_text

PUBLIC = [getattr(part, name) for part in (ccd, ccd.viz, distributed) for name in part.__all__]
INDEXED = ("step", "id")  # by the number of a step or a query alone
FUNCTIONS = [each for each in PUBLIC if inspect.isfunction(each)]
FUNCTIONS += [
    each
    for of in filter(inspect.isclass, PUBLIC)
    for name, each in inspect.getmembers(of, lambda each: inspect.isfunction(each) or inspect.ismethod(each))
    if not name.startswith("_") and name not in INDEXED
]


def described(documented: object, section: str) -> list[str]:
    """The names in a section of a docstring."""
    found = re.search(rf"^{section}:\n(.*?)(\n\n|\Z)", inspect.getdoc(documented), re.S | re.M)
    return re.findall(r"^    \*{0,2}(\w+):", found[1], re.M) if found else []


def test_every_argument_of_a_call_and_every_field_of_a_result_is_described_once():
    for call in FUNCTIONS:
        names = [name for name in inspect.signature(call).parameters if name != "self"]
        assert described(call, "Args") == names, call
    for table in filter(is_dataclass, PUBLIC):
        names = [field.name for field in fields(table) if not field.name.startswith("_")]
        assert sorted(described(table, "Attributes")) == sorted(names), table


def test_a_method_of_a_pipeline_says_what_its_function_says():
    for name in filter(lambda name: hasattr(ccd.CollisionPipeline, name), ccd.__all__):
        function, method = getattr(ccd, name), getattr(ccd.CollisionPipeline, name)
        of_function, of_method = inspect.getdoc(function), inspect.getdoc(method)
        assert f":func:`ccd_warp.{name}`" in of_method
        assert of_function[of_function.index("\n\nReturns:") : of_function.index("\n\nRaises:")] in of_method
        assert of_method.endswith(of_function[of_function.index("\n\nGuarantee:") :])
        assert described(function, "Raises") == ["ValueError", "TypeError"]
        assert described(method, "Raises") == ["ValueError"]  # a pipeline has its options


def test_help_of_every_call_fits_on_a_screen_or_two():
    calls = list(FUNCTIONS)
    for of in filter(inspect.isclass, PUBLIC):
        calls += [each for _, each in inspect.getmembers(of, lambda each: isinstance(each, property))]
    assert len(calls) > 100
    for call in calls:
        text = pydoc.plain(pydoc.render_doc(call))
        # lines as a terminal shows them that is 120 columns wide: a signature is one line of the text
        assert sum(max(1, math.ceil(len(line) / 120)) for line in text.splitlines()) <= 80, call


# --- in a session ---


@pytest.fixture(scope="module")
def public():
    """An object of every public class that holds something."""
    mesh, start, end = crowd(np.random.default_rng(0), num_faces=1500)
    result, pipeline = ccd.mesh_ccd(mesh, start, end), ccd.CollisionPipeline(mesh, minimum_separation=1e-3)
    launched = pipeline.launch(start, end)
    points, points_t1 = random_pairs("edge_edge", 5000)
    poses = np.ones((50, 40, 7))
    objects = [mesh, named_cloth_and_ball()[0].replicate(1000), pipeline, result, result.first, result.contacts]
    objects += [result.counts, launched, launched.contacts, launched.to_host(), ccd.line_search(mesh, start, end)]
    objects += [ccd.find_candidates(mesh, start, end), ccd.edge_edge_ccd(points, points_t1)]
    return [*objects, ccd.RigidMotion(poses, poses, path="screw")]


def test_every_public_object_shows_itself_in_a_line_or_two_and_tables_are_short_and_well_formed(public):
    named, start, end = named_cloth_and_ball()
    bodies = [(start, named.faces), (TRIANGLE, FACE)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, names=["c" * 500, "<script>"])  # of which texts are cut
    start, end = (np.vstack([x, TRIANGLE + 9]) for x in (start, end))
    objects = [*public, mesh, ccd.mesh_ccd(mesh, start, end)]
    for text, value in zip(map(repr, objects), objects, strict=True):
        assert text.startswith(f"{type(value).__name__}(") and text.endswith(")")
        assert len(text) < 240 and text.count("\n") <= 1 and "array(" not in text and "object at" not in text, text
    assert "<script>" not in mesh._repr_html_() and "&lt;script&gt;" in mesh._repr_html_()
    tables = [value._repr_html_() for value in public if hasattr(value, "_repr_html_")]
    assert len(tables) >= 6
    for html in tables:
        table = ElementTree.fromstring(f"<div>{html}</div>").find("table")
        assert table is not None and 1 <= len(table.find("tbody")) <= 30 and len(html) < 10_000


def test_results_say_toi_contacts_and_the_first_by_name():
    result = ccd.mesh_ccd(*named_cloth_and_ball())
    text = f"MeshResult(toi={result.toi!r}, {len(result.contacts):,} contacts, first: vertex-face of ball and cloth at"
    assert repr(result).startswith(text)
    assert repr(ccd.mesh_ccd(*named_cloth_and_ball(), t_max=0.1)) == "MeshResult(toi=inf, no contact)"
    pairs = ccd.edge_edge_ccd(*random_pairs("edge_edge", 5000))
    num_hits = f"{np.isfinite(pairs.toi).sum():,}"
    assert repr(pairs) == f"PairResult(5,000 pairs, {num_hits} touching, earliest toi={float(pairs.toi.min())!r})"
    zeros = [wp.zeros((3, 4), dtype=wp.vec3d) for _ in range(2)]
    assert repr(ccd.edge_edge_ccd(*zeros)) == f"PairResult(3 pairs, arrays on {zeros[0].device})"


def test_a_place_shows_no_rounding():
    assert point_text([1.0, 6e-17, -0.0]) == "(1, 0, 0)" and point_text([0.0, -0.0, 0.0]) == "(0, 0, 0)"
    assert point_text([1e-300, 2e-300, -1e-311]) == "(1e-300, 2e-300, -1e-311)"
    assert point_text([np.inf, 1.0, np.nan]) == "(inf, 1, nan)"
