"""The cache that calls attach to a mesh for later calls: its topology and idle workspaces, by device."""

from dataclasses import dataclass, field
from typing import Any

from ccd_warp._scene.mesh import CollisionMesh


@dataclass(frozen=True)
class MeshCache:
    """The cache of one mesh.

    Threads share the cache: each access is a single operation on a dictionary or a list, and these are atomic. Its
    contents are made by modules that import this one and know their types.

    Attributes:
        topologies: Topologies by name of the device.
        idle_workspaces: Workspaces that no call uses, by name of the device.
        parts: Under "parts" the positions for which bodies have last been divided, and their parts; under "last" those
            of the last call that had others; under "pairs" a bound on the number of pairs of whole bodies; under "idle"
            searches for those that are near, which no call uses. Under "planes" what all calls ask of half-spaces.
    """

    topologies: dict[str, Any] = field(default_factory=dict)
    idle_workspaces: dict[str, list[Any]] = field(default_factory=dict)
    parts: dict[str, Any] = field(default_factory=dict)

    @staticmethod
    def of(mesh: CollisionMesh) -> "MeshCache":
        """The cache of a mesh, which lives as long as the mesh and is part of no copy or pickle of it.

        It is stored in the mesh's own dictionary, not in a weak one: a topology refers to its mesh, which would then
        never be freed.
        """
        of_mesh: dict[str, Any] = mesh.__dict__
        cache: MeshCache = of_mesh.setdefault("_cache", MeshCache())
        return cache
