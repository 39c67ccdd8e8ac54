"""The public data comes in exactly, or not at all and with the file and the line that are to blame."""

import re
from contextlib import nullcontext
from fractions import Fraction
from itertools import product
from random import Random

import numpy as np
import pytest
from public_data import find_queries, find_steps, read_boxes, read_queries, read_truth
from published import DATA, requires_data

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


def _rows(points, truth=None):
    """The rows of queries, [n, 8, 3], a truth for each behind them."""
    ratios = ["{},{}".format(*x.as_integer_ratio()) for x in points.ravel().tolist()]
    rows = [",".join(ratios[k : k + 3]) for k in range(0, len(ratios), 3)]
    return rows if truth is None else [f"{row},{int(truth[k // 8])}" for k, row in enumerate(rows)]


def _refused(path, at=""):
    with pytest.raises(ValueError, match=re.escape(f"{path}{at}: ")):
        read_queries(path)


# Line ends, ends of the file, marks at its begin, and blanks after commas, as ccd_query_io writes them.
DRESSES = list(product(["\n", "\r\n"], ["", "\n", "\n\n\n"], [b"", b"\xef\xbb\xbf"], ["", "   "]))


def test_any_finite_query_comes_back_in_any_dress_and_zero_loses_its_sign(tmp_path):
    """Points of both frames in order: of any bits, and extremes; 0.0 is added, which takes the sign of a zero."""
    rng, shape = np.random.default_rng(0), (16, 8, 3)
    for line_end, tail, mark, blanks in DRESSES:
        bits = rng.integers(0, 2**64, shape, dtype=np.uint64).view(np.float64)
        points = np.where(np.isfinite(bits) & (rng.random(shape) < 0.8), bits, rng.choice([*EXTREMES, -0.0], shape))
        truth = rng.random(len(points)) < 0.5
        rows = line_end.join(_rows(points, truth)).replace(",", f",{blanks}") + tail.replace("\n", line_end)
        start, end, found = read_queries(_write(tmp_path, mark + rows.encode()))
        assert np.concatenate([start, end], axis=1).tobytes() == (points + 0.0).tobytes()
        assert np.array_equal(found, truth)
        assert len(read_queries(_write(tmp_path, mark + tail.encode()))[0]) == 0


def test_a_rational_is_exact_or_refused(tmp_path):
    draw, outcomes = Random(0), set()
    for _ in range(150):
        n, k = draw.randint(-(2**60), 2**60) >> draw.randint(0, 60), draw.randint(0, draw.choice([60, 1200]))
        factor = draw.randint(1, 10 ** draw.randint(0, 30))
        path, fraction = _write(tmp_path, [f"1,2,0,1,{n * factor},{factor << k}"] * 8), Fraction(n, 1 << k)
        outcomes.add(is_exact := Fraction(float(fraction)) == fraction)
        if is_exact:
            assert Fraction(read_queries(path)[1][0, 3, 2]) == fraction
        else:
            _refused(path, ", line 1")
    assert len(outcomes) == 2


@requires_data
@pytest.mark.parametrize("path", sorted(DATA.glob("*/*/*/*.csv")), ids=lambda path: "/".join(path.parts[-3:]))
def test_published_queries_are_the_fractions_of_the_file(path):
    start, end, truth = read_queries(path)
    lines, points = path.read_text().split(), np.stack([start, end], axis=1).reshape(-1, 3).tolist()
    assert len(lines) == len(points) > 0 and (path.parts[-4] == "handcrafted") == (truth is not None)
    truths = [None] * len(lines) if truth is None else np.repeat(truth, 8).tolist()
    for line, point, of_query in zip(lines[::7], points[::7], truths[::7], strict=True):
        fields = list(map(int, line.split(",")))
        assert [Fraction(x) for x in point] == [Fraction(*fields[k : k + 2]) for k in (0, 2, 4)]
        assert fields[6:] == ([] if truth is None else [of_query])


@pytest.mark.parametrize("truth", [None, [True, False]])
def test_queries_cut_at_any_byte_are_refused_or_fewer_whole_queries(tmp_path, truth):
    points = np.random.default_rng(0).uniform(size=(2, 8, 3))
    data = _write(tmp_path, _rows(points, truth)).read_bytes()
    # The last denominator: a power of two that was cut may be one again, and published files end without a line end.
    ends = [len(b"".join(data.splitlines(keepends=True)[: 8 * n])) for n in (1, 2)]
    open_to = [range(data.rindex(b",", 0, end) + 1, end - 1) if truth is None else range(0) for end in ends]
    for length in range(len(data)):
        try:
            start, end, _ = read_queries(_write(tmp_path, data[:length]))
        except ValueError:
            continue
        if not any(length in lengths for lengths in open_to):
            assert np.array_equal(np.concatenate([start, end], axis=1), points[: len(start)])


NO_INTEGERS = ["5.0", "nan", "+5", "1_0", " ", "\t5", "\r5", "٣", "", "-", "--5", "5-", "5 ", "7" * 10**7]
NO_ROWS = [f"1,2,3,4,{field},8" for field in NO_INTEGERS] + ["", "1,2,3,4,5", "1,2,3,4,5,8,1,1", "1,2,3,4,5,8,01"]
NO_ROWS += ["1,2,3,4,5,0", "1,2,3,4,5,-8", f"{2**53 + 1},2,3,4,5,8", f"1,2,3,4,1,{2**1075}"]
NO_ROWS += [f"1,2,{2**1024 - 2**970 - k},1,5,8" for k in (0, 1)] + ["xn,xd,yn,yd,zn,zd,truth"]
NO_QUERIES = [[ROW] * 7, [f"{ROW},1"] * 8 + [ROW] * 8, [f"{ROW},{int(k != 13)}" for k in range(16)]]
NO_QUERIES += [[*QUERY[:7], f"{ROW},1"], [ROW] * 8 + [f"{ROW},1"] * 8]


@pytest.mark.parametrize("rows", [*NO_ROWS, *NO_QUERIES], ids=range(len(NO_ROWS) + len(NO_QUERIES)))
def test_rows_that_are_no_queries_are_refused_by_their_line(tmp_path, rows):
    """Of one row among good ones, or of good ones that are together none."""
    if type(rows) is list:
        _refused(_write(tmp_path, rows))
        return
    for at in (6, 15):
        _refused(_write(tmp_path, [*[ROW] * (at - 1), rows, *[ROW] * (16 - at)]), f", line {at}")


OF_BOTH = [b"[\ntrue,\nfalse", b'{"a": 1}', b'["\xff"]', b"[" * 200_000, b"[1]", b"[[1, 2, 3]]", b"[null]"]
OF_BOXES = [f"[[1, 2], {pair}]".encode() for pair in ("[-1, 2]", "[1.0, 2]", str([1, 2**63]), "[true, false]")]


@pytest.mark.parametrize(
    "read, text, expected, damaged",
    [
        (read_truth, b"[false,true,true]", [False, True, True], [*OF_BOTH, *OF_BOXES]),
        (read_boxes, b"[[15739,15746],[3,9223372036854775807]]", [[15739, 15746], [3, 2**63 - 1]], OF_BOTH + OF_BOXES),
    ],
)
def test_truth_and_boxes_come_whole_or_not_at_all(tmp_path, read, text, expected, damaged):
    found = read(_write(tmp_path, text, "227ee.json"))
    assert found.tolist() == expected and found.dtype in (bool, np.int64)
    for other in [text[:n] for n in range(len(text))] + damaged:
        path = _write(tmp_path, other, "227ee.json")
        with pytest.raises(ValueError, match=re.escape(str(path))):
            read(path)


OF_CLOTH = "simulation/cloth/mma_bool/7ee_mma_bool.json"


def test_queries_and_steps_under_the_root_and_under_each_part_of_it(tmp_path):
    """In both layouts; every query of a file has the file's number as its first coordinate."""
    spikes = [("edge-edge/data_0", 1, ",1"), ("edge-edge/data_1", 2, ",0"), ("vertex-face/data_0", 1, ",0")]
    files = [(f"handcrafted/spikes/{name}", *how) for name, *how in spikes]
    files += [("simulation/cloth/queries/7ee", 2, ""), ("simulation/rod/queries/9vf", 1, "")]
    for number, (name, count, truth) in enumerate(files):
        _write(tmp_path, [f"{number},1,0,1,0,1{truth}"] * 8 * count, f"{name}.csv")
    _write(tmp_path, ["[true, false]"], OF_CLOTH)
    for name in ("cloth/frames/7", "cloth/frames/8", "rod/frames/10", "rod/frames/9"):
        _write(tmp_path, ["ply"], f"simulation/{name}.ply")

    def rows(folder):
        found = [(q, q.points_t0[:, 0, 0].tolist()) for q in find_queries(folder)]
        return [(q.name, q.kind, of, None if q.truth is None else q.truth.tolist()) for q, of in found]

    found = rows(tmp_path)
    assert found == [
        ("handcrafted/spikes", "vertex-face", [2], [False]),
        ("handcrafted/spikes", "edge-edge", [0, 1, 1], [True, False, False]),
        ("simulation/cloth", "edge-edge", [3, 3], [True, False]),
        ("simulation/rod", "vertex-face", [4], None),
    ]
    for folder, part in (("handcrafted", found[:2]), ("simulation", found[2:]), ("handcrafted/spikes", found[:2])):
        assert rows(tmp_path / folder) == [(name.split("/")[-1], *row) for name, *row in part]
    frames = {name: [path.name for path in paths] for name, paths in find_steps(tmp_path).items()}
    assert frames == {"simulation/cloth": ["7.ply", "8.ply"], "simulation/rod": ["9.ply", "10.ply"]}

    for find, name, rows_of_file, message in (
        (find_queries, OF_CLOTH, ["[true]"], r"7ee_mma_bool\.json has 1 truths; expected 2, one a query of .*7ee\.csv"),
        (find_queries, OF_CLOTH, ["[true, false]"], None),
        (
            find_queries,
            "simulation/cloth/queries/8ee.csv",
            QUERY,
            "the truth of some files of simulation/cloth, edge-edge, is",
        ),
        (find_steps, "simulation/rod/frames/11.ply", ["ply"], "has the frames .*; expected two, named by numbers"),
    ):
        _write(tmp_path, rows_of_file, name)
        with pytest.raises(ValueError, match=message) if message else nullcontext():
            find(tmp_path)
