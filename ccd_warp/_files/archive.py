"""Unpack archives of mesh files in memory, up to a limit, because a few megabytes can unpack to many gigabytes."""

import bz2
import gzip
import io
import struct
import tarfile
import zipfile

from ccd_warp._files.text import CUT
from ccd_warp._input.messages import InputError, reason_of

# Endings of file names. A 3MF file is a ZIP archive, too.
ARCHIVES = (".zip", ".tar.gz", ".tar.bz2", ".bz2", ".3mf")
# Default limit on the unpacked size, 256 MiB: four million triangles in text, eight in binary PLY. Text of short
# numbers takes up to thirteen times its size while it is read.
MAX_BYTES = 1 << 28
_CHUNK = 1 << 20  # bytes unpacked at a time


def archive_end(name: str) -> str | None:
    """The ending of an archive's name; None if the file is not an archive."""
    return next((end for end in ARCHIVES if name.lower().endswith(end)), None)


def unpack(name: str, data: bytes, max_bytes: int) -> list[tuple[str, bytes]]:
    """The files of an archive.

    Args:
        name: Name of the archive, whose ending gives its format.
        data: Content of the archive.
        max_bytes: Limit on the unpacked size.

    Returns:
        Name and content of each file, in the order of the archive.

    Raises:
        InputError: If the archive is damaged or exceeds the limit.
    """
    end = archive_end(name)
    try:
        if end in (".zip", ".3mf"):
            return _unpack_zip(data, max_bytes)
        opened = gzip.open if end == ".tar.gz" else bz2.open
        with opened(io.BytesIO(data), "rb") as stream:
            # Reading one byte more than allowed suffices to detect an excess.
            content = stream.read(max_bytes + 1)
        if len(content) > max_bytes:
            raise _too_large(None, max_bytes)
        return [(name[: -len(".bz2")], content)] if end == ".bz2" else _unpack_tar(content)
    except InputError:
        raise
    except Exception as error:  # zlib, bz2, lzma, zipfile and tarfile each raise their own
        raise InputError(f"cannot be unpacked ({reason_of(error)}); copy or pack it again") from error


def _unpack_zip(data: bytes, max_bytes: int) -> list[tuple[str, bytes]]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        # A folder holds nothing; of a mesh whose name is damaged, the name before its data is another.
        members = [member for member in plain_members(archive) if not (member.is_dir() and member.compress_size == 0)]
        stated = sum(member.file_size for member in members)
        if stated > max_bytes:
            raise _too_large(stated, max_bytes)
        files = []
        for member in members:
            with archive.open(member) as stream:
                # Read in chunks, because the unpacked size of a member may differ from the stated one. The stream ends
                # at the stated size and verifies the checksum there.
                files.append((member.filename, b"".join(iter(lambda: stream.read(_CHUNK), b""))))
        return files


def plain_members(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """All members of a ZIP archive, which must be stored or deflated, and fill the file up to the directory.

    A directory that is damaged, or the record of its end, may leave members out. Of bzip2 and LZMA, Python unpacks more
    at a time than is asked for.

    Raises:
        InputError: If a member is packed in another way, or there are bytes that belong to none.
    """
    file = archive.fp
    assert file is not None, "the archive is open"
    end, may_follow = 0, [0]
    for member in sorted(archive.infolist(), key=lambda member: member.header_offset):
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(f"{member.filename} is packed in a way that is not read; pack it by deflate, as usual")
        if member.header_offset - end not in may_follow:
            raise InputError(f"holds bytes before {member.filename} that its directory does not list; {CUT}")
        file.seek(member.header_offset + 26)
        lengths = struct.unpack("<HH", file.read(4))  # of the name and of what follows it
        end = member.header_offset + 30 + sum(lengths) + member.compress_size
        # A checksum and two sizes may follow the data, with a mark before them, and the sizes in 4 or 8 bytes.
        may_follow = [12, 16, 20, 24] if member.flag_bits & 8 else [0]
    if archive.start_dir - end not in may_follow:
        raise InputError(f"holds bytes behind its members that its directory does not list; {CUT}")
    return archive.infolist()


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
