"""Names of frames: their natural order, and which of them belong to one body."""

import re
from collections.abc import Sequence
from pathlib import Path

from ccd_warp._scene.input.messages import InputError

_NUMBER = re.compile(r"([0-9]+)")


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """A key that sorts names as a reader would: ``frame_2`` before ``frame_10``."""
    # Numbers and texts alternate, so that only like is compared with like; the name itself decides between 1 and 01.
    parts = [(0, int(part), "") if k % 2 else (1, 0, part) for k, part in enumerate(_NUMBER.split(name))]
    return [*parts, (1, 0, name)]


def pattern_of(path: Path) -> str:
    """The name of a file with its last number replaced by ``#``, the name itself if there is none."""
    stem, suffix = path.stem, path.suffix
    numbers = list(_NUMBER.finditer(stem))
    return f"{stem[: numbers[-1].start()]}#{stem[numbers[-1].end() :]}{suffix}" if numbers else f"{stem}{suffix}"


def series_name(paths: Sequence[Path]) -> str:
    """What to call the body of these frames: what their names share, or the name of their folder."""
    shared = pattern_of(paths[0])
    if any(pattern_of(path) != shared for path in paths):
        return paths[0].name
    name = shared.partition("#")[0].strip("_-. ")
    return name or paths[0].absolute().parent.name or paths[0].name


def grouped_frames(paths: Sequence[Path]) -> list[list[Path]]:
    """Divide mesh files into the frames of each body, in natural order.

    Files whose names differ in their last number alone are the frames of one body. Files without such partners are the
    frames of one body in the order in which they are given.

    Raises:
        InputError: If the bodies differ in their number of frames, or in the numbers of these.
    """
    groups: dict[tuple[Path, str, int], list[Path]] = {}
    for index, path in enumerate(paths):
        pattern = pattern_of(path)
        # A file without a number may be given twice, as at both ends of a motion that comes back.
        groups.setdefault((path.parent, pattern, 0 if "#" in pattern else index), []).append(path)
    if all(len(group) == 1 for group in groups.values()):
        return [list(paths)]
    (_, first_pattern, _), first = next(iter(groups.items()))
    for (_, pattern, _), group in groups.items():
        if len(group) != len(first):
            raise InputError(
                f"the frames are {len(first)} files {first_pattern} and {len(group)} {pattern}; each body needs one "
                "file for each frame, and what does not move is given with --static"
            )
    ordered = [sorted(group, key=lambda path: natural_key(path.name)) for group in groups.values()]
    for group in ordered:
        for path, other in zip(group, ordered[0], strict=True):
            if _last_number(path) != _last_number(other):
                raise InputError(
                    f"the frames {path.name} and {other.name} would be of one time; number the files of each body alike"
                )
    return ordered


def _last_number(path: Path) -> int:
    return int(_NUMBER.findall(path.stem)[-1])
