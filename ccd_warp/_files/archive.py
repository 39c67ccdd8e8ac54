"""Unpack ZIP archives in memory, up to a limit, because a few megabytes can unpack to many gigabytes."""

import io
import zipfile

from ccd_warp._files.text import CUT
from ccd_warp._scene.input.messages import InputError, reason_of

# Default limit on the unpacked size, 256 MiB: four million triangles in text, eight in binary PLY. Text of short
# numbers takes up to thirteen times its size while it is read.
MAX_BYTES = 1 << 28
_MANY = 0xFFFF  # members: the number is elsewhere


def unpack(data: bytes, max_bytes: int) -> list[tuple[str, bytes]]:
    """Name and content of each file of an archive, in its order.

    Raises:
        InputError: If the archive is damaged, or unpacks to more than the limit and more than it takes itself.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            end = data.rindex(b"PK\5\6")
            stated = int.from_bytes(data[end + 10 : end + 12], "little")
            if stated not in (len(members), _MANY):  # as where a size in that record is damaged
                raise InputError(f"its directory lists {len(members)} files, and says that it has {stated}; {CUT}")
            unpacked = sum(member.file_size for member in members)
            if unpacked > max(max_bytes, len(data)):
                raise InputError(
                    f"unpacks to {unpacked:,} bytes, and the limit is {max_bytes:,} bytes; raise it with --max-bytes "
                    "(max_bytes= in Python) if you trust the archive"
                )
            return [(member.filename, _content(archive, member)) for member in members if not member.is_dir()]
    except InputError:
        raise
    except Exception as error:  # zlib and zipfile each raise their own
        raise InputError(f"cannot be unpacked ({reason_of(error)}); copy or pack it again") from error


def _content(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    # of bzip2 and LZMA, Python unpacks all that there is, whatever size is stated
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(f"{member.filename} is packed in a way that is not read; pack it by deflate, as usual")
    with archive.open(member) as stream:
        return stream.read(member.file_size)  # whose end is where the checksum is compared
