"""Files of kernels as templates: one specialisation for each set of the parameters on which a file depends."""

import gc

import pytest
import warp as wp
from ccd_warp.kernels import atomics
from ccd_warp.kernels.once import once
from ccd_warp.kernels.pair import patch
from ccd_warp.kernels.template import specialised


def test_there_is_one_specialisation_for_each_set_of_the_parameters_on_which_a_file_depends():
    assert specialised("pair.patch") is patch is specialised("pair.patch", real=wp.float64, width=1)
    single = specialised("pair.patch", real=wp.float32)
    assert single is specialised("pair.patch", width=1, real=wp.float32)
    assert single.Corners is not patch.Corners and single.Vec3 is specialised("pair.simd", real=wp.float32).Vec3
    assert specialised("pair.patch", norm="thick", dimension=2) is patch
    assert specialised("atomics", real=wp.float32) is atomics  # imports no parameter
    with pytest.raises(ValueError, match=r"pair\.patch is asked for with breadth; expected parameters"):
        specialised("pair.patch", breadth=8)


def test_a_plain_import_shares_its_code_with_specialisations():
    """Warp parses the source of a function once for each code object."""
    for function in (patch.corners_at, atomics.claim):
        name = function.func.__module__.removeprefix("ccd_warp.kernels.")
        code = specialised(name, real=wp.float32, width=8).__dict__[function.key.rpartition(".")[2]].func.__code__
        assert code is function.func.__code__


@pytest.mark.parametrize("was_enabled", [True, False])
def test_the_garbage_collector_is_off_while_something_is_made_and_then_as_it_was(was_enabled):
    @once
    def made(fails):
        assert not gc.isenabled()
        if fails:
            raise InterruptedError
        return once(lambda: gc.isenabled())(), gc.isenabled()

    try:
        (gc.enable if was_enabled else gc.disable)()
        with pytest.raises(InterruptedError):
            made(True)
        assert gc.isenabled() == was_enabled and made(False) == (False, False) and gc.isenabled() == was_enabled
    finally:
        gc.enable()
