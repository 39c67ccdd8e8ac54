"""Unpack archives of mesh files in memory, up to a limit: a few megabytes can unpack to any number of gigabytes."""

import bz2
import gzip
import io
import tarfile
import zipfile

from ccd_warp._input.messages import InputError

# Ends of names, and 3MF, which is a ZIP archive by another name.
ARCHIVES = (".zip", ".tar.gz", ".tar.bz2", ".bz2", ".3mf")
# What an archive may unpack to if nothing else is said, 256 MiB: four million triangles in text, eight in binary PLY.
# Text of short numbers takes up to thirteen times its size while it is read.
MAX_BYTES = 1 << 28
_CHUNK = 1 << 20  # bytes that are unpacked at a time


def archive_end(name: str) -> str | None:
    """How the name of an archive ends; None where it is no archive."""
    return next((end for end in ARCHIVES if name.lower().endswith(end)), None)


def unpack(name: str, data: bytes, max_bytes: int) -> list[tuple[str, bytes]]:
    """The files of an archive.

    Args:
        name: Of the archive; its end says of which kind it is.
        data: The archive.
        max_bytes: What it may unpack to.

    Returns:
        Name and content of each file, in the order of the archive.

    Raises:
        InputError: If the archive is damaged or unpacks to more.
    """
    end = archive_end(name)
    try:
        if end in (".zip", ".3mf"):
            return _unpack_zip(data, max_bytes)
        opened = gzip.open if end == ".tar.gz" else bz2.open
        with opened(io.BytesIO(data), "rb") as stream:
            # With one byte more than allowed it is known to be too much.
            content = stream.read(max_bytes + 1)
        if len(content) > max_bytes:
            raise _too_large(None, max_bytes)
        return [(name[: -len(".bz2")], content)] if end == ".bz2" else _unpack_tar(content)
    except InputError:
        raise
    except Exception as error:  # zlib, bz2, lzma, zipfile and tarfile each raise their own
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"cannot be unpacked ({reason}); copy or pack it again") from error


def _unpack_zip(data: bytes, max_bytes: int) -> list[tuple[str, bytes]]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [member for member in archive.infolist() if not member.is_dir()]
        stated = sum(member.file_size for member in members)
        if stated > max_bytes:
            raise _too_large(stated, max_bytes)
        files = []
        for member in members:
            with archive.open(member) as stream:
                # In chunks, because what a member unpacks to need not be what the archive states. The stream ends at
                # the stated size and checks the sum there.
                files.append((member.filename, b"".join(iter(lambda: stream.read(_CHUNK), b""))))
        return files


def _unpack_tar(content: bytes) -> list[tuple[str, bytes]]:
    if not content.endswith(bytes(1024)):
        raise InputError("the archive does not end as it must, with 1024 zeros; copy or pack it again")
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:") as archive:
        files = []
        for member in archive:
            if not member.isfile() or member.issparse():
                if member.isdir():
                    continue
                raise InputError(f"holds {member.name}, a link or another thing that is no plain file; pack it without")
            stream = archive.extractfile(member)
            assert stream is not None, "a plain file has a content"
            files.append((member.name, stream.read()))
        return files


def _too_large(stated: int | None, max_bytes: int) -> InputError:
    found = "more" if stated is None else f"{stated:,} bytes"
    return InputError(
        f"unpacks to {found}, and the limit is {max_bytes:,} bytes; raise it with --max-bytes (max_bytes= in Python) "
        "if you trust the archive"
    )
