"""Candidate pairs: primitives whose swept boxes overlap."""

import itertools
import sys
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.boxes.trees import SearchPart
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.threads import default_num_threads, run
from ccd_warp._scene.input.arguments import check_real

# Number of pairs of a kind above which several threads sort them.
_WORTH_RANGES = 100_000
# Pairs copied at a time: source and target stay in the cache between the two columns.
_CHUNK = 1 << 14
# Number of pairs that is worth a task on a thread.
_TASK = 1 << 17
# The first index is the upper half of a key.
_COLUMNS = slice(None, None, -1 if sys.byteorder == "little" else 1)
NO_KEYS: NDArray[np.int64] = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Candidates:
    """Pairs that may collide in the step, each once.

    On the CPU pairs are in the order of the search: by the position of the first box and then of the second in trees
    that group neighbouring boxes in blocks of sixteen. This order depends only on the mesh, the positions, the
    inflation and the version of this library, not on the number of threads, the memory limit or earlier calls. On CUDA
    and with ``broad_phase="hash"`` pairs are in lexicographic order.

    Attributes:
        vertex_face: Vertex and face indices, int32, shape [m, 2].
        edge_edge: Edge indices, first < second, int32, shape [k, 2].
        point_segment: Vertex indices of codimensional points and edge indices of codimensional edges, int32, shape
            [n, 2]; empty where the mesh has none. Of a mesh in the plane, indices of any vertices and edges.
        point_point: Vertex indices of codimensional points, first < second, int32, shape [l, 2]; empty where the mesh
            has none.
        vertex_plane: Indices of vertices and of planes of ``mesh.planes``, in lexicographic order, int32, shape [h, 2].
    """

    vertex_face: NDArray[np.int32]
    edge_edge: NDArray[np.int32]
    point_segment: NDArray[np.int32]
    point_point: NDArray[np.int32]
    vertex_plane: NDArray[np.int32]

    def __repr__(self) -> str:
        counts = (f"{len(pairs):,} {name.replace('_', '-')}" for name, pairs in vars(self).items() if len(pairs))
        return f"Candidates({', '.join(counts) or 'none'})"

    def sorted(self) -> "Candidates":
        """The pairs in lexicographic order, in new arrays."""
        return Candidates(*map(_sorted_pairs, vars(self).values()))


def union(found: "list[Candidates]") -> Candidates:
    """The pairs of several searches, each once, in lexicographic order."""
    return Candidates(
        *(np.unique(np.concatenate(of_kind), axis=0) for of_kind in zip(*map(_pairs_of, found), strict=True))
    )


def _pairs_of(candidates: Candidates) -> list[NDArray[np.int32]]:
    return list(vars(candidates).values())


@dataclass(frozen=True)
class Found:
    """Keys of pairs that a part of a search has found: ``keys[begin:begin + count]``.

    Attributes:
        part: The part, of one kind.
        keys: The array that the search has filled.
        begin: The first key.
        count: Number of keys.
    """

    part: SearchPart
    keys: wp.array
    begin: int
    count: int

    def host_keys(self) -> NDArray[np.int64]:
        """The keys; on the CPU a view, which the next batch overwrites."""
        assert self.keys.device
        if self.keys.device.is_cuda:
            return self.keys[self.begin : self.begin + self.count].numpy()
        return self.keys.numpy()[self.begin : self.begin + self.count]


class Collector:
    """Collects the pairs of a search batch by batch, and puts them in the order of the trees, or sorts them."""

    def __init__(self, execution: Execution, *, is_sorted: bool) -> None:
        self._execution, self._is_sorted = execution, is_sorted
        self._batches: dict[PairKind, list[NDArray[np.int32]]] = {kind: [] for kind in PairKind}
        self._pieces: dict[PairKind, list[tuple[SearchPart, NDArray[np.int32]]]] = {kind: [] for kind in PairKind}

    def take(self, ranges: list[Found]) -> None:
        """Copy the pairs of a batch to an array for each kind, which is the result if no other batch follows."""
        copies = []
        for kind in PairKind:
            of_kind = [found for found in ranges if found.part.tree_pair.kind == kind]
            pairs = np.empty((sum(found.count for found in of_kind), 2), dtype=np.int32)
            begin = 0
            for found in sorted(of_kind, key=lambda found: found.part.place):
                piece = pairs[begin : begin + found.count]
                self._pieces[kind].append((found.part, piece))
                copies.append((piece, _columns_of(found.host_keys())))
                begin += found.count
            if begin:
                self._batches[kind].append(pairs)
        self._copy(copies)

    def candidates(self) -> Candidates:
        """All collected pairs, in order."""
        found = Candidates(*map(self._pairs_of, PairKind))
        return found.sorted() if self._is_sorted else found

    def _pairs_of(self, kind: PairKind) -> NDArray[np.int32]:
        batches, pieces = self._batches[kind], sorted(self._pieces[kind], key=lambda piece: piece[0].place)
        pairs = batches[0] if batches else np.empty((0, 2), dtype=np.int32)
        if len(batches) > 1:
            ends = list(itertools.accumulate(len(piece) for _, piece in pieces))
            pairs = np.empty((ends[-1], 2), dtype=np.int32)
            self._copy([(pairs[end - len(piece) : end], piece) for end, (_, piece) in zip(ends, pieces, strict=True)])
        return pairs

    def _copy(self, copies: list[tuple[NDArray[np.int32], NDArray[np.int32]]]) -> None:
        """Copy pairs, given as (target, source), on all threads where there are many."""
        parts = [
            (target[k : k + _TASK], source[k : k + _TASK])
            for target, source in copies
            for k in range(0, len(target), _TASK)
        ]
        if sum(len(target) for target, _ in parts) < _TASK:
            for part in parts:
                _copy_pairs(*part)
        else:
            self._execution.run([lambda p=p: _copy_pairs(*p) for p in parts])  # type: ignore[misc]


def validated_inflation(value: float) -> float:
    """The inflation as a float, or a ValueError."""
    return check_real("inflation", value, "a finite length that is not negative", lambda x: x >= 0)


def pairs_of(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """The pairs of keys, in a new array."""
    pairs = np.empty((len(keys), 2), dtype=np.int32)
    if len(keys):
        _copy_pairs(pairs, _columns_of(keys))
    return pairs


def _columns_of(keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """A view of keys as pairs."""
    return keys.view(np.int32).reshape(-1, 2)[:, _COLUMNS]


def _copy_pairs(target: NDArray[np.int32], source: NDArray[np.int32]) -> None:
    """Copy pairs column by column in chunks that fit the cache, which NumPy does four times as fast as by rows."""
    for k in range(0, len(target), _CHUNK):
        for column in range(2):
            target[k : k + _CHUNK, column] = source[k : k + _CHUNK, column]


def _sorted_pairs(pairs: NDArray[np.int32]) -> NDArray[np.int32]:
    """Pairs in lexicographic order, in a new array."""
    result = np.empty_like(pairs, order="C")
    keys: NDArray[np.int64] = np.empty(len(pairs), dtype=np.int64)
    _columns_of(keys)[:] = pairs
    threads = default_num_threads() if len(pairs) > _WORTH_RANGES else 1
    cuts = [len(keys) * k // threads for k in range(threads + 1)]
    if threads > 1:
        # so that the ranges between cuts can be sorted independently
        keys.partition(cuts[1:-1])

    def finish(low: int, high: int) -> None:
        keys[low:high].sort()
        _copy_pairs(result[low:high], _columns_of(keys[low:high]))

    run([lambda c=c: finish(*c) for c in itertools.pairwise(cuts)], threads)  # type: ignore[misc]
    return result
