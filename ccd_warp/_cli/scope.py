"""What an answer is about: the pairs that were looked at, those that were left out, and what CCD does not see."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ccd_warp._cli.places import kind_name
from ccd_warp._engine.mesh.scene import possible_kinds
from ccd_warp._input.excluded_pairs import ExcludedPairs
from ccd_warp._input.messages import InputError
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh
from ccd_warp._status import PairKind

if TYPE_CHECKING:
    from ccd_warp._cli.scene import StartContacts

NOT_SEEN = (
    "what surfaces that cross at the start already do after it, and bodies that lie one inside the other: CCD finds "
    "surfaces that meet in the step"
)


def check_kinds(mesh: CollisionMesh, options: Options) -> None:
    """Refuse kinds of pairs that the bodies cannot form: the answer would be about nothing."""
    if options.pair_kinds is None:
        return
    possible = possible_kinds(mesh, Options())
    for kind in options.kinds:
        if kind not in possible:
            raise InputError(
                f"--pair-kinds holds {kind_name(kind)}, which these bodies cannot form, as they have no particles, "
                f"cables or half-spaces; expected some of {', '.join(map(kind_name, possible))}"
            )


def looked_at(mesh: CollisionMesh, options: Options) -> str:
    """Kinds of the pairs that were looked at, and the part of the step."""
    kinds = _listed([kind_name(kind) for kind in possible_kinds(mesh, options)])
    return f"{kinds}, in [0, {repr(options.t_max).removesuffix('.0')}]"


def left_out(mesh: CollisionMesh, options: Options, ignored: "StartContacts | None") -> str:
    """The pairs of these bodies that were not looked at; ``ignored`` are those of the first frame."""
    kinds: Sequence[PairKind] = possible_kinds(mesh, options)
    unasked = [kind for kind in possible_kinds(mesh, Options()) if kind not in kinds]
    parts = [f"{kind_name(kind)} pairs (--pair-kinds)" for kind in unasked]
    is_left_out = mesh._is_free & ~mesh.self_collision
    if (is_left_out & ~mesh.rigid).any():
        parts.append("pairs within a body (--no-self-collision)")
    if (is_left_out & mesh.rigid).any():
        parts.append("pairs within a rigid body")
    if mesh.kinematic.any():
        parts.append("pairs of static and kinematic bodies" if mesh.static.any() else "pairs of kinematic bodies")
    elif mesh.static.any():
        parts.append("pairs of static bodies")
    if ignored is not None:
        parts.append(str(ignored))
    given = ExcludedPairs() if ignored is None else ExcludedPairs(ignored.pairs)
    for key, pairs in mesh.exclude_pairs.items():
        num_given = len(pairs) - len(given.get(key, ()))
        if num_given:
            pairs_of = f"pairs of {key}" if key in ("bodies", "vertices") else f"{key.replace('_', '-')} pairs"
            parts.append(f"{num_given:,} {pairs_of} (--exclude)")
    if mesh.exclusion_rings > 1:
        parts.append(f"pairs that fewer than {mesh.exclusion_rings} edges connect (--exclusion-rings)")
    return "; ".join([*parts, "pairs that share a vertex"])


def _listed(words: Sequence[str]) -> str:
    return " and ".join(words) if len(words) < 3 else f"{', '.join(words[:-1])} and {words[-1]}"
