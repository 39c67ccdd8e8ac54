"""Sets of primitives and their boxes: what a broad phase, a tree or a spatial hash, is to the drivers of a step."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import warp as wp
from numpy.typing import NDArray

from ccd_warp._runtime.lazy import lazy_property
from ccd_warp.kernels.boxes import box_tree

if TYPE_CHECKING:
    from ccd_warp._engine.mesh.topology import PrimitiveSet
    from ccd_warp._runtime.launch import Execution, Recording, Slot

BLOCK_FLOATS, WIDTH = int(box_tree.BLOCK_FLOATS), int(box_tree.WIDTH)
_MOST_AABBS = 2
# The order of a set in a tree: indices of the primitives, vertices of their blocks, and the groups of the bodies below
# each box of the levels above; None where there are no groups.
Order = tuple[wp.array, wp.array, wp.array | None]


@dataclass
class Layout:
    """What sets of boxes are laid out with.

    Attributes:
        num_aabbs: AABBs of a box: 1, the swept AABB; 2, the endpoint AABBs.
        allocate: Returns an array of a name, a length and a type.
        order_of: Returns the order of a set in a tree.
        choose_cell: Returns the side of a cell of the finest level of spatial hashes in quantized coordinates.
        vertex_group: The group of the body of each vertex; empty where there are no groups.
    """

    num_aabbs: int
    allocate: Callable[[str, int, Any], wp.array]
    order_of: Callable[["PrimitiveSet"], Order]
    choose_cell: Callable[[], float]
    vertex_group: wp.array

    @lazy_property
    def cell(self) -> float:
        """The side of a cell, chosen once for all sets of a step."""
        return self.choose_cell()


class BoxSet(ABC):
    """A set of primitives and their boxes; the base of trees and spatial hashes.

    Attributes:
        walk: Name of the kernel that searches two such sets for pairs, and of its file.
        parts: Names of the structs that make up a set for kernels, the first of which is a ``box_tree.BoxTree``.
        is_sorted_when_filled: Whether the boxes are brought into a good order whenever they are computed.
        primitives: The set of primitives.
        levels: Number of blocks of each level of boxes; there are at least two levels.
        name: Name of its arrays.
        slots: Names of its structs in a recording.
        structs: The set as kernels take it, after it is laid out.
    """

    walk: ClassVar[str]
    parts: ClassVar[tuple[str, ...]]
    is_sorted_when_filled: ClassVar[bool]

    def __init__(self, primitives: "PrimitiveSet", levels: tuple[int, ...], name: str) -> None:
        self.primitives = primitives
        self.levels = levels
        self.name = name
        self.slots = tuple(f"{name} {part}" for part in self.parts)
        self.structs: tuple[Any, ...] = ()

    @property
    def arrays(self) -> Any:
        """The boxes and their order, a ``box_tree.BoxTree``."""
        return self.structs[0]

    @lazy_property
    def arrivals(self) -> wp.array:
        """On CUDA, a place for each AABB of the inner blocks below the top, each 0 but while boxes are computed."""
        return wp.zeros(_MOST_AABBS * sum(self.levels[1:-1]), dtype=wp.int32, device=self.primitives.ids.device)

    def num_floats(self, num_aabbs: int) -> int:
        """Numbers that the boxes consist of."""
        size = sum(self.levels) * BLOCK_FLOATS * num_aabbs
        if size >= 2**31:
            raise ValueError(f"the mesh has {self.primitives.count} boxes of one kind; expected at most 150 million")
        return size

    @abstractmethod
    def lay_out(self, layout: Layout) -> None:
        """Give the set its arrays."""

    def adapt(self, layout: Layout) -> bool:
        """Adapt what depends on the positions of a step; returns whether boxes that were kept are outdated."""
        return False

    def bounds(self) -> tuple[NDArray[Any], NDArray[Any]] | None:
        """The box around the set, in quantized coordinates; on the CPU, and None where it is not known."""
        return None

    @staticmethod
    @abstractmethod
    def fill(
        sets: Iterable[Any],
        vertex_aabbs: "wp.array | Slot",
        launcher: "Execution | Recording",
        structs_of: Callable[[Any], tuple[Any, ...]] = lambda box_set: box_set.structs,
        only_if: wp.array | None = None,
    ) -> None:
        """Compute the boxes of sets of this class from the vertex AABBs.

        Args:
            sets: The sets.
            vertex_aabbs: AABBs of the vertices.
            launcher: Where to launch, or to record.
            structs_of: The structs of a set, in place of which a recording may take slots.
            only_if: On CUDA the flag without which boxes stay as they are, int32, shape [1]; None for always. On the
                CPU a recording asks it (`Recording.only_if`), and the kernels need not.
        """

    @staticmethod
    def searches(pairs: list[Any]) -> list[Any]:
        """The searches that find the pairs of these pairs of sets (`trees.TreePair`)."""
        return pairs


def level_sizes(count: int) -> tuple[int, ...]:
    """Number of blocks in each level of a tree over ``count`` boxes; there are at least two levels."""
    sizes = [-(-count // WIDTH)]
    while len(sizes) < 2 or sizes[-1] > 1:
        sizes.append(-(-sizes[-1] // WIDTH))
    return tuple(sizes)
