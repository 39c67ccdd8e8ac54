"""Puts together what ``gpu_check pack`` has divided: ``python3 unpack.py --into DIR [FOLDER …]``.

A program of its own, for a machine that has Python and no more: it lies beside the parts. Parts may come one by one:
each call copies those that it finds into ``DIR/parts``, and unpacks when all are there. A part that is missing or
damaged is named, and the exit status is 2; with ``--collect`` a missing one is no error.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import lzma
import os
import platform
import shutil
import sys
import tarfile
from pathlib import Path

MANIFEST = "parts.json"
_OLDEST = (3, 11)
_CHUNK = 1 << 20


def digest_of(path: Path) -> str:
    """SHA-256 of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


class _Joined:
    """Files read one after another as one."""

    def __init__(self, paths: list[Path]) -> None:
        self._paths, self._file = list(paths), None

    def read(self, size: int = -1) -> bytes:
        """The next bytes, none at the end of the last file."""
        while True:
            data = self._file.read(size) if self._file else b""
            if data or not self._paths:
                return data
            if self._file:
                self._file.close()
            self._file = self._paths.pop(0).open("rb")


def collect(archive: str, parts: list[dict], folders: list[Path], kept: Path) -> tuple[list[Path], list[str]]:
    """Copy the parts of an archive that are whole; returns their places, and what is missing or damaged, in words."""
    paths, lacking = [], []
    for k, part in enumerate(parts):
        place = kept / part["name"]
        what = f"part {k + 1} of {len(parts)} of {archive}, {part['name']},"
        if place.is_file() and digest_of(place) == part["sha256"]:
            paths.append(place)
            continue
        found = [folder / part["name"] for folder in folders if (folder / part["name"]).is_file()]
        if not found:
            lacking.append(f"{what} is missing; expected it in {' or '.join(map(str, folders))}")
        elif digest_of(found[0]) != part["sha256"]:
            size = found[0].stat().st_size
            lacking.append(f"{what} is damaged: {found[0]} has {size} bytes of other content; expected {part['bytes']}")
        else:
            new = place.with_suffix(".new")
            shutil.copyfile(found[0], new)
            os.replace(new, place)
            paths.append(place)
    return paths, lacking


def unpack(paths: list[Path], into: Path) -> None:
    """Unpack an archive that lies in parts."""
    with lzma.open(_Joined(paths)) as stream, tarfile.open(fileobj=stream, mode="r|") as archive:  # type: ignore[call-overload]
        safe = {"filter": "data"} if hasattr(tarfile, "data_filter") else {}
        archive.extractall(into, **safe)


def main(arguments: list[str] | None = None) -> int:
    """The command; returns its exit status."""
    parser = argparse.ArgumentParser(description="Put together what gpu_check pack has divided.")
    here = Path(__file__).resolve().parent
    parser.add_argument("folders", metavar="FOLDER", type=Path, nargs="*", help="where parts are (beside this file)")
    parser.add_argument("--into", metavar="DIR", type=Path, required=True, help="where to unpack")
    parser.add_argument("--collect", action="store_true", help="take what is there, and say what is still missing")
    given = parser.parse_args(arguments)
    folders = given.folders or [here]
    manifest = next((folder / MANIFEST for folder in [*folders, here] if (folder / MANIFEST).is_file()), None)
    try:
        if manifest is None:
            raise ValueError(f"{MANIFEST} is missing; expected it in {' or '.join(map(str, folders))}")
        raw = json.loads(manifest.read_text(encoding="utf-8"))
        if raw["machine"] != platform.machine():
            raise ValueError(
                f"this machine is {platform.machine()}; expected {raw['machine']}, for which Warp was packed"
            )
        if sys.version_info < _OLDEST:
            raise ValueError(
                f"this is Python {platform.python_version()}; expected {'.'.join(map(str, _OLDEST))} or newer"
            )
        kept = given.into / "parts"
        kept.mkdir(parents=True, exist_ok=True)
        lacking = []
        for archive, parts in raw["archives"].items():
            mark = given.into / f".{archive}"  # says of which parts the folder is made
            made_of = "\n".join(part["sha256"] for part in parts)
            if mark.is_file() and mark.read_text() == made_of:
                continue
            paths, words = collect(archive, parts, folders, kept)
            lacking += words
            if not words:
                mark.unlink(missing_ok=True)
                unpack(paths, given.into)
                mark.write_text(made_of)
                for path in paths:
                    path.unlink()
    except (ValueError, OSError, EOFError, lzma.LZMAError, tarfile.TarError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if any("damaged" in line for line in lacking) or (lacking and not given.collect):
        print("\n".join(f"error: {line}" for line in lacking), file=sys.stderr)
        return 2
    if lacking:
        print("\n".join(lacking))
        return 0
    for name in raw["needs"]:
        if importlib.util.find_spec(name) is None:
            print(f"error: {name} is not installed for {sys.executable}, and not carried; expected it", file=sys.stderr)
            return 2
    print(f"unpacked; sh {given.into / 'gpu_check.sh'} --output DIR runs the check")
    return 0


if __name__ == "__main__":
    sys.exit(main())
