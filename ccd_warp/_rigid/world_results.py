"""The results of worlds from their contacts: of copies of a mesh, or of a mesh of one world with a motion of many."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.contact_place import ContactPlace, MovingVertices, joined, located, radii_of
from ccd_warp._results.contacts import Contacts
from ccd_warp._results.results import Counts, MeshResult
from ccd_warp._results.touch import Touch
from ccd_warp._runtime.status import CCDStatus, PairKind, primitives_of
from ccd_warp._scene.mesh import CollisionMesh

# Sorts of one column of numbers take a fraction of those of several.
_MOST_KEYS = 1 << 62
_NO_CONTACTS = (  # kind, primitives, toi, parameters, normal, status, gap, width
    *(np.zeros(0, np.int32), np.zeros((0, 2), np.int32), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 3))),
    *(np.zeros(0, np.int32), np.zeros(0), np.zeros(0)),
)


class WorldsResult(MeshResult):
    """A result whose arrays of vertices and bodies are made at their first use: of many worlds they are large."""

    def __init__(self, **values: Any) -> None:
        """Take all fields but these arrays, which `__getattr__` makes."""
        vars(self).update(values)

    def __getattr__(self, name: str) -> NDArray[Any]:
        owner, _, kind = name.partition("_")
        if owner not in ("vertex", "body") or kind not in ("toi", "contact"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        contacts, num_worlds = self.contacts, len(self.world_toi)
        mesh = contacts._known_place().mesh
        size, owners = {
            "vertex": (mesh.num_vertices, contacts.vertices),
            "body": (mesh.num_bodies, contacts.bodies),
        }[owner]
        if mesh.num_worlds < num_worlds:
            world = contacts.world[:, None].astype(np.int64)
            least, first = firsts(contacts.toi, world * size + owners, num_worlds * size)
            least, first = least.reshape(-1, size), first.reshape(-1, size)
        else:
            least, first = firsts(contacts.toi, owners, size)
        vars(self).update({f"{owner}_toi": least, f"{owner}_contact": first})
        array: NDArray[Any] = vars(self)[name]
        return array


def result_of(
    mesh: CollisionMesh,
    world_toi: NDArray[np.float64],
    contact_lists: list[Contacts],
    counts: Counts,
    timings: dict[str, float],
    hidden_gaps: str = "",
    frames: MovingVertices | None = None,
    touch: Touch | None = None,
) -> MeshResult:
    """The result of worlds with these tois and contacts.

    For a mesh of one world, and tois of several, arrays of vertices and bodies have an axis of worlds in front, and the
    contacts are those of one world after those of another. ``frames`` is how vertices move in all worlds, and ``touch``
    what counts as touching, where contacts have no places yet.
    """
    num_worlds = len(world_toi)
    has_axis = mesh.num_worlds < num_worlds
    contact_lists = [contact_list for contact_list in contact_lists if len(contact_list)]
    contacts = joined(contact_lists) if contact_lists else located(Contacts(*_NO_CONTACTS), mesh)
    contacts = contacts[_earliest_in_order(contacts, has_axis=has_axis)]
    if frames is not None and len(contacts):
        place = contacts._known_place()
        place.frames, place.touch, place.radii = frames.copied(contacts), touch, radii_of(mesh)
    world_contact = firsts(contacts.toi, contacts.world[:, None], num_worlds)[1]
    of_kind = np.bincount(contacts.kind, minlength=len(PairKind)).tolist()
    of_status = np.bincount(contacts.status, minlength=len(CCDStatus)).tolist()
    counts = replace(
        counts,
        num_contacts={kind: of_kind[int(kind)] for kind in counts.num_contacts},
        num_contacts_at_start=of_status[int(CCDStatus.INITIAL_CONTACT)],
        num_contacts_at_limit=sum(of_status[int(CCDStatus.ITERATION_LIMIT) :]),
    )
    return WorldsResult(
        toi=float(world_toi.min()),
        contacts=contacts,
        counts=counts,
        timings=timings,
        world_toi=world_toi,
        world_contact=world_contact,
        start=None,
        hidden_gaps=hidden_gaps,
    )


def _earliest_in_order(contacts: Contacts, *, has_axis: bool) -> NDArray[np.intp]:
    """The earliest of the contacts of each pair, by world, where there is an axis of worlds, kind and primitives."""
    columns = [*([contacts.world] if has_axis else []), contacts.kind, *contacts.primitives.T]
    keys, most = np.zeros(len(contacts), dtype=np.int64), 1
    for column in columns:
        size = int(column.max(initial=0)) + 1
        most *= size
        keys = keys * size + column
    if most > _MOST_KEYS:
        keys = np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(keys)  # by one of several times the speed of a stable sort, which equal keys do not need here
    is_new = np.append(True, keys[order[1:]] != keys[order[:-1]])[: len(order)]
    if is_new.all():
        return order
    order = np.lexsort((contacts.toi, keys))
    return order[is_new]


def in_one_world(
    contacts: Contacts,
    of_worlds: CollisionMesh,
    mesh: CollisionMesh,
    worlds: NDArray[np.intp],
    numbers: dict[str, NDArray[np.intp]] | None = None,
) -> Contacts:
    """Contacts in a mesh of worlds as those of a mesh of one, given what its worlds are there, and its primitives.

    Edges are found by their vertices, and half-spaces are the same, where their ``numbers`` are not given. Without any
    the worlds are copies of the mesh.
    """
    if len(contacts) == 0:
        return contacts
    primitives, world = contacts.primitives.copy(), np.zeros(len(contacts), dtype=np.intp)
    sizes = {"vertex": mesh.num_vertices, "edge": mesh.num_edges, "face": mesh.num_faces}
    corners = {"edge": of_worlds.edges, "face": of_worlds.faces}
    for kind in PairKind:
        rows = np.flatnonzero(contacts.kind == int(kind))
        for column, name in enumerate(primitives_of(kind) if len(rows) else ()):
            index = primitives[rows, column]
            copy = None
            if numbers is None and name in sizes:
                copy, primitives[rows, column] = np.divmod(index, sizes[name])
            elif numbers is None:
                primitives[rows, column] = _planes_of(mesh, of_worlds.num_worlds)[index]
            elif name in numbers:
                primitives[rows, column] = numbers[name][index]
            elif name == "edge":
                primitives[rows, column] = _edges(mesh, numbers["vertex"][of_worlds.edges[index]])
            if column == 0:  # no half-space
                if copy is None:
                    copy = of_worlds.vertex_world[corners[name][index, 0] if name in corners else index]
                world[rows] = worlds[copy]
    place = ContactPlace(mesh, world=world.astype(np.int32))
    return replace(contacts, primitives=primitives)._of(place)


def _planes_of(mesh: CollisionMesh, num_copies: int) -> NDArray[np.intp]:
    """What the half-spaces of copies are in the mesh: its own of each copy come before those that all share."""
    is_shared = mesh.planes.vertices < 0
    numbers: NDArray[np.intp] = np.append(np.tile(np.flatnonzero(~is_shared), num_copies), np.flatnonzero(is_shared))
    return numbers


def _edges(mesh: CollisionMesh, ends: NDArray[np.intp]) -> NDArray[np.intp]:
    """The edges of a mesh, which are in the order of (max, min), with these vertices, shape [n, 2]."""
    keys = mesh.edges[:, 1].astype(np.int64) * mesh.num_vertices + mesh.edges[:, 0]
    return np.searchsorted(keys, ends[:, 1] * mesh.num_vertices + ends[:, 0])


def sizes_of(mesh: CollisionMesh, num_worlds: int) -> dict[str, Any]:
    """The sizes among the counts, of a mesh, or of so many worlds where the mesh has one."""
    sizes = {name: int(getattr(mesh, name)) for name in ("num_bodies", "num_vertices", "num_edges", "num_faces")}
    sizes["num_codimensional_edges"] = len(mesh.codimensional_edges)
    sizes["num_codimensional_points"] = len(mesh.codimensional_points)
    copies = num_worlds // mesh.num_worlds
    return {name: copies * size for name, size in sizes.items()}


def firsts(toi: NDArray[np.float64], owners: NDArray[Any], count: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The least toi of each owner, and the first contact that has it, -1 for none."""
    least, first = np.full(count, np.inf), np.full(count, len(toi), dtype=np.int32)
    for column in owners.T:
        np.minimum.at(least, column, toi)
    for column in owners.T:
        has_it = np.flatnonzero(toi == least[column])
        np.minimum.at(first, column[has_it], has_it.astype(np.int32))
    return least, np.where(first == len(toi), np.int32(-1), first)
