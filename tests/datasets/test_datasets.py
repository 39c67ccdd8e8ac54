"""The public data comes in and goes out exactly, or not at all and with the line that is to blame."""

import os
import re
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as stn
from published import DATA, requires_data

import ccd_warp as ccd
from ccd_warp import datasets
from ccd_warp.datasets import _csv

ROW = "1,2,-3,4,0,1"
QUERY = [ROW] * 8
# Each of them in the last place of something: the ends of float64, of its subnormals, of its integers.
EXTREMES = [
    2.0**-1074,
    -3 * 2.0**-1074,
    np.nextafter(2.0**-1022, 0),
    2.0**-1022,
    np.nextafter(2.0**-1021, 1),
    1 / 3,
    -np.pi * 2.0**-60,  # a denominator of 112 bits
    2.0**53 - 1,
    2.0**53,
    2.0**53 + 2,
    -(2.0**64),
    1e300,
    np.finfo(np.float64).max,
    -np.finfo(np.float64).max,
    0.0,
]


def _write(folder, rows, name="0vf.csv", end="\n"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes("".join(row + end for row in rows).encode())
    return path


def _points(n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, 4, 3)) * 2.0 ** rng.integers(-80, 80, (n, 4, 3))


def _same_bits(a, b):
    return (
        a.shape == b.shape and a.dtype == b.dtype == np.float64 and np.array_equal(a.view(np.int64), b.view(np.int64))
    )


def _refused(path, line, message, **options):
    with pytest.raises(ValueError, match=re.escape(f"{path}, line {line}") + f"[ :]+{message}"):
        datasets.read_queries(path, **options)


@pytest.fixture(params=["one block", "a line a block"])
def blocks(request, monkeypatch):
    """Both ways to cut a file: what is between blocks must not show."""
    if request.param == "a line a block":
        monkeypatch.setattr(_csv, "_BLOCK", 1)


# ---- Queries out and in ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("truth", [None, np.arange(5) % 2 == 0])
def test_queries_come_back(tmp_path, blocks, monkeypatch, truth):
    monkeypatch.setattr(_csv, "_QUERIES", 2)
    start, end = _points(5), _points(5, seed=1)
    path = tmp_path / "227ee.csv"
    datasets.write_queries(path, start, end, truth)
    read = datasets.read_queries(path)
    assert _same_bits(read.points_t0, start) and _same_bits(read.points_t1, end)
    assert (read.truth is None) == (truth is None) and np.array_equal(read.truth, truth)
    assert (read.name, read.kind, read.sources) == ("227ee", "edge-edge", (("227ee.csv", 5),))
    assert len(read) == 5 and read.id(3) == "227ee.csv:3" and read.id(-1) == "227ee.csv:4"
    assert all(array.flags["C_CONTIGUOUS"] and array.flags["OWNDATA"] for array in (read.points_t0, read.points_t1))
    with pytest.raises(IndexError):
        read.id(5)
    assert path.read_bytes().count(b"\n") == 40 and b"\r" not in path.read_bytes()
    assert os.listdir(tmp_path) == ["227ee.csv"]


def test_extreme_coordinates_come_back(tmp_path):
    points = np.resize(EXTREMES, (2, 4, 3))
    path = tmp_path / "vf.csv"
    datasets.write_queries(path, points, points[::-1])
    read = datasets.read_queries(path)
    assert _same_bits(read.points_t0, points) and _same_bits(read.points_t1, points[::-1].copy())


def test_zero_loses_its_sign(tmp_path):
    path = tmp_path / "vf.csv"
    datasets.write_queries(path, np.full((1, 4, 3), -0.0), np.zeros((1, 4, 3)))
    assert path.read_text() == "0,1,0,1,0,1\n" * 8
    assert _same_bits(datasets.read_queries(path).points_t0, np.zeros((1, 4, 3)))
    _write(tmp_path, ["-0,1,-0,8,0,3"] * 8, "vf.csv")
    assert _same_bits(datasets.read_queries(path).points_t0, np.zeros((1, 4, 3)))


finite = st.floats(allow_nan=False, allow_infinity=False)


@given(stn.arrays(np.float64, st.tuples(st.integers(0, 3), st.just(8), st.just(3)), elements=finite), st.data())
def test_any_finite_query_comes_back(tmp_path_factory, points, data):
    path = tmp_path_factory.mktemp("queries") / "ee.csv"
    truth = np.array(data.draw(st.lists(st.booleans(), min_size=len(points), max_size=len(points))), dtype=bool)
    datasets.write_queries(path, points[:, :4], points[:, 4:], truth)
    read = datasets.read_queries(path)
    # Adding 0.0 takes the sign from a zero.
    assert _same_bits(np.concatenate([read.points_t0, read.points_t1], axis=1), points + 0.0)
    assert len(points) == 0 or np.array_equal(read.truth, truth)


@given(st.integers(-(2**60), 2**60), st.integers(0, 1200), st.integers(1, 10**30))
def test_a_rational_is_exact_or_refused(n, k, factor):
    fraction = Fraction(n * factor, factor << k)
    fields = [str(n * factor).encode()], [str(factor << k).encode()]
    if Fraction(float(fraction)) == fraction:
        assert Fraction(float(_csv._floats("x", 1, fields[0] * 3, fields[1] * 3)[2])) == fraction
    else:
        with pytest.raises(ValueError, match="is not a float64"):
            _csv._floats("x", 1, fields[0] * 3, fields[1] * 3)


@pytest.mark.parametrize(
    "rational, value",
    [
        ("3,4", 0.75),
        ("-1," + str(2**100), -(2.0**-100)),
        ("6,8", 0.75),
        ("007,04", 1.75),
        ("10,5", 2.0),
        ("3,3", 1.0),
        (f"{3**50},{4 * 3**49}", 0.75),
        (f"{2**53 + 2},2", 2.0**52 + 1),
        (f"1,{2**1074}", 2.0**-1074),
        (f"2,{2**1075}", 2.0**-1074),
        (f"{2**1100},{2**100}", 2.0**1000),
        (f"1{'0' * 6000},2{'0' * 6000}", 0.5),  # more digits than int() takes
        (f"-1{'0' * 6000},1{'0' * 5999}", -10.0),
    ],
)
def test_rational_of_any_form(tmp_path, rational, value):
    path = _write(tmp_path, [f"1,2,{rational},0,1"] * 8)
    assert (datasets.read_queries(path).points_t1[:, :, 1] == value).all()


@requires_data
@pytest.mark.parametrize("path", sorted(DATA.glob("*/*/*/*.csv")), ids=lambda path: "/".join(path.parts[-3:]))
def test_published_queries_are_the_fractions_of_the_file(path):
    queries = datasets.read_queries(path)
    lines = path.read_text().split()
    points = np.stack([queries.points_t0, queries.points_t1], axis=1).reshape(-1, 3).tolist()
    assert len(lines) == len(points) == 8 * len(queries) > 0
    truths = [None] * len(lines) if queries.truth is None else np.repeat(queries.truth, 8).tolist()
    assert (path.parts[-4] == "handcrafted") == (queries.truth is not None)
    for line, point, truth in zip(lines[::7], points[::7], truths[::7], strict=True):
        fields = list(map(int, line.split(",")))
        assert [Fraction(x) for x in point] == [Fraction(*fields[k : k + 2]) for k in (0, 2, 4)]
        assert fields[6:] == ([] if truth is None else [truth])


@requires_data
def test_published_files_are_written_byte_for_byte(tmp_path):
    for part in ("handcrafted/unit-tests/edge-edge/data_0_0.csv", "simulation/cloth-funnel/queries/227ee.csv"):
        queries = datasets.read_queries(DATA / part)
        datasets.write_queries(tmp_path / "copy.csv", queries.points_t0, queries.points_t1, queries.truth)
        published = (DATA / part).read_bytes().replace(b"\r\n", b"\n").rstrip(b"\n") + b"\n"
        assert (tmp_path / "copy.csv").read_bytes() == published


# ---- Well-formed, in another dress -----------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("tail", [b"", b"\n", b"\r\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_line_ends_and_byte_order_mark(tmp_path, blocks, end, tail, mark):
    path = tmp_path / "vf.csv"
    path.write_bytes(mark + end.join([*QUERY, *QUERY]).encode() + tail)
    read = datasets.read_queries(path)
    assert len(read) == 2 and read.truth is None
    assert (read.points_t0 == [0.5, -0.75, 0.0]).all() and (read.points_t1 == [0.5, -0.75, 0.0]).all()


@pytest.mark.parametrize("space", [" ", "   "])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_spaces_after_commas_are_read_as_ccd_query_io_writes_them(tmp_path, blocks, space, end):
    row = space.join(["6896999465383287,", "36028797018963968,", "-5245561632958895,", "4503599627370496,", "0,", "1"])
    path = _write(tmp_path, [row] * 16, "queries.csv", end)
    truth = tmp_path / "mma_bool.json"
    truth.write_text("[false, true]")
    read = datasets.read_queries(path, kind="edge_edge", truth=truth)
    expected = np.full((2, 4, 3), [6896999465383287 / 2**55, -5245561632958895 / 2**52, 0.0])
    assert _same_bits(read.points_t0, expected) and _same_bits(read.points_t1, expected)
    assert read.truth.tolist() == [False, True]
    _write(tmp_path, [f"{row},{space}1"] * 8, "queries.csv", end)
    (found,) = datasets.find_queries(tmp_path, kind="edge-edge")
    assert found.truth.tolist() == [True] and _same_bits(found.points_t0, expected[:1])


def test_empty_lines_at_the_end_are_no_rows(tmp_path):
    path = tmp_path / "vf.csv"
    path.write_bytes("\n".join(QUERY).encode() + b"\n\n\r\n")
    assert len(datasets.read_queries(path)) == 1


@pytest.mark.parametrize("content", [b"", b"\n", b"\xef\xbb\xbf"])
def test_empty_file_holds_no_query(tmp_path, content):
    path = tmp_path / "ee.csv"
    path.write_bytes(content)
    read = datasets.read_queries(path)
    assert len(read) == 0 and read.truth is None and read.points_t0.shape == read.points_t1.shape == (0, 4, 3)


def test_rows_are_the_points_of_both_frames_in_order(tmp_path):
    path = _write(tmp_path, [f"{i},1,{i},2,{i},4,1" for i in range(16)])
    read = datasets.read_queries(path)
    assert read.points_t0[:, :, 0].tolist() == [[0, 1, 2, 3], [8, 9, 10, 11]]
    assert read.points_t1[1].tolist() == [[i, i / 2, i / 4] for i in range(12, 16)]


@pytest.mark.parametrize(
    "name, kind",
    [
        ("edge-edge/data_0_0.csv", "edge-edge"),
        ("vertex-face/data_0_0.csv", "vertex-face"),
        ("vertex-face/tree.csv", "vertex-face"),
        ("queries/227ee.csv", "edge-edge"),
        ("227vf.csv", "vertex-face"),
    ],
)
def test_kind_is_that_of_the_place(tmp_path, monkeypatch, name, kind):
    path = _write(tmp_path, QUERY, name)
    assert datasets.read_queries(path).kind == kind
    other = "edge-edge" if kind == "vertex-face" else "vertex-face"
    assert datasets.read_queries(str(path), kind=other).kind == other
    monkeypatch.chdir(path.parent)
    assert datasets.read_queries(path.name).kind == kind


@pytest.mark.parametrize("kind", [ccd.PairKind.EDGE_EDGE, "edge_edge", "edge-edge"])
def test_a_kind_is_taken_in_each_of_its_spellings(tmp_path, kind):
    path = _write(tmp_path, QUERY, "data_0.csv")
    read = datasets.read_queries(path, kind=kind)
    assert read.kind == "edge-edge"
    made = datasets.Queries("made", kind, read.points_t0, read.points_t1, read.truth, read.sources)
    assert datasets.Queries.joined("both", [read, made]).kind == "edge-edge"
    _write(tmp_path, QUERY * 2, "0vf.csv")
    _write(tmp_path, QUERY * 3, "0ee.csv")
    assert [(found.kind, len(found)) for found in datasets.find_queries(tmp_path, kind=kind)] == [("edge-edge", 4)]


def test_unknown_kind_is_refused(tmp_path):
    path = _write(tmp_path, QUERY, "data_0.csv")
    with pytest.raises(ValueError, match=r"data_0\.csv: neither its folder .* says the kind .* kind= of read_queries"):
        datasets.read_queries(path)
    with pytest.raises(ValueError, match="kind is 'point-point'; expected 'vertex-face' or 'edge-edge'"):
        datasets.read_queries(path, kind="point-point")
    for kind in (ccd.PairKind.POINT_POINT, 1, ["edge-edge"]):
        with pytest.raises(ValueError, match=r"kind is .*; expected 'vertex-face' or 'edge-edge'"):
            datasets.find_queries(tmp_path, kind=kind)


# ---- Malformed -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [1, 6, 16])
@pytest.mark.parametrize(
    "row, message",
    [
        ("", "is empty; expected 6 integers"),
        ("1,2,3,4,5", "has 5 columns; expected 6"),
        ("1,2,3,4,5,6,1,8", "has 8 columns; expected 6"),
        ("1,2,3,4,5,8,1", "has 7 columns; expected 6 as on line 1"),
        ("1,2,3,4,5,x", "'x' is not an integer; expected decimal digits"),
        ("1,2,3,4,5.0,6", r"'5\.0' is not an integer"),
        ("1,2,3,4,5e0,6", "'5e0' is not an integer"),
        ("1,2,3,4,nan,6", "'nan' is not an integer"),
        ("1,2,3,4,+5,6", r"'\+5' is not an integer"),
        ("1,2,3,4,1_0,6", "'1_0' is not an integer"),
        ("1,2,3,4 ,5,6", "'4 ' is not an integer"),
        (" 1,2,3,4,5,6", "' 1' is not an integer"),
        ("1,2,3,4, ,6", "' ' is not an integer"),
        ("1,2,3,4,\t5,6", r"'\\t5' is not an integer"),
        ("1,2,3,4,- 5,6", "'- 5' is not an integer"),
        ("1,2,3,4,5,8 ", "'8 ' is not an integer"),
        ("1,2,3,4,\r5,8", r"'\\r5' is not an integer"),
        ("1,2,3,4,٣,8", "'٣' is not an integer"),
        ("1,2,3,4,,8", "'' is not an integer"),
        ("1,2,3,4,5,", "'' is not an integer"),
        ("1,2,3,4,-,8", "'-' is not an integer"),
        ("1,2,3,4,--5,8", "'--5' is not an integer"),
        ("1,2,3,4,5-,8", "'5-' is not an integer"),
        ("1,2,3,4,5,8-", "'8-' is not an integer"),
        ("1,2,3,4,5,0", "denominator is 0; expected a positive integer"),
        ("1,2,3,4,5,-8", "denominator is -8; expected a positive integer"),
        ("1,2,3,4,0,0", "denominator is 0"),
        ("1,2,3,4,1,3", "1/3 is not a float64; expected a rational that is exactly one"),
        (f"{2**53 + 1},2,3,4,5,8", f"{2**53 + 1}/2 is not a float64"),
        (f"1,2,3,4,1,{2**1075}", r"1/4048045066146212\.\.\.\S+ \(324 characters\) is not"),
        (
            f"1,2,{2**1024},1,5,8",
            r"\S+ \(309 characters\)/1 is not a float64; expected a coordinate of at most 1.8e308",
        ),
        (f"1,2,{2**1024 - 2**970},1,5,8", ".* is not a float64; expected a coordinate of at most 1.8e308"),
        (f"1,2,{2**1024 - 2**970 - 1},1,5,8", ".* is not a float64; expected a rational"),
        (f"1,2,{'9' * 9000},1,5,8", r"9{16}\.\.\.9{8} \(9000 characters\)/1 is not a float64"),
        (f"1,2,1,{'9' * 9000},5,8", r"1/9{16}\.\.\.9{8} \(9000 characters\) is not a float64; expected a rational"),
    ],
)
def test_malformed_line_is_named(tmp_path, blocks, row, message, at):
    # At the end of the file, an empty line would be its end.
    rows = [*QUERY, *QUERY] if row else [*QUERY, *QUERY, *QUERY]
    rows[at - 1] = row
    path = _write(tmp_path, rows)
    if at == 1 and "columns" in message:  # the first line says how many there are
        at, message = (2, "has 6 columns; expected 7") if row.count(",") == 6 else (1, "has [58] columns; expected 6")
    _refused(path, at, message)


def test_lines_too_short_and_too_long_by_one_do_not_make_up_for_each_other(tmp_path):
    rows = list(QUERY)
    rows[3], rows[4] = "1,2,3,4,5", "1,2,3,4,5,8,1"
    _refused(_write(tmp_path, rows), 4, "has 5 columns; expected 6 as on line 1")


@pytest.mark.parametrize("header", ["xn,xd,yn,yd,zn,zd", "xn,xd,yn,yd,zn,zd,truth"])
def test_header_is_no_query(tmp_path, header):
    _refused(_write(tmp_path, [header, *QUERY]), 1, "'xn' is not an integer")


@pytest.mark.parametrize("rows", [1, 7, 9, 23])
def test_rows_that_make_no_whole_query(tmp_path, blocks, rows):
    _refused(
        _write(tmp_path, [ROW] * rows), rows, f"the file ends after {rows} rows; expected a multiple of 8, 8 a query"
    )


@pytest.mark.parametrize("truth", ["2", "-1", "01", "10", ""])
def test_truth_is_zero_or_one(tmp_path, blocks, truth):
    rows = [f"{ROW},1"] * 16
    rows[10] = f"{ROW},{truth}"
    _refused(_write(tmp_path, rows), 11, f"truth is '{truth}'; expected 0 or 1")


def test_two_truths_for_one_query(tmp_path, blocks):
    rows = [f"{ROW},1"] * 8 + [f"{ROW},0"] * 8
    assert datasets.read_queries(_write(tmp_path, rows)).truth.tolist() == [True, False]
    rows[13] = f"{ROW},1"
    _refused(_write(tmp_path, rows), 14, "truth is 1 and 0 on line 9; expected one truth on the 8 rows of a query")


def test_binary_file_is_refused(tmp_path):
    path = tmp_path / "vf.csv"
    path.write_bytes(bytes(range(256)) * 10)
    with pytest.raises(ValueError, match=r"vf\.csv, line 1 has \d+ columns"):
        datasets.read_queries(path)


@pytest.mark.parametrize("progress", [False, True])
def test_missing_file(tmp_path, progress):
    if progress:
        pytest.importorskip("tqdm")
    with pytest.raises(FileNotFoundError, match=r"0vf\.csv"):
        datasets.read_queries(tmp_path / "0vf.csv", progress=progress)


# ---- Progress --------------------------------------------------------------------------------------------------------


def test_progress_counts_every_byte_on_stderr(tmp_path, capsys):
    pytest.importorskip("tqdm")
    path = _write(tmp_path, QUERY * 20, end="\r\n")
    assert len(datasets.read_queries(path, progress=True)) == 20
    shown = capsys.readouterr()
    assert shown.out == "" and "100%" in shown.err and "queries" in shown.err
    datasets.read_queries(path)
    assert capsys.readouterr().err == ""


def test_progress_without_tqdm_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    path = _write(tmp_path, QUERY)
    assert len(datasets.read_queries(path)) == 1
    for read in (
        lambda: datasets.read_queries(path, progress=True),
        lambda: datasets.find_queries(tmp_path, progress=True),
    ):
        with pytest.raises(ImportError, match=r"pip install 'ccd-warp\[bench\]'") as error:
            read()
        assert "\n" not in str(error.value)


def test_import_is_light():
    code = "import sys; sys.modules['warp'] = None; sys.path.insert(0, sys.argv[1])"
    code += "; import types; package = types.ModuleType('ccd_warp'); package.__path__ = [sys.argv[2]]"
    code += "; sys.modules['ccd_warp'] = package; import ccd_warp.datasets; print('trimesh' in sys.modules)"
    folder = os.path.dirname(os.path.dirname(datasets.__file__))
    command = [sys.executable, "-c", code, os.path.dirname(folder), folder]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "False\n"


# ---- Writing ---------------------------------------------------------------------------------------------------------


def _bad(value):
    points = np.zeros((3, 4, 3))
    points[1, 2, 0] = value
    return points


@pytest.mark.parametrize(
    "start, end, truth, message",
    [
        (_bad(np.nan), _bad(0), None, r"points_t0\[1, 2, 0\] is nan; expected finite coordinates"),
        (_bad(0), _bad(-np.inf), None, r"points_t1\[1, 2, 0\] is -inf; expected finite coordinates"),
        (
            _bad(0)[:, :3],
            _bad(0),
            None,
            r"points_t0 is float64 of shape \(3, 3, 3\); expected float64 of shape \(n, 4, 3\)",
        ),
        (_bad(0).astype(np.float32), _bad(0), None, "points_t0 is float32"),
        (_bad(0), _bad(0)[1:], None, r"points_t1 has shape \(2, 4, 3\); expected \(3, 4, 3\) like points_t0"),
        (_bad(0), _bad(0), np.ones(2, bool), r"truth is bool of shape \(2,\); expected bool of shape \(3,\)"),
        (_bad(0), _bad(0), np.ones(3), "truth is float64"),
    ],
)
def test_bad_queries_are_not_written(tmp_path, start, end, truth, message):
    path = _write(tmp_path, QUERY)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=message):
        datasets.write_queries(path, start, end, truth)
    assert path.read_bytes() == before and os.listdir(tmp_path) == [path.name]


def test_write_that_fails_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    path = _write(tmp_path, QUERY)
    before = path.read_bytes()
    monkeypatch.setattr(_csv, "_QUERIES", 1)
    with pytest.raises(OverflowError):  # at the second query, the first being written
        _csv.write_csv(path, _bad(np.inf), _bad(0), None)
    assert path.read_bytes() == before and os.listdir(tmp_path) == [path.name]
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(OSError, match=r"folder\.csv"):
        datasets.write_queries(tmp_path / "folder.csv", _bad(0), _bad(0))
    with pytest.raises(FileNotFoundError, match="nowhere"):
        datasets.write_queries(tmp_path / "nowhere" / "ee.csv", _bad(0), _bad(0))
    assert sorted(os.listdir(tmp_path)) == [path.name, "folder.csv"]


# ---- Sets ------------------------------------------------------------------------------------------------------------


def _set(label, n, kind="edge-edge", truth=True):
    known = np.arange(n) % 2 == 0 if truth else None
    return datasets.Queries(label, kind, _points(n), _points(n, seed=1), known, ((label, n),))


def test_joined_sets_keep_their_order_and_ids():
    parts = [_set("a", 2), _set("b", 0, truth=False), _set("c", 3)]
    whole = datasets.Queries.joined("all", parts)
    assert whole.name == "all" and whole.kind == "edge-edge" and len(whole) == 5
    assert [whole.id(i) for i in range(5)] == ["a:0", "a:1", "c:0", "c:1", "c:2"]
    assert _same_bits(whole.points_t0, np.concatenate([part.points_t0 for part in parts]))
    assert _same_bits(whole.points_t1, np.concatenate([part.points_t1 for part in parts]))
    assert whole.truth.tolist() == [True, False, True, False, True]
    assert whole.sources == (("a", 2), ("b", 0), ("c", 3))


def test_sets_that_do_not_join():
    with pytest.raises(ValueError, match=r"parts of x are of the kinds \['edge-edge', 'vertex-face'\]; expected one"):
        datasets.Queries.joined("x", [_set("a", 1), _set("b", 1, "vertex-face")])
    with pytest.raises(ValueError, match=r"parts of x are of the kinds \[\]; expected one or more parts"):
        datasets.Queries.joined("x", [])
    with pytest.raises(
        ValueError, match="parts of x: the truth of b is not known, that of others is; expected it of all"
    ):
        datasets.Queries.joined("x", [_set("a", 1), _set("b", 1, truth=False)])
    assert datasets.Queries.joined("x", [_set("a", 1, truth=False)] * 2).truth is None


def test_sources_count_every_query():
    with pytest.raises(ValueError, match="sources count 2 queries; expected 3 like points_t0"):
        datasets.Queries("x", "edge-edge", _points(3), _points(3), None, (("a", 2),))
    with pytest.raises(ValueError, match="kind is 'ee'; expected 'vertex-face' or 'edge-edge'"):
        datasets.Queries("x", "ee", _points(3), _points(3), None, (("a", 3),))


# ---- Truth and boxes -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("truth", [[], [True], [False, True, True]])
def test_truth_comes_back(tmp_path, truth):
    path = tmp_path / "227ee_mma_bool.json"
    datasets.write_truth(path, np.array(truth, dtype=bool))
    read = datasets.read_truth(path)
    assert read.tolist() == truth and read.dtype == np.bool_ and os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("ids", [[], [[0, 1]], [[15739, 15746], [3, 2**63 - 1]]])
def test_boxes_come_back(tmp_path, ids):
    path = tmp_path / "227ee.json"
    datasets.write_boxes(path, np.array(ids, dtype=np.int64).reshape(-1, 2))
    read = datasets.read_boxes(str(path))
    assert read.tolist() == ids and read.shape == (len(ids), 2) and read.dtype == np.int64


@pytest.mark.parametrize("read", [datasets.read_truth, datasets.read_boxes])
@pytest.mark.parametrize(
    "content, message",
    [
        (b"", ", line 1: .*; expected a JSON list"),
        (b"[\ntrue,\nfalse", ", line 3: .*; expected a JSON list"),
        (b"true", " holds true; expected a JSON list"),
        (b'{"a": 1}', ' holds {"a": 1}; expected a JSON list'),
        (b"[nan]", ", line 1: "),
        (b'["\xff"]', r" cannot be read as JSON \(.*\); expected a JSON list"),
        (b"[" * 200_000, " cannot be read as JSON"),
        (b"[1]", ": entry 0 is 1; expected t"),
        (b"[[1, 2, 3]]", r": entry 0 is \[1, 2, 3\]; expected t"),
        (b"[[true, false]]", r": entry 0 is \[true, false\]; expected t"),
        (b"[null]", ": entry 0 is null; expected t"),
    ],
)
def test_malformed_list(tmp_path, read, content, message):
    path = tmp_path / "0ee.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=re.escape(str(path)) + message):
        read(path)


@pytest.mark.parametrize("pair", ["[-1, 2]", "[1.0, 2]", "[1]", '["1", 2]', str([1, 2**63]), "true"])
def test_boxes_are_pairs_of_ids(tmp_path, pair):
    path = tmp_path / "0ee.json"
    path.write_text(f"[[1, 2], {pair}]")
    with pytest.raises(ValueError, match=re.escape(f"{path}: entry 1 is {pair}; expected two ids, integers from 0")):
        datasets.read_boxes(path)


def test_bad_truth_and_boxes_are_not_written(tmp_path):
    for truth in (np.ones(3), np.ones((2, 2), bool)):
        with pytest.raises(ValueError, match=r"truth is .*; expected bool of shape \(n,\)"):
            datasets.write_truth(tmp_path / "x.json", truth)
    for ids in (np.ones((3, 2)), np.ones(3, int), np.ones((2, 3), int)):
        with pytest.raises(ValueError, match=r"ids is .*; expected integers of shape \(n, 2\)"):
            datasets.write_boxes(tmp_path / "x.json", ids)
    with pytest.raises(ValueError, match="ids holds -1; expected integers from 0"):
        datasets.write_boxes(tmp_path / "x.json", np.array([[0, -1]]))
    assert os.listdir(tmp_path) == []


def test_truth_beside_the_queries(tmp_path):
    path, truth = _write(tmp_path, QUERY * 2, "queries/0ee.csv"), tmp_path / "mma_bool" / "0ee_mma_bool.json"
    truth.parent.mkdir()
    datasets.write_truth(truth, np.array([False, True]))
    assert datasets.read_queries(path).truth is None
    assert datasets.read_queries(path, truth=str(truth)).truth.tolist() == [False, True]
    datasets.write_truth(truth, np.array([False]))
    with pytest.raises(ValueError, match=r"0ee_mma_bool\.json has 1 truths; expected 2, one a query of .*0ee\.csv"):
        datasets.read_queries(path, truth=truth)
    _write(tmp_path, [f"{ROW},1"] * 8, "queries/0ee.csv")
    with pytest.raises(ValueError, match=r"0ee\.csv has 7 columns, the truth among them; expected 6"):
        datasets.read_queries(path, truth=truth)


def test_edges_are_sorted_by_their_larger_vertex():
    faces = np.array([[3, 1, 0], [0, 1, 2], [4, 2, 1]])
    assert datasets.edges_by_max(faces).tolist() == [[0, 1], [0, 2], [1, 2], [0, 3], [1, 3], [1, 4], [2, 4]]


def test_edges_of_faces_with_a_repeated_vertex_are_those_of_the_mesh():
    faces = np.array([[0, 0, 1], [2, 2, 2], [1, 3, 2]])
    edges = datasets.edges_by_max(faces)
    assert edges.tolist() == [[0, 1], [1, 2], [1, 3], [2, 3]]
    mesh = ccd.CollisionMesh.from_arrays([(np.eye(4, 3), faces)])
    assert np.array_equal(edges, mesh.edges)


@pytest.mark.parametrize(
    ("index", "dtype"), [(2**63 - 2, np.int64), (2**64 - 2, np.uint64), (-2, np.int8), (254, np.uint8)]
)
def test_edges_of_any_integers_are_exact(index, dtype):
    faces = np.array([[index + 1, 0, index]], dtype=dtype)
    edges = datasets.edges_by_max(faces)
    assert edges.dtype == dtype
    ends = sorted(map(int, faces[0]))
    assert edges.tolist() == [[ends[0], ends[1]], [ends[0], ends[2]], [ends[1], ends[2]]]


# ---- Folders ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def tree(tmp_path):
    """A root in both layouts; every query of a file has the file's number as its first coordinate."""

    def rows(number, count, truth=""):
        return [f"{number},1,0,1,0,1{truth}"] * 8 * count

    root = tmp_path / "data"
    _write(root, rows(0, 1, ",1"), "handcrafted/spikes/edge-edge/data_0.csv")
    _write(root, rows(1, 2, ",0"), "handcrafted/spikes/edge-edge/data_1.csv")
    _write(root, rows(2, 1, ",0"), "handcrafted/spikes/vertex-face/data_0.csv")
    _write(root, rows(3, 1, ",1"), "handcrafted/boxes/vertex-face/data_0.csv")
    _write(root, rows(4, 2), "simulation/cloth/queries/7ee.csv")
    _write(root, rows(5, 1), "simulation/cloth/queries/7vf.csv")
    _write(root, rows(6, 1), "simulation/rod/queries/9vf.csv")
    for name, truth in (("7ee", [True, False]), ("7vf", [True])):
        path = root / f"simulation/cloth/mma_bool/{name}_mma_bool.json"
        path.parent.mkdir(exist_ok=True)
        datasets.write_truth(path, np.array(truth))
        _write(root, ["[]"], f"simulation/cloth/boxes/{name}.json")
    for name in ("cloth/frames/7.ply", "cloth/frames/8.ply", "rod/frames/10.ply", "rod/frames/9.ply"):
        _write(root, ["ply"], f"simulation/{name}")
    _write(root, ["notes"], "README.md")
    return root


def _summary(folder, **options):
    return [
        (
            queries.name,
            queries.kind,
            queries.points_t0[:, 0, 0].tolist(),
            None if queries.truth is None else queries.truth.tolist(),
        )
        for queries in datasets.find_queries(folder, **options)
    ]


def test_queries_under_the_root(tree):
    found = _summary(tree)
    assert found == [
        ("handcrafted/boxes", "vertex-face", [3], [True]),
        ("handcrafted/spikes", "vertex-face", [2], [False]),
        ("handcrafted/spikes", "edge-edge", [0, 1, 1], [True, False, False]),
        ("simulation/cloth", "vertex-face", [5], [True]),
        ("simulation/cloth", "edge-edge", [4, 4], [True, False]),
        ("simulation/rod", "vertex-face", [6], None),
    ]
    spikes = datasets.find_queries(str(tree))[2]
    assert spikes.sources == (
        ("handcrafted/spikes/edge-edge/data_0.csv", 1),
        ("handcrafted/spikes/edge-edge/data_1.csv", 2),
    )
    assert spikes.id(2) == "handcrafted/spikes/edge-edge/data_1.csv:1"


@pytest.mark.parametrize(
    "folder, names",
    [
        ("handcrafted", ["boxes", "spikes", "spikes"]),
        ("simulation", ["cloth", "cloth", "rod"]),
        ("handcrafted/spikes", ["spikes", "spikes"]),
        ("handcrafted/spikes/edge-edge", ["spikes"]),
        ("simulation/cloth", ["cloth", "cloth"]),
        ("simulation/cloth/queries", ["cloth", "cloth"]),
        ("simulation/rod", ["rod"]),
    ],
)
def test_queries_under_a_part(tree, monkeypatch, folder, names):
    found = datasets.find_queries(tree / folder)
    assert [queries.name for queries in found] == names
    numbers = {queries.name: queries.points_t0[0, 0, 0] for queries in found}
    whole = {name.split("/")[-1]: values[0] for name, _, values, _ in _summary(tree)}
    assert all(whole[name] == number for name, number in numbers.items())
    assert all((queries.truth is None) == (queries.name == "rod") for queries in found)
    assert all((tree / folder / label).is_file() for queries in found for label, _ in queries.sources)
    monkeypatch.chdir(tree / folder)
    assert [queries.name for queries in datasets.find_queries(".")] == names


def test_handcrafted_comes_first_whatever_its_name(tmp_path):
    _write(tmp_path, QUERY, "a/queries/0ee.csv")
    _write(tmp_path, QUERY, "z/edge-edge/0.csv")
    _write(tmp_path, QUERY, "1vf.csv")
    assert [name for name, *_ in _summary(tmp_path)] == ["z", "a", tmp_path.name]


def test_files_without_a_scene_folder(tmp_path):
    _write(tmp_path, ["0,1,0,1,0,1"] * 8, "0ee.csv")
    _write(tmp_path, ["1,1,0,1,0,1"] * 8, "1ee.csv")
    assert _summary(tmp_path) == [(tmp_path.name, "edge-edge", [0, 1], None)]
    _write(tmp_path, QUERY, "data.csv")
    with pytest.raises(ValueError, match=r"data\.csv: neither its folder"):
        datasets.find_queries(tmp_path)


def test_folder_without_queries_says_what_was_looked_for(tmp_path):
    with pytest.raises(ValueError, match=r"holds no queries; looked for \*\.csv in it, and SCENE/edge-edge/\*\.csv"):
        datasets.find_queries(tmp_path)
    for find in (datasets.find_queries, datasets.find_steps):
        with pytest.raises(ValueError, match="nowhere is not a folder; expected the public data"):
            find(tmp_path / "nowhere")
        with pytest.raises(ValueError, match=r"vf\.csv is not a folder"):
            find(_write(tmp_path, QUERY))


def test_one_malformed_file_stops_all(tree):
    path = _write(tree, [*QUERY, "1,2,3,4,5,0"], "simulation/cloth/queries/7vf.csv")
    with pytest.raises(ValueError, match=re.escape(f"{path}, line 9: denominator is 0")):
        datasets.find_queries(tree)


def test_truth_of_some_files_is_no_truth_of_a_scene(tree):
    _write(tree, QUERY, "simulation/cloth/queries/8vf.csv")
    with pytest.raises(ValueError, match=r"parts of simulation/cloth: the truth of simulation/cloth/queries/8vf\.csv"):
        datasets.find_queries(tree)


def test_progress_of_a_folder_is_one_bar(tree, capsys):
    pytest.importorskip("tqdm")
    assert _summary(tree, progress=True) == _summary(tree)
    shown = capsys.readouterr()
    assert shown.out == "" and "100%" in shown.err and shown.err.count("\n") == 1


@requires_data
def test_published_queries_are_found():
    found = datasets.find_queries(DATA)
    assert {(queries.name, queries.kind) for queries in found} >= {
        ("handcrafted/unit-tests", "vertex-face"),
        ("handcrafted/erleben-spikes", "edge-edge"),
        ("simulation/rod-twist", "edge-edge"),
    }
    files = [label for queries in found for label, _ in queries.sources]
    assert len(files) == len(set(files)) == len(list(DATA.rglob("*.csv")))
    assert all(queries.truth is not None and len(queries) > 0 for queries in found)


# ---- Frames ----------------------------------------------------------------------------------------------------------


def _step():
    vertices = np.resize(EXTREMES, (5, 3))
    return datasets.SimulationStep(vertices, vertices[::-1].copy(), np.array([[0, 1, 2], [4, 2, 1]], dtype=np.int32))


def test_step_comes_back(tmp_path):
    step = _step()
    paths = tmp_path / "7.ply", tmp_path / "8.ply"
    datasets.write_step(*paths, step)
    read = datasets.read_step(*map(str, paths))
    assert _same_bits(read.vertices_t0, step.vertices_t0) and _same_bits(read.vertices_t1, step.vertices_t1)
    assert np.array_equal(read.faces, step.faces) and read.faces.dtype == np.int32
    assert sorted(os.listdir(tmp_path)) == ["7.ply", "8.ply"]


def test_frames_of_different_meshes_are_refused(tmp_path):
    step = _step()
    other = datasets.SimulationStep(step.vertices_t0, step.vertices_t1, step.faces[:, ::-1].copy())
    datasets.write_step(tmp_path / "7.ply", tmp_path / "8.ply", step)
    datasets.write_step(tmp_path / "9.ply", tmp_path / "10.ply", other)
    with pytest.raises(ValueError, match=r"topology differs: face 0 is \[0, 1, 2\] in .*7\.ply and \[2, 1, 0\] in"):
        datasets.read_step(tmp_path / "7.ply", tmp_path / "10.ply")
    with pytest.raises(ValueError, match=r"11\.ply: no such file"):
        datasets.read_step(tmp_path / "7.ply", tmp_path / "11.ply")
    (tmp_path / "8.ply").write_bytes((tmp_path / "8.ply").read_bytes()[:-3])
    with pytest.raises(ValueError, match=r"8\.ply: holds 1 rows of the element 'face', and its header says 2"):
        datasets.read_step(tmp_path / "7.ply", tmp_path / "8.ply")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"vertices_t1": np.zeros((4, 3))}, r"vertices_t1 has shape \(4, 3\); expected \(5, 3\)"),
        ({"vertices_t0": np.full((5, 3), np.nan)}, r"vertices_t0\[0\] is \[nan, nan, nan\]; expected finite positions"),
        ({"faces": np.zeros((0, 3), np.int32)}, r"faces has shape \(0, 3\); expected \(F, 3\) with one face or more"),
        ({"faces": np.array([[0, 1, 5]])}, "faces holds indices from 0 to 5; expected 0 to 4"),
        ({"faces": np.array([[0, 1, -1]])}, "faces holds indices from -1 to 1; expected 0 to 4"),
    ],
)
def test_bad_step_is_not_written(tmp_path, change, message):
    step = datasets.SimulationStep(**{**vars(_step()), **change})
    with pytest.raises(ValueError, match=message):
        datasets.write_step(tmp_path / "7.ply", tmp_path / "8.ply", step)
    with pytest.raises(ValueError, match=r"end_path is .*8\.obj; expected a name that ends in \.ply"):
        datasets.write_step(tmp_path / "7.ply", tmp_path / "8.obj", _step())
    assert os.listdir(tmp_path) == []


def test_steps_are_found_in_the_order_of_their_frames(tree):
    frames = {name: [path.name for path in paths] for name, paths in datasets.find_steps(tree).items()}
    assert frames == {"simulation/cloth": ["7.ply", "8.ply"], "simulation/rod": ["9.ply", "10.ply"]}
    assert list(datasets.find_steps(tree / "simulation")) == ["cloth", "rod"]
    assert list(datasets.find_steps(str(tree / "simulation" / "rod"))) == ["rod"]
    assert datasets.find_steps(tree / "handcrafted") == {}


@pytest.mark.parametrize("name", ["11.ply", "end.ply"])
def test_scene_has_two_numbered_frames(tree, name):
    frames = tree / "simulation" / "rod" / "frames"
    (frames / "10.ply").rename(frames / name)
    if name == "11.ply":
        _write(frames, ["ply"], "12.ply")
    with pytest.raises(ValueError, match=r"frames holds .*; expected two frames named by numbers, such as 1\.ply"):
        datasets.find_steps(tree)


@requires_data
def test_published_steps_come_back(tmp_path):
    for start, end in datasets.find_steps(DATA).values():
        step = datasets.read_step(start, end)
        datasets.write_step(tmp_path / "0.ply", tmp_path / "1.ply", step)
        again = datasets.read_step(tmp_path / "0.ply", tmp_path / "1.ply")
        assert _same_bits(again.vertices_t0, step.vertices_t0) and _same_bits(again.vertices_t1, step.vertices_t1)
        assert np.array_equal(again.faces, step.faces)
