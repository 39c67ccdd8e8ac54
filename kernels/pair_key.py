"""A pair as one number: the keys that the search writes, and that the collision filter looks up."""

import warp as wp


@wp.func
def pair_key(first: int, second: int) -> wp.int64:
    """A pair of primitives as one number; ascending keys order the pairs lexicographically."""
    return (wp.int64(first) << wp.int64(32)) | wp.int64(second)


@wp.func
def pair_of(key: wp.int64) -> wp.vec2i:
    """The pair of a key."""
    return wp.vec2i(wp.int32(key >> wp.int64(32)), wp.int32(key & wp.int64(0xFFFFFFFF)))
