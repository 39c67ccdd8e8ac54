"""The pairs that ``exclude_pairs`` of a mesh leaves out: their validation, and the mapping that keeps them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ccd_warp._scene.input.arguments import check_items, shown
from ccd_warp._scene.input.arrays import as_array

# What is paired, by key.
KEYS = ("bodies", "vertices", "vertex_face", "edge_edge", "point_segment", "point_point", "vertex_plane")
# Keys whose two columns are of one kind, so that the order within a pair means nothing.
_SYMMETRIC = ("bodies", "vertices", "edge_edge", "point_point")
_MOST_PAIRS = 1 << 27


class PairsFound(Protocol):
    """Contacts or proximities, which know their pairs by these keys."""

    def _to_exclude(self, mesh: Any) -> Mapping[str, NDArray[np.int32]]:
        """The pairs of primitives, or a ValueError if they are of another mesh than this one."""


class ExcludedPairs(Mapping[str, NDArray[np.int32]]):
    """Pairs by what is paired; read-only, each pair once, in lexicographic order.

    A key is one of those of ``exclude_pairs``, and has at least one pair. The lower index comes first where both are of
    one kind.
    """

    def __init__(self, pairs: Mapping[str, NDArray[np.integer[Any]]] | None = None) -> None:
        """Of pairs that are already validated."""
        by_key = {key: _in_order(key, np.asarray(rows)) for key, rows in (pairs or {}).items()}
        self.__setstate__({key: by_key[key] for key in KEYS if len(by_key.get(key, ()))})

    def __getstate__(self) -> dict[str, NDArray[np.int32]]:
        return self._pairs

    def __setstate__(self, pairs: dict[str, NDArray[np.int32]]) -> None:
        """Restore the pairs and make their arrays read-only, a property that pickling loses."""
        for rows in pairs.values():
            rows.flags.writeable = False
        self._pairs = pairs

    def __getitem__(self, key: str) -> NDArray[np.int32]:
        return self._pairs[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._pairs)

    def __len__(self) -> int:
        return len(self._pairs)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ExcludedPairs):
            return NotImplemented
        return self.keys() == other.keys() and all(np.array_equal(self[key], other[key]) for key in self)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        counts = ", ".join(f"{len(rows):,} {key.replace('_', '-')}" for key, rows in self.items())
        return f"ExcludedPairs({counts or 'none'})"


def joined_pairs(*parts: Mapping[str, NDArray[np.int32]]) -> ExcludedPairs:
    """The pairs of all parts."""
    keys = {key for part in parts for key in part}
    return ExcludedPairs({key: np.concatenate([part[key] for part in parts if key in part]) for key in keys})


def validated_excluded_pairs(values: object, mesh: Any) -> ExcludedPairs:
    """Pairs of bodies, vertices or primitives of a mesh, by what is paired.

    Raises:
        ValueError: If it is neither a mapping nor contacts or proximities of this mesh, a key is not one of ``KEYS``,
            or its pairs are not pairs of such parts of the mesh.
    """
    if hasattr(values, "_to_exclude"):
        values = values._to_exclude(mesh)
    if not isinstance(values, Mapping):
        expected = (
            "a mapping from what is paired, such as 'bodies' or 'edge_edge', to pairs, or contacts or proximities "
            "(of a launch what to_host() gives)"
        )
        raise ValueError(f"exclude_pairs is {shown(values)}; expected {expected}")
    by_key = {}
    for key, pairs in values.items():
        if key not in KEYS:
            keys = ", ".join(map(repr, KEYS[:-1])) + f" or {KEYS[-1]!r}"
            raise ValueError(f"exclude_pairs has the key {shown(key)}; expected {keys}")
        name = f"exclude_pairs[{key!r}]"
        rows = with_indices(pairs, name, mesh.names) if key == "bodies" else pairs
        by_key[key] = validated_rows(rows, name, *_columns(key, mesh))
    return ExcludedPairs(by_key)


def _columns(key: str, mesh: Any) -> tuple[tuple[str, int, NDArray[np.int32] | None], ...]:
    """What the columns of a key hold: the word for one, the number of indices, and which of them if not all."""
    vertex, edge = ("vertex", mesh.num_vertices, None), ("edge", mesh.num_edges, None)
    point = ("codimensional point", mesh.num_vertices, mesh.codimensional_points)
    segment = ("codimensional edge", mesh.num_edges, mesh.codimensional_edges)
    if mesh.dimension == 2 and key == "point_segment":
        return vertex, edge
    body, face = ("body", mesh.num_bodies, None), ("face", mesh.num_faces, None)
    columns: dict[str, Any] = {
        "bodies": (body, body),
        "vertices": (vertex, vertex),
        "vertex_face": (vertex, face),
        "edge_edge": (edge, edge),
        "point_segment": (point, segment),
        "point_point": (point, point),
        "vertex_plane": (vertex, ("plane", len(mesh.planes), None)),
    }
    columns_of_key: tuple[tuple[str, int, NDArray[np.int32] | None], ...] = columns[key]
    return columns_of_key


def with_indices(
    pairs: object, name: str, names: Sequence[str], expected: str = "pairs of body indices or names of bodies"
) -> Any:
    """Pairs of bodies in which an index stands for each name."""
    if hasattr(pairs, "dtype") and getattr(pairs.dtype, "kind", None) != "U":
        return pairs
    numbers = {body: index for index, body in enumerate(names)}
    rows = []
    for pair in check_items(name, pairs, expected):
        items = check_items(name, pair, expected)
        for item in items:
            if isinstance(item, str) and item not in numbers:
                raise ValueError(f"{name} holds {shown(str(item))}; expected indices or names of the mesh's bodies")
        rows.append([numbers[item] if isinstance(item, str) else item for item in items])
    return rows


def validated_rows(
    values: object, name: str, *columns: tuple[str, int, NDArray[np.int32] | None]
) -> NDArray[np.integer[Any]]:
    """Pairs of indices, shape [k, 2], or a ValueError; ``columns`` says what each column holds."""
    array = as_array(values, name, "integers and shape (k, 2)")
    if array.size == 0 and array.ndim <= 2 and array.shape[-1:] in ((0,), (2,)):
        return np.zeros((0, 2), dtype=np.int32)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"{name} has shape {array.shape}; expected (k, 2)")
    if array.dtype.kind not in "iu":
        raise ValueError(f"{name} has dtype {shown(array.dtype)}; expected integers")
    if len(array) > _MOST_PAIRS:
        raise ValueError(f"{name} has {len(array)} pairs; expected at most {_MOST_PAIRS}")
    for column, (word, count, among) in zip(array.T, columns, strict=True):
        is_out = (column < 0) | (column >= count)
        if is_out.any():
            row = int(np.argmax(is_out))
            raise ValueError(
                f"{name} holds {word} {column[row]} in row {row}; expected an index in [0, {count}), one of the mesh's"
            )
        if among is not None:
            is_other = ~np.isin(column, among)
            if is_other.any():
                row = int(np.argmax(is_other))
                raise ValueError(
                    f"{name} holds {column[row]} in row {row}; expected a {word} of the mesh, which that is not"
                )
    return array


def _in_order(key: str, rows: NDArray[np.integer[Any]]) -> NDArray[np.int32]:
    """The pairs in lexicographic order, each once; without those of a vertex or primitive with itself, never tested."""
    first, second = rows.astype(np.int64).reshape(-1, 2).T
    if key in _SYMMETRIC:
        first, second = np.minimum(first, second), np.maximum(first, second)
        if key != "bodies":
            first, second = first[first != second], second[first != second]
    keys = np.unique(first << 32 | second)
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], axis=1).astype(np.int32)
