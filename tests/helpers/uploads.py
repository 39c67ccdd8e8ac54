"""On a GPU launches take arrays that are there: those of NumPy that a test gives them are copied, and back after."""

from functools import wraps

import numpy as np
import warp as wp

import ccd_warp as ccd

__name__ = "ccd_warp.uploads"  # a warning is as of the first line above that is not of the package: of the test


def _uploading(method):
    """A method that takes arrays on a device; the one that the package has is its ``__wrapped__``."""

    @wraps(method)
    def call(self, *given, **options):
        device, copies = (getattr(self, "_topology", None) or self.count).device, []
        written = options.get("vertices_t1", given[-1] if given else None) if "search" in method.__name__ else None
        is_read_only = type(written) is np.ndarray and not written.flags.writeable
        if not device.is_cuda or device.is_capturing or is_read_only:
            return method(self, *given, **options)

        def there(value):
            is_taken = type(value) is np.ndarray and value.dtype in (np.float64, np.float32) and value.ndim > 1
            if not is_taken or not value.flags.c_contiguous:
                return value  # which is refused
            copies.append((value, wp.array(value, device=device)))
            return copies[-1][1]

        result = method(self, *map(there, given), **{name: there(value) for name, value in options.items()})
        for value, array in copies:
            if value is written:
                value[...] = array.numpy()
        return result

    return call


def upload_to_launches():
    """Let launches on a GPU take arrays of NumPy, as those on the CPU do, until the end of the process."""
    of_pipeline = "launch", "launch_line_search", "launch_proximity", "launch_displacement_bounds"
    pipeline = ccd.CollisionPipeline
    for owner, name in (*((pipeline, name) for name in of_pipeline), (ccd.DeviceContacts, "points_at")):
        setattr(owner, name, _uploading(getattr(owner, name)))
