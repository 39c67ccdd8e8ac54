"""Poses of rigid bodies on the command line: ``--poses FILE`` and ``--path``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ccd_warp._input.messages import InputError

if TYPE_CHECKING:
    from ccd_warp._pose_sequence import PoseSequence


def check_poses(arguments: argparse.Namespace) -> None:
    """Refuse what does not go together."""
    if arguments.poses is None:
        if arguments.path is not None:
            raise InputError(f"--path {arguments.path} is given without --poses; expected both, or neither")
    elif getattr(arguments, "end", None) is not None:
        raise InputError("END is given with --poses; expected the mesh in START alone, with each body in its own frame")


def pose_sequence(mesh_path: str | Path, arguments: argparse.Namespace) -> PoseSequence:
    """The bodies of a mesh file at the poses of ``--poses``, and obstacles."""
    from ccd_warp._cli.half_spaces import half_space_bodies
    from ccd_warp._cli.scene import SceneArguments
    from ccd_warp._frames import static_bodies
    from ccd_warp._input.arguments import check_count
    from ccd_warp._pose_sequence import PoseSequence

    limit = check_count("max_bytes", arguments.max_bytes, 2**63 - 1)
    static = static_bodies(arguments.static, max_bytes=limit, surface=arguments.surface, split=arguments.split)
    return PoseSequence(
        Path(mesh_path),
        arguments.poses,
        arguments.path or "linear",
        static + half_space_bodies(arguments.half_space),
        SceneArguments.of(arguments).mesh,
        max_bytes=limit,
        surface=arguments.surface,
        split=arguments.split,
    )
