"""The public calls, which put the parts together."""

from typing import Any

from ccd_warp._results.contact_place import ContactPlace
from ccd_warp._results.toi_gradient import ToiGradient


def _of_contacts(*arguments: Any) -> ToiGradient:
    from ccd_warp._gradients.toi_slopes import of_contacts  # its kernels are loaded by those who ask for gradients

    return of_contacts(*arguments)


ContactPlace.gradients_of = _of_contacts
