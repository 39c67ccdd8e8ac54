"""Files of our own readers, drawn with all that their formats allow: read exactly, and damaged ones never in part."""

import struct
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest

from ccd_warp._files.mesh import _READERS as READERS

# Of PLY, by the letters of `struct`.
TYPES = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "int64": "q"},
    **{"uint64": "Q", "float32": "f", "float64": "d"},
}
OF_INDICES = [name for name, letter in TYPES.items() if letter not in "fd"]


@dataclass
class Content:
    """What a file holds."""

    vertices: list = field(default_factory=list)
    polygons: list = field(default_factory=list)
    edges: list = field(default_factory=list)
    points: list = field(default_factory=list)

    def count(self) -> int:
        return len(self.polygons) + len(self.edges) + len(self.points)


def content(suffix, data) -> Content | None:
    """What is read of a file; None where it is refused, in words, or holds nothing that collides."""
    try:
        part = READERS[suffix](data)
    except ValueError as error:
        assert str(error).isprintable() and len(str(error)) < 500
        return None
    counts = np.full(len(part.faces), 3) if part.counts is None else part.counts
    fans = np.split(part.faces, np.cumsum(counts - 2)[:-1]) if len(counts) else []
    polygons = [(*fan[0, :2].tolist(), *fan[:, 2].tolist()) for fan in fans]
    found = Content(part.vertices.tolist(), polygons, [*map(tuple, part.edges.tolist())], part.points.tolist())
    return found if found.count() else None


def _value(rng, letter):
    """Any number of a type, integers of all bits."""
    if letter in "fd":
        return struct.unpack(f"<{letter}", struct.pack(f"<{letter}", rng.normal() * 10.0 ** rng.integers(-9, 9)))[0]
    size = struct.calcsize(letter)
    return int.from_bytes(rng.bytes(size), "little", signed=letter.islower()) >> (11 if size == 8 else 0)  # 53 bits


def _polygons(rng, n, least=1) -> list:
    counts = rng.integers(3, 7, int(rng.integers(least, 6)))
    counts[:] = counts if rng.random() < 0.5 else counts[:1].max(initial=3)
    return [tuple(rng.choice(n, count, replace=False).tolist()) for count in counts]


def drawn_ply(rng) -> tuple[bytes, Content]:
    order, n = str(rng.choice(["", "<", ">"])), int(rng.integers(7, 13))
    kind = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header, body = ["ply", f"format {kind} 1.0", "comment drawn"], b""
    found = Content([], _polygons(rng, n, 0), [*map(tuple, rng.integers(0, n, (rng.integers(3), 2)).tolist())])

    def element(name, rows, names):
        """Rows of named values, and of properties beside them, each of any type, in any order."""
        nonlocal body
        columns = {name: (str(rng.choice([*TYPES] if name in "xyz" else OF_INDICES)), ()) for name in names}
        for k in range(rng.integers(0, 4)):
            columns[f"p{k}"] = str(rng.choice([*TYPES])), () if rng.random() < 0.5 else (str(rng.choice(OF_INDICES)),)
        if "vertex_indices" in columns:
            columns["vertex_indices"] = columns["vertex_indices"][0], (str(rng.choice(OF_INDICES)),)
        header.append(f"element {name} {len(rows)}")
        columns = {name: columns[name] for name in rng.permutation([*columns]).tolist()}
        header.extend(
            f"property {'list ' * len(of)}{' '.join([*of, kind, key])}" for key, (kind, of) in columns.items()
        )
        lengths = {key: int(rng.integers(0, 4)) for key in columns}
        varies = rng.random() < 0.5
        for row in rows:
            words = []
            for key, (kind, of) in columns.items():
                letter = TYPES[kind]
                count = int(rng.integers(0, 4)) if varies else lengths[key]
                value = row[key] if key in row else [_value(rng, letter) for _ in range(count if of else 1)]
                if key in "xyz":
                    row[key] = value[0]
                words += [(TYPES[length], len(value)) for length in of] + [(letter, number) for number in value]
            if order:
                body += b"".join(struct.pack(order + letter, number) for letter, number in words)
            else:
                body += (" ".join(repr(number) for _, number in words) + "\n").encode()

    vertices = [{} for _ in range(n)]
    order_of_elements = rng.permutation(["vertex", "face", "edge", "other"]).tolist()
    for name in order_of_elements:
        if name == "vertex":
            element(name, vertices, "xyz")
        elif name == "face":
            element(name, [{"vertex_indices": polygon} for polygon in found.polygons], ["vertex_indices"])
        elif name == "edge":
            rows = [{"vertex1": [a], "vertex2": [b]} for a, b in found.edges]
            element(name, rows, ["vertex1", "vertex2"])
        elif rng.random() < 0.5:
            element(name, [{}, {}], ["flag"])
    found.vertices = [[float(row[axis]) for axis in "xyz"] for row in vertices]
    found.points = [] if found.polygons or found.edges else [*range(n)]
    return "\n".join([*header, "end_header", ""]).encode() + body, found


def _coordinates(rng, n) -> list:
    return [[_value(rng, "d") for _ in range(3)] for _ in range(n)]


def drawn_off(rng) -> tuple[bytes, Content]:
    n, beside = int(rng.integers(7, 13)), int(rng.choice([0, 0, 3]))
    found = Content(_coordinates(rng, n), _polygons(rng, n))
    counts = f"{n} {len(found.polygons)}{' 0' * int(rng.integers(2))}"
    lines = [f"OFF {counts}"] if rng.random() < 0.5 else ["COFF # text", "", counts]
    lines += [" ".join(map(repr, [*row, *[0.5] * beside])) for row in found.vertices] + ["# faces"]
    lines += [" ".join(map(str, [len(row), *row, *[1] * int(rng.integers(0, 5))])) for row in found.polygons]
    return "\n".join([*lines, ""]).encode(), found


def drawn_stl(rng) -> tuple[bytes, Content]:
    corners = np.array(_coordinates(rng, 3 * int(rng.integers(1, 4)))).astype(np.float32).astype(float).tolist()
    triangles = [tuple(range(k, k + 3)) for k in range(0, len(corners), 3)]
    if rng.random() < 0.5:
        facets = [struct.pack("<12fH", *rng.bytes(3), *np.ravel(corners[row[0] : row[-1] + 1]), 9) for row in triangles]
        return rng.bytes(80) + struct.pack("<I", len(facets)) + b"".join(facets), Content(corners, triangles)
    lines = ["solid drawn"]
    for row in triangles:
        lines += [" facet normal 0 0 1", "outer LOOP"]
        lines += [" ".join(map(repr, ["vertex", *corners[k]])).replace("'", "") for k in row] + ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid drawn", ""]).encode(), Content(corners, triangles)


def drawn_obj(rng) -> tuple[bytes, Content]:
    """With materials, seams and labels between the faces, where others would split vertices and sort faces."""
    n = int(rng.integers(7, 13))
    found = Content(_coordinates(rng, n), _polygons(rng, n, 0))
    lines = ["# drawn", "mtllib none.mtl", "o a"]
    behind = [[0.5] * int(rng.choice([0, 1, 3, 4])) for _ in found.vertices]
    lines += [" ".join(["v", *map(repr, row + more)]) for row, more in zip(found.vertices, behind, strict=True)]
    lines += ["vn 0 0 1", "vt 0.5 0.5"]
    behind = str(rng.choice(["", "/1", "//1", "/1/1"]))

    def row(keyword, corners):
        named = [str(k - n if rng.random() < 0.3 else k + 1) + behind * (keyword != "p") for k in corners]
        return " ".join([keyword, *named[:-1], *["\\\n"] * (rng.random() < 0.2), named[-1]])

    for polygon in found.polygons:
        lines += [f"usemtl m{rng.integers(9)}"] * int(rng.integers(2)) + [row("f", polygon)]
    for chain in _polygons(rng, n, 0) if rng.random() < 0.5 else []:
        lines.append(row("l", chain))
        found.edges += [*pairwise(chain)]
    found.points = rng.choice(n, int(rng.integers(not found.polygons + found.edges, 3)), replace=False).tolist()
    lines += [row("p", found.points)] if found.points else []
    return "\n".join([*lines, ""]).encode(), found


DRAWN = {".ply": drawn_ply, ".off": drawn_off, ".stl": drawn_stl, ".obj": drawn_obj}


@pytest.mark.parametrize("suffix", DRAWN)
def test_drawn_files_are_read_exactly_and_damaged_ones_never_in_part(suffix, monkeypatch):
    """Cut at each place, with lines missing or doubled, bytes dropped, doubled and behind the end.

    An OBJ says nowhere how much it holds: of one that is cut the whole lines are read, or it is refused.
    """
    rng, kinds = np.random.default_rng(ord(suffix[1])), set()
    for number in range({".ply": 24, ".off": 8}.get(suffix, 16)):
        data, whole = DRAWN[suffix](rng)
        is_text = not (b"binary" in data or (suffix == ".stl" and b"endsolid" not in data))
        assert content(suffix, data) == whole, data
        kinds.add((is_text, whole.polygons == [], len({*map(len, whole.polygons)}) > 1))
        for end in range(len(data)):
            found = content(suffix, data[:end])
            if suffix == ".obj" and found is not None:
                line = data.find(b"\n", end)
                before = end if data[:end].endswith(b"\n") else line + 1
                while data[:before].endswith(b"\\\n"):  # and the line goes on
                    before = data.find(b"\n", before) + 1
                whole = content(suffix, data[:before])
            assert found is None or found == whole, f"{data!r} cut to {end}"
            if is_text and suffix != ".obj":  # with a line end, as an editor leaves it that ends every file with one
                found = content(suffix, data[:end] + b"\n")
                assert found is None or found.count() == whole.count(), f"{data!r} cut to {end} and a line end"
        whole = content(suffix, data)
        if is_text:
            head, mark, body = data.rpartition(b"end_header\n")
            for line_end in (b"\n", b"\r\n", b"\r"):
                header = (head + mark).replace(b"\n", b"\r\n" if line_end == b"\r\n" else b"\n")
                assert content(suffix, header + body.replace(b"\n", line_end)) == whole
            with monkeypatch.context() as patch:
                patch.setattr("ccd_warp._files.text._BLOCK", 1 + number % 5)
                assert content(suffix, data) == whole
        if suffix == ".obj":
            continue
        found = content(suffix, data + b"\0")
        assert found is None, data
        lines = data.splitlines(keepends=True) if is_text else []
        for k in range(len(lines)):
            for damaged in (lines[:k] + lines[k + 1 :], lines[: k + 1] + lines[k:]):
                found = content(suffix, b"".join(damaged))
                assert found is None or found == whole, (data, lines[k])
        for begin in rng.integers(0, len(data), 10).tolist():
            end = begin + int(rng.integers(1, 40))
            for damaged in (data[:begin] + data[end:], data[:end] + data[begin:]):
                found = content(suffix, damaged)
                assert found is None or found.count() >= whole.count(), (data, begin, end)
    assert len(kinds) >= {".ply": 6, ".off": 2, ".stl": 2, ".obj": 3}[suffix]


@pytest.mark.parametrize("behind", ["", "/1", "//1"])
def test_an_obj_without_its_last_line_end_is_read_where_its_last_face_is_like_others(behind):
    """Of vertices of two digits, the last of which may have lost one; and refused where it may have lost a corner."""
    faces = [(k, k + 1, k + 2, k + 3) for k in range(12)]
    lines = ["v 0 0 0"] * 15 + [" ".join(["f", *(f"{corner + 1}{behind}" for corner in face)]) for face in faces]
    data = "\n".join(lines).encode()
    assert content(".obj", data).polygons == faces
    assert (content(".obj", data + b" ") or Content()).polygons == faces
    assert content(".obj", data.rpartition(b" ")[0]) is None and content(".obj", data + b" # and") is None
    assert content(".obj", b"\n".join(data.split(b"\n")[:-5])) is None
    if not behind:  # which would show that the number has ended
        assert content(".obj", data[:-1]) is None
