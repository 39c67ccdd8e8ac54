"""The public data comes in and goes out exactly, or not at all and with the line that is to blame."""

import os
import re
from contextlib import nullcontext
from fractions import Fraction
from random import Random

import numpy as np
import pytest
from published import DATA, requires_data

import ccd_warp as ccd
from ccd_warp import datasets

ROW = "1,2,-3,4,0,1"
QUERY = [ROW] * 8
# Each of them in the last place of something: the ends of float64, of its subnormals, of its integers.
TINY, LARGEST = 2.0**-1074, np.finfo(np.float64).max
EXTREMES = [TINY, -3 * TINY, np.nextafter(2.0**-1022, 0), 2.0**-1022, np.nextafter(2.0**-1021, 1), 1 / 3]
EXTREMES += [-np.pi * 2.0**-60]  # a denominator of 112 bits
EXTREMES += [2.0**53 - 1, 2.0**53, 2.0**53 + 2, -(2.0**64), 1e300, LARGEST, -LARGEST, 0.0]


def _write(folder, rows, name="0vf.csv", end="\n"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(rows if isinstance(rows, bytes) else "".join(row + end for row in rows).encode())
    return path


def _points(n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n, 4, 3)) * 2.0 ** rng.integers(-80, 80, (n, 4, 3))


def _same_bits(a, b):
    return a.shape == b.shape and a.dtype == b.dtype == np.float64 and a.tobytes() == b.tobytes()


def _refused(path, line, message):
    with pytest.raises(ValueError, match=re.escape(f"{path}, line {line}") + f"[ :]+{message}"):
        datasets.read_queries(path)


@pytest.fixture(params=["one block", "a line a block"])
def blocks(request, monkeypatch):
    """Both ways to cut a file: what is between blocks must not show."""
    monkeypatch.setattr("ccd_warp.datasets._csv._QUERIES", 2)
    if request.param == "a line a block":
        monkeypatch.setattr("ccd_warp.datasets._csv._BLOCK", 1)


# ---- Queries out and in ----------------------------------------------------------------------------------------------


def test_any_finite_query_comes_back_and_zero_loses_its_sign(tmp_path):
    """Of numbers of any bits, and of extremes; 0.0 is added, which takes the sign from a zero."""
    rng, shape = np.random.default_rng(0), (300, 8, 3)
    bits = np.ldexp(rng.integers(0, 2**64, shape, dtype=np.uint64).view(np.float64), rng.integers(-99, 99, (300, 1, 1)))
    points = np.where(np.isfinite(bits) & (rng.random(shape) < 0.8), bits, rng.choice([*EXTREMES, -0.0], shape))
    truth, path = rng.random(300) < 0.5, tmp_path / "ee.csv"
    datasets.write_queries(path, points[:, :4], points[:, 4:], truth)
    read = datasets.read_queries(path)
    assert _same_bits(np.concatenate([read.points_t0, read.points_t1], axis=1), points + 0.0)
    assert np.array_equal(read.truth, truth)


def test_a_rational_is_exact_or_refused(tmp_path):
    draw, outcomes = Random(0), set()
    for _ in range(150):
        n, k = draw.randint(-(2**60), 2**60) >> draw.randint(0, 60), draw.randint(0, draw.choice([60, 1200]))
        factor = draw.randint(1, 10 ** draw.randint(0, 30))
        path, fraction = _write(tmp_path, [f"1,2,0,1,{n * factor},{factor << k}"] * 8), Fraction(n, 1 << k)
        outcomes.add(is_exact := Fraction(float(fraction)) == fraction)
        if is_exact:
            assert Fraction(datasets.read_queries(path).points_t1[0, 3, 2]) == fraction
        else:
            _refused(path, 1, ".* is not a float64")
    assert len(outcomes) == 2


def test_numbers_of_millions_of_digits_are_refused_at_once(tmp_path):
    for rational in ("{0},1", "-1,{0}", "{0},{0}"):
        rows = [*QUERY[:3], f"1,2,{rational.format('7' * 10_000_000)},5,8", *QUERY[4:]]
        _refused(_write(tmp_path, rows), 4, ".* is too long; expected an integer of at most 10,000")


@requires_data
@pytest.mark.parametrize("path", sorted(DATA.glob("*/*/*/*.csv")), ids=lambda path: "/".join(path.parts[-3:]))
def test_published_queries_are_the_fractions_of_the_file_and_are_written_byte_for_byte(tmp_path, path):
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
    if path.name in ("data_0_0.csv", "227ee.csv"):  # of others, fractions are not in lowest terms
        datasets.write_queries(tmp_path / "copy.csv", queries.points_t0, queries.points_t1, queries.truth)
        published = path.read_bytes().replace(b"\r\n", b"\n").rstrip(b"\n") + b"\n"
        assert (tmp_path / "copy.csv").read_bytes() == published


@pytest.mark.parametrize("truth", [None, np.array([True, False])])
def test_queries_cut_at_any_byte_are_refused_or_fewer_whole_queries(tmp_path, truth):
    points, path = _points(2), tmp_path / "vf.csv"
    datasets.write_queries(path, points, points + 1.0, truth)
    data = path.read_bytes()
    # The last denominator: a power of two that was cut may be one again, and published files end without a line end.
    ends = [len(b"".join(data.splitlines(keepends=True)[: 8 * n])) for n in (1, 2)]
    open_to = [range(data.rindex(b",", 0, end) + 1, end - 1) if truth is None else range(0) for end in ends]
    for length in range(len(data)):
        try:
            queries = datasets.read_queries(_write(tmp_path, data[:length], "vf.csv"))
        except ValueError:
            continue
        assert len(queries) in (0, 1, 2)
        if not any(length in lengths for lengths in open_to):
            assert np.array_equal(queries.points_t1, points[: len(queries)] + 1.0)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("tail", ["", "\n", "\n\n\n"])  # the last of them in blocks of their own
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("space", ["", "   "])  # after commas, as ccd_query_io writes them
def test_rows_are_the_points_of_both_frames_in_order_in_any_dress(tmp_path, blocks, end, tail, mark, space):
    rows = [f"{i},1,{i},2,{-i},4,1".replace(",", f",{space}") for i in range(16)]
    tail = tail.replace("\n", end).encode()
    read = datasets.read_queries(_write(tmp_path, mark + end.join(rows).encode() + tail))
    expected = np.outer(range(16), [1.0, 0.5, -0.25]).reshape(2, 2, 4, 3) + 0.0
    assert _same_bits(read.points_t0, expected[:, 0].copy()) and _same_bits(read.points_t1, expected[:, 1].copy())
    assert read.truth.tolist() == [True, True] and len(datasets.read_queries(_write(tmp_path, mark + tail))) == 0
    assert (read.name, read.kind, read.sources) == ("0vf", "vertex-face", (("0vf.csv", 2),)) and read.id(
        -1
    ) == "0vf.csv:1"


def test_kinds_are_those_of_places_or_given_and_what_is_joined_is_of_one(tmp_path):
    places = ("vertex-face/ree.csv", "edge-edge/0.csv", "7ee.csv")
    read = [datasets.read_queries(path := _write(tmp_path, QUERY, name)) for name in places]
    assert [queries.kind for queries in read] == ["vertex-face", "edge-edge", "edge-edge"]
    for kind in (ccd.PairKind.VERTEX_FACE, "vertex_face", "vertex-face"):
        assert datasets.read_queries(str(path), kind=kind).kind == "vertex-face"
    with pytest.raises(ValueError, match=r"data\.csv: neither its folder .* says the kind .* kind= of read_queries"):
        datasets.read_queries(_write(tmp_path, QUERY, "data.csv"))
    with pytest.raises(ValueError, match=r"of the kinds \['edge-edge', 'vertex-face'\]; expected one"):
        datasets.Queries.joined("x", read)


# ---- Malformed -------------------------------------------------------------------------------------------------------

NO_INTEGERS = ["5.0", "nan", "+5", "1_0", " ", "\t5", "\r5", "٣", "", "-", "--5", "5-", "5 "]
MALFORMED = [(f"1,2,3,4,{field},8", f"{re.escape(repr(field))} is not an integer") for field in NO_INTEGERS] + [
    ("", "is empty; expected 6 integers"),
    ("1,2,3,4,5,8,1", "has 7 columns; expected 6 as on line 1"),
    ("1,2,3,4,5,0", "denominator is 0; expected a positive integer"),
    ("1,2,3,4,5,-8", "denominator is -8; expected a positive integer"),
    (f"{2**53 + 1},2,3,4,5,8", f"{2**53 + 1}/2 is not a float64"),
    (f"1,2,3,4,1,{2**1075}", r"1/4048045066146212\.\.\.\S+ \(324 characters\) is not"),
    (f"1,2,{2**1024 - 2**970},1,5,8", ".* is not a float64; expected a coordinate of at most 1.8e308"),
    (f"1,2,{2**1024 - 2**970 - 1},1,5,8", ".* is not a float64; expected a rational"),
]


@pytest.mark.parametrize("at", [1, 6, 16])
@pytest.mark.parametrize("row, message", MALFORMED)
def test_malformed_line_is_named(tmp_path, blocks, row, message, at):
    rows = [ROW] * (16 if row else 24)  # at the end of the file, an empty line would be its end
    rows[at - 1] = row
    if at == 1 and "columns" in message:  # the first line says how many there are
        at, message = (2, "has 6 columns; expected 7") if row.count(",") == 6 else (1, "has 5 columns; expected 6")
    _refused(_write(tmp_path, rows), at, message)


@pytest.mark.parametrize(
    "rows, line, message",
    [
        # Lines too short and too long by one do not make up for each other.
        ([*QUERY[:3], "1,2,3,4,5", "1,2,3,4,5,8,1", *QUERY[5:]], 4, "has 5 columns; expected 6 as on line 1"),
        (["xn,xd,yn,yd,zn,zd,truth", *QUERY], 1, "'xn' is not an integer"),
        ([ROW] * 7, 7, "the file ends after 7 rows; expected a multiple of 8, 8 a query"),
        ([f"{ROW},1"] * 10 + [f"{ROW},01"] * 6, 11, "truth is '01'; expected 0 or 1"),
        ([f"{ROW},{int(k != 13)}" for k in range(16)], 14, "truth is 0 and 1 on line 9; expected one truth on the 8"),
    ],
)
def test_rows_that_are_no_queries_are_refused(tmp_path, blocks, rows, line, message):
    _refused(_write(tmp_path, rows), line, message)


# ---- Sets, truth, boxes, steps ---------------------------------------------------------------------------------------

STEP = datasets.SimulationStep(
    *(np.resize(EXTREMES, (5, 3))[::k].copy() for k in (1, -1)), np.array([[0, 1, 2], [4, 2, 1]], dtype=np.int32)
)


def test_steps_come_back(tmp_path):
    paths = [tmp_path / "7.ply", tmp_path / "8.ply"]
    published = datasets.find_steps(DATA).values() if DATA.is_dir() else ()
    for step in (STEP, *(datasets.read_step(*frames) for frames in published)):
        datasets.write_step(*paths, step)
        read = datasets.read_step(*map(str, paths))
        assert _same_bits(read.vertices_t0, step.vertices_t0) and _same_bits(read.vertices_t1, step.vertices_t1)
        assert np.array_equal(read.faces, step.faces) and read.faces.dtype == np.int32
        assert sorted(os.listdir(tmp_path)) == ["7.ply", "8.ply"]
    faces = np.array([[3, 1, 0], [0, 1, 2], [4, 2, 1], [0, 0, 1]])  # the last repeats a vertex
    assert datasets.edges_by_max(faces).tolist() == [[0, 1], [0, 2], [1, 2], [0, 3], [1, 3], [1, 4], [2, 4]]


ZERO = np.zeros((3, 4, 3))
BAD = np.where(np.arange(36).reshape(3, 4, 3) == 18, np.nan, 0.0)


@pytest.mark.parametrize(
    "write, given, message",
    [
        ("queries", (BAD, ZERO), r"points_t0\[1, 2, 0\] is nan; expected finite coordinates"),
        ("step", ("vf.ply", STEP), r"end_path is .*vf\.ply, as start_path is; expected another file"),
        ("step", ("x/../vf.ply", STEP), r"end_path is .*x/\.\./vf\.ply, as start_path is; expected another file"),
    ],
)
def test_what_is_no_data_is_not_written(tmp_path, write, given, message):
    path = _write(tmp_path, QUERY, "vf.ply")
    given = [tmp_path / each if isinstance(each, str) else each for each in given]
    with pytest.raises(ValueError, match=message):
        getattr(datasets, f"write_{write}")(path, *given)
    assert path.read_text() == f"{ROW}\n" * 8 and os.listdir(tmp_path) == [path.name]


LISTS = {
    "truth": [np.array(each, bool) for each in ([], [True], [False, True, True])],
    "boxes": [np.array(each).reshape(-1, 2) for each in (np.zeros(0, int), [[0, 1]], [[15739, 15746], [3, 2**63 - 1]])],
}
OF_BOTH = [
    (b"[\ntrue,\nfalse", ", line 3: .*; expected a JSON list"),
    (b'{"a": 1}', ' holds {"a": 1}; expected a JSON list'),
    (b'["\xff"]', r" cannot be read as JSON \(.*\); expected a JSON list"),
    (b"[" * 200_000, " cannot be read as JSON"),
    *((f"[{each}]".encode(), re.escape(f": entry 0 is {each}; expected t")) for each in ("1", "[1, 2, 3]", "null")),
]
OF_BOXES = [
    (f"[[1, 2], {pair}]".encode(), re.escape(f": entry 1 is {pair}; expected two ids, integers from 0"))
    for pair in ("[-1, 2]", "[1.0, 2]", str([1, 2**63]), "[true, false]")
]


@pytest.mark.parametrize("name", LISTS)
def test_truth_and_boxes_come_back_whole_or_not_at_all(tmp_path, name):
    write, read = (getattr(datasets, f"{verb}_{name}") for verb in ("write", "read"))
    path = tmp_path / "227ee.json"
    for values in LISTS[name]:
        write(path, values)
        found, data = read(str(path)), path.read_bytes()
        assert np.array_equal(found, values) and found.dtype == values.dtype and found.shape == values.shape
        for damaged, message in [(data[:n], "") for n in range(len(data))] + OF_BOTH + OF_BOXES * (name == "boxes"):
            path.write_bytes(damaged)
            with pytest.raises(ValueError, match=re.escape(str(path)) + message):
                read(path)


# ---- Folders ---------------------------------------------------------------------------------------------------------


OF_CLOTH = "simulation/cloth/mma_bool/7ee_mma_bool.json"


def test_queries_and_steps_under_the_root_and_under_each_part_of_it(tmp_path):
    """In both layouts; every query of a file has the file's number as its first coordinate."""
    for number, (name, count, truth) in enumerate(
        [
            ("handcrafted/spikes/edge-edge/data_0.csv", 1, ",1"),
            ("handcrafted/spikes/edge-edge/data_1.csv", 2, ",0"),
            ("handcrafted/spikes/vertex-face/data_0.csv", 1, ",0"),
            ("simulation/cloth/queries/7ee.csv", 2, ""),
            ("simulation/rod/queries/9vf.csv", 1, ""),
        ]
    ):
        _write(tmp_path, [f"{number},1,0,1,0,1{truth}"] * 8 * count, name)
    _write(tmp_path, ["[true, false]"], OF_CLOTH)
    for name in ("cloth/frames/7", "cloth/frames/8", "rod/frames/10", "rod/frames/9"):
        _write(tmp_path, ["ply"], f"simulation/{name}.ply")
    _write(tmp_path, ["notes"], "README.md")

    def rows(folder):
        given = [(q, q.points_t0[:, 0, 0].tolist()) for q in datasets.find_queries(folder)]
        return [(q.name, q.kind, of, None if q.truth is None else q.truth.tolist()) for q, of in given]

    found = rows(tmp_path)
    assert found == [
        ("handcrafted/spikes", "vertex-face", [2], [False]),
        ("handcrafted/spikes", "edge-edge", [0, 1, 1], [True, False, False]),
        ("simulation/cloth", "edge-edge", [3, 3], [True, False]),
        ("simulation/rod", "vertex-face", [4], None),
    ]
    spikes = datasets.find_queries(str(tmp_path))[1]
    assert spikes.id(2) == "handcrafted/spikes/edge-edge/data_1.csv:1"
    for folder, part in (("handcrafted", found[:2]), ("simulation", found[2:]), ("handcrafted/spikes", found[:2])):
        assert rows(tmp_path / folder) == [(name.split("/")[-1], *row) for name, *row in part]
    frames = {name: [path.name for path in paths] for name, paths in datasets.find_steps(tmp_path).items()}
    assert frames == {"simulation/cloth": ["7.ply", "8.ply"], "simulation/rod": ["9.ply", "10.ply"]}
    assert list(datasets.find_steps(tmp_path / "simulation" / "rod")) == ["rod"]

    queries, steps = datasets.find_queries, datasets.find_steps
    for find, name, rows_of_file, message in (
        (queries, "README.md", ["notes"], r"README\.md is not a folder; expected the public data"),
        (queries, OF_CLOTH, ["[true]"], r"7ee_mma_bool\.json has 1 truths; expected 2, one a query of .*7ee\.csv"),
        (queries, OF_CLOTH, ["[true, false]"], None),
        (queries, "simulation/cloth/queries/8ee.csv", QUERY, r"of simulation/cloth: the truth of .*8ee\.csv"),
        (steps, "simulation/rod/frames/11.ply", ["ply"], r"frames holds .*; expected two frames named by numbers"),
    ):
        path = _write(tmp_path, rows_of_file, name)
        with pytest.raises(ValueError, match=message) if message else nullcontext():
            find(path if name == "README.md" else tmp_path)
