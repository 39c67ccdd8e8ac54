"""The public data comes in exactly: what of it is read is what stands in the files."""

from fractions import Fraction

import numpy as np
import pytest
from public_data import find_queries, read_queries
from published import DATA, requires_data


@requires_data
@pytest.mark.parametrize("path", sorted(DATA.glob("*/*/*/*.csv")), ids=lambda path: "/".join(path.parts[-3:]))
def test_published_queries_are_the_fractions_of_the_file(path):
    start, end, truth = read_queries(path)
    lines, points = path.read_text("utf-8").split(), np.stack([start, end], axis=1).reshape(-1, 3).tolist()
    assert len(lines) == len(points) > 0 and len(truth) == len(start)
    for line, point, of_query in zip(lines[::7], points[::7], np.repeat(truth, 8).tolist()[::7], strict=True):
        fields = list(map(int, line.split(",")))
        assert [Fraction(x) for x in point] == [Fraction(*fields[k : k + 2]) for k in (0, 2, 4)]
        assert path.parts[-4] != "handcrafted" or fields[6:] == [of_query]


@pytest.mark.parametrize(
    "rows, message",
    [
        (7 * ["1,2,3,4,0,1"], "has 7 rows; expected 8 a query"),
        (8 * ["1,2,3,4,0,3", "1,2,3,4,1,3"], "1/3 is no float64"),
        (8 * ["1,2,3,4,0,1"], r"has 2 truths; expected 1, one a query of .*7ee\.csv"),
    ],
)
def test_queries_that_would_be_read_in_part_or_rounded_are_refused(tmp_path, rows, message):
    for name, content in (("queries/7ee.csv", "\n".join(rows)), ("mma_bool/7ee_mma_bool.json", "[true, false]")):
        path = tmp_path / "simulation" / "cloth" / name
        path.parent.mkdir(parents=True)
        path.write_text(content)
    with pytest.raises(ValueError, match=message):
        find_queries(tmp_path)
