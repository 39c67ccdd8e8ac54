"""The text that the command line prints: bodies and their toi, contacts, what was looked at, lengths, times."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._cli.contacts import described, earliest
from ccd_warp._cli.scene import StartContacts
from ccd_warp._cli.solve import SolvedStep
from ccd_warp._engine.mesh.scene import possible_kinds
from ccd_warp._files.sequence import Frames
from ccd_warp._runtime.display import counted, kind_name, named_counts, shown_range, start_sentence
from ccd_warp._runtime.status import CCDStatus
from ccd_warp._runtime.version import __version__
from ccd_warp._scene.input.excluded_pairs import ExcludedPairs
from ccd_warp._scene.input.messages import printable
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh

_MOST_BODIES = 30  # that a report lists; the result files have all
_NOT_SEEN = (
    "what surfaces that cross at the start already do after it, and bodies that lie one inside the other: CCD finds "
    "surfaces that meet in the step"
)


def format_toi(toi: float) -> str:
    """A toi in full: rounding it to fewer digits could print a later time than the certain one."""
    return repr(float(toi)) if math.isfinite(toi) else "none"


def format_title(title: str, options: Options) -> str:
    """The first line of a report."""
    device = wp.get_device(options.device)
    return printable(
        f"ccd-warp {__version__}  {title}  ({options.precision}, {device.name if device.is_cuda else 'CPU'})"
    )


def format_report(title: str, step: SolvedStep) -> str:
    """The report of one step, without a final newline.

    Args:
        title: First line.
        step: The step and its result.
    """
    tois = [format_toi(toi) for toi in step.result.body_toi.tolist()]
    lines = [format_title(title, step.options), "", *body_lines(step.frames, tois), "", *_outcome(step)]
    lines.append(length_line(step.mesh, step.ends[0], step.displacement, step.options))
    timings = {**step.timings, "total": sum(step.timings.values())}
    stages = ", ".join(f"{name.replace('_', ' ')} {seconds:.4f}" for name, seconds in timings.items())
    return "\n".join([*lines, f"seconds  {stages}"])


def body_lines(frames: Frames, tois: Sequence[str] = ()) -> list[str]:
    """The first bodies with their sizes, what was merged in reading them, and which vertices take no part."""
    mesh = frames.mesh
    vertices, faces = np.diff(mesh.body_vertex_range), np.bincount(mesh.face_body, minlength=mesh.num_bodies)
    lines = [
        f"  {name}  {mesh._kind_of_body(b)}, {counted(int(vertices[b]), 'vertex', 'vertices')}, "
        f"{counted(int(faces[b]), 'face', 'faces')}{f', toi {tois[b]}' if tois else ''}"
        for b, name in enumerate(mesh.names[:_MOST_BODIES])
    ]
    more = mesh.num_bodies - _MOST_BODIES
    lines += [f"  ... {more:,} more bodies"] if more > 0 else []
    unused = mesh.vertex_body[np.setdiff1d(mesh.unused_vertices, mesh.inner_vertices)]
    num_unused, notes = np.bincount(unused, minlength=mesh.num_bodies).tolist(), []
    for name, merged, count in zip(mesh.names, frames.num_merged.tolist(), num_unused, strict=True):
        notes += [f"  ({merged:,} vertices of {name} merged by position)"] if merged else []
        words = counted(count, f"vertex of {name} in no face takes", f"vertices of {name} in no face take")
        notes += [f"  ({words} no part)"] if count else []
    return lines + notes[:_MOST_BODIES]


def length_line(mesh: CollisionMesh, start: NDArray[np.float64], displacement: float, options: Options) -> str:
    """The lengths of a step, or of several with the same options, in the unit of the files."""
    scale = options.length_scale
    assert scale is not None, "chosen for the mesh if not given"
    with np.errstate(over="ignore"):
        x, y, z = np.ptp(start, axis=0).tolist()
    is_distance = options.minimum_distance > 0 or mesh.radius is not None
    lengths = [
        f"extents at the start {x:.6g} x {y:.6g} x {z:.6g}",
        f"largest displacement {displacement:.6g}",
        f"length scale {scale:.6g}",
        f"tolerance {options.tolerance * scale:.6g}",
        f"minimum {'distance' if is_distance else 'separation'} {options.separation(scale):.6g}",
        *([shown_range("radius", mesh.radius)] if mesh.radius is not None else []),
    ]
    return f"lengths, in the unit of the files  {', '.join(lengths)}"


def looked_at(mesh: CollisionMesh, options: Options) -> str:
    """That "none" is certain for which pairs, and in which part of the step."""
    kinds = [kind_name(kind) for kind in possible_kinds(mesh, options)]
    words = " and ".join(filter(None, [", ".join(kinds[:-1]), *kinds[-1:]]))
    return f"(certain for the pairs looked at: {words}, in [0, {repr(options.t_max).removesuffix('.0')}])"


def left_out(mesh: CollisionMesh, options: Options, ignored: StartContacts | None) -> str:
    """The pairs of these bodies that were not looked at; ``ignored`` are those of the first frame."""
    kinds = possible_kinds(mesh, options)
    parts = [f"{kind_name(kind)} pairs (--pair-kinds)" for kind in possible_kinds(mesh, Options()) if kind not in kinds]
    is_left_out = mesh._is_free & ~mesh.self_collision
    if is_left_out.any():
        parts.append("pairs within a body (--no-self-collision)")
    if fixed := [word for word in ("static", "kinematic") if getattr(mesh, word).any()]:
        parts.append(f"pairs of {' and '.join(fixed)} bodies")
    if ignored is not None:
        parts.append(str(ignored))
    at_start = ExcludedPairs() if ignored is None else ExcludedPairs(ignored.pairs)
    for key, pairs in mesh.exclude_pairs.items():
        count = len(pairs) - len(at_start.get(key, ()))
        words = f"pairs of {key}" if key in ("bodies", "vertices") else f"{key.replace('_', '-')} pairs"
        parts += [f"{count:,} {words} (--exclude)"] if count else []
    if mesh.exclusion_rings > 1:
        parts.append(f"pairs that fewer than {mesh.exclusion_rings} edges connect (--exclusion-rings)")
    return "; ".join([*parts, "pairs that share a vertex"])


def scope_lines(mesh: CollisionMesh, options: Options, ignored: StartContacts | None) -> list[str]:
    """What was left out, and what CCD does not see."""
    return [f"left out  {left_out(mesh, options, ignored)}", f"not seen  {_NOT_SEEN}"]


def crossing_sentence(pairs: Counter[tuple[str, str]]) -> str:
    """A sentence on the edges that pass through faces at the start."""
    if not pairs:
        return "no edge passes through a face"
    edges = counted(pairs.total(), "edge passes", "edges pass")
    return f"{edges} through a face, so surfaces cross: {', '.join(named_counts(pairs))}"


def _outcome(step: SolvedStep) -> list[str]:
    result, contacts = step.result, step.result.contacts
    crossing = crossing_sentence(step.crossing.by_bodies())
    sentences = filter(None, [start_sentence(result.pairs_at_start), result.hidden_gaps, crossing])
    end = [f"at the start  {sentence}" for sentence in sentences]
    if not result.hit:
        lines = [f"scene toi  none   {looked_at(step.mesh, step.options)}"]
    else:
        lines = [f"scene toi  {format_toi(result.toi)}   (of the step; no pair looked at touches before it)"]
    if len(contacts):
        what, where = described(step.mesh, earliest(result))
        lines += [f"first contact  {what}", f"               {where}"]
        by_kind = result.counts.num_contacts.items()
        counts = ", ".join(f"{count:,} {kind_name(kind)}" for kind, count in by_kind if count)
        lines.append(f"contacts  {len(contacts):,}: {counts}")
    num_capped = int((contacts.status == int(CCDStatus.ITERATION_LIMIT)).sum())
    if num_capped:
        end.append(
            f"{num_capped:,} of {len(contacts):,} contacts stopped at the iteration limit: their toi is early, never "
            "late; raise --max-iterations or --max-work to refine them"
        )
    return [*lines, *end, *scope_lines(step.mesh, step.options, step.ignored)]
