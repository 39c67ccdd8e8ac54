"""A fingerprint of the code that is checked, so that records of another version are not taken for its own."""

from __future__ import annotations

import hashlib
from pathlib import Path

import ccd_warp.kernels

import ccd_warp


def fingerprint() -> str:
    """Hash of every source file of the package, its kernels and this check."""
    digest = hashlib.sha256()
    folders = (ccd_warp.__path__[0], ccd_warp.kernels.__path__[0], str(Path(__file__).parent))
    for folder in folders:
        for path in sorted(Path(folder).rglob("*.py")):
            digest.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]
