"""Check glTF and GLB files before trimesh reads them: lengths, and content that trimesh would silently ignore."""

import base64
import json
from collections.abc import Callable
from typing import Any

from ccd_warp._files.text import CUT, shown
from ccd_warp._input.messages import InputError

_GLB_HEADER = 12  # bytes: magic, version, length
_LONGEST_NAME = 1 << 10  # of a file beside it; what is longer is a buffer whose beginning is damaged
# Extensions that a file may require and that do not affect its triangles.
_HARMLESS = (
    "KHR_mesh_quantization",
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "EXT_texture_",
    "EXT_lights_",
    "MSFT_texture_",
)
_READ_MODES = (0, 1, 4, 5)  # points, lines, triangles, strips; trimesh ignores the others


def check_glb(data: bytes, fetch: Callable[[str], bytes]) -> None:
    """Reject a GLB file that is truncated or that trimesh would read only in part.

    Args:
        data: Content of the file.
        fetch: Returns the content of a file to which it refers.
    """
    if data[:4] != b"glTF" or len(data) < _GLB_HEADER:
        raise InputError(f"begins with {shown(data[:4])}; expected a GLB file, which begins with 'glTF'")
    length = int.from_bytes(data[8:12], "little")
    if length != len(data):
        raise InputError(f"has {len(data)} bytes, but its header says {length}; {CUT}")
    chunks = []
    at = _GLB_HEADER
    while at < length:
        size = int.from_bytes(data[at : at + 4], "little")
        if at + 8 + size > length:
            raise InputError(f"the chunk at byte {at} goes beyond the end of the file; {CUT}")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 8 + size
    if not chunks or chunks[0][0] != b"JSON":
        raise InputError(f"its first chunk is no JSON; {CUT}")
    binary = [chunk for name, chunk in chunks if name == b"BIN\0"]
    _check_tree(_parse(chunks[0][1]), binary[0] if binary else b"", fetch)


def check_gltf(data: bytes, fetch: Callable[[str], bytes]) -> None:
    """Refuse a glTF file that trimesh would read in part; its buffers are separate files or text within it."""
    _check_tree(_parse(data), b"", fetch)


def _parse(text: bytes) -> dict[str, Any]:
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"its JSON cannot be read ({error}); {CUT}") from None
    if not isinstance(tree, dict):
        raise InputError(f"its JSON is no object; {CUT}")
    return tree


def _check_tree(tree: dict[str, Any], binary: bytes, fetch: Callable[[str], bytes]) -> None:
    required = [name for name in tree.get("extensionsRequired", ()) if not name.startswith(_HARMLESS)]
    if required:
        raise InputError(f"requires the extension {required[0]!r}, which is not read; export the file without it")
    for k, buffer in enumerate(tree.get("buffers", ())):
        uri = buffer.get("uri")
        if uri is None:
            found = len(binary)
        elif uri.startswith("data:"):
            try:
                found = len(base64.b64decode(uri.partition("base64,")[2], validate=True))
            except ValueError as error:
                raise InputError(f"buffer {k} is no base64 ({error}); {CUT}") from None
        elif len(uri) > _LONGEST_NAME:
            begin = shown(uri[:_LONGEST_NAME].encode())
            raise InputError(f"buffer {k} lies in {begin}, no file has a name of {len(uri):,} characters; {CUT}")
        else:
            found = len(fetch(uri))
        if found < buffer["byteLength"]:
            where = "" if uri is None or uri.startswith("data:") else f" ({uri})"
            raise InputError(f"buffer {k}{where} has {found} bytes, expected {buffer['byteLength']}; {CUT}")
    sizes = [buffer["byteLength"] for buffer in tree.get("buffers", ())]
    for k, view in enumerate(tree.get("bufferViews", ())):
        if (
            not 0 <= view["buffer"] < len(sizes)
            or view.get("byteOffset", 0) + view["byteLength"] > sizes[view["buffer"]]
        ):
            raise InputError(f"its buffer view {k} goes beyond its buffer {view['buffer']}; {CUT}")
    accessors = tree.get("accessors", ())
    for k, mesh in enumerate(tree.get("meshes", ())):
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode not in _READ_MODES:
                raise InputError(f"mesh {k} has primitives of mode {mode}, which is not read; export it as triangles")
            position = primitive["attributes"].get("POSITION")
            if position is not None and accessors[position].get("normalized"):
                raise InputError(f"mesh {k} has positions in normalized integers, which are not read; export floats")
            for index in (position, primitive.get("indices")):
                if index is not None and ("sparse" in accessors[index] or "bufferView" not in accessors[index]):
                    raise InputError(f"mesh {k} is compressed or sparse, which is not read; export it without that")
