"""What calls keep with a mesh, so that the next one finds it: its topology and idle workspaces, by device."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class MeshCache:
    """The cache of one mesh.

    Threads share it: each access is a single operation of a dictionary or a list, and these are atomic. What it holds
    is made by modules above this one, which know its types.

    Attributes:
        topologies: Topology by name of the device.
        idle_workspaces: Workspaces that no call uses, by name of the device.
    """

    topologies: dict[str, Any] = field(default_factory=dict)
    idle_workspaces: dict[str, list[Any]] = field(default_factory=dict)

    @staticmethod
    def of(mesh: Any) -> "MeshCache":
        """The cache of a mesh, which lives as long as the mesh and is in no copy and no pickle of it.

        It stands in the mesh's dictionary, not in a weak one: a topology refers to its mesh, which would then never go.
        """
        return vars(mesh).setdefault("_cache", MeshCache())
