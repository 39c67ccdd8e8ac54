"""The command that counts what the CUDA compilers make of each kernel, without a GPU."""

import json

import pytest
from ccd_warp.benchmarks import cuda_code
from ccd_warp.benchmarks.cuda_figures import count, warps

PTX = """
.version 9.0
.func  (.param .b64 func_retval0) rare_0(
	.param .b64 rare_0_param_0
)
.noinline
{
	.reg .f64 	%fd<3>;
	ld.param.f64 	%fd1, [rare_0_param_0];
	st.param.f64 	[func_retval0+0], %fd1;
	ret;
}
	// .globl	make_x__locals__move_1234abcd_cuda_kernel_forward
.visible .entry make_x__locals__move_1234abcd_cuda_kernel_forward(
	.param .u64 p0
)
{
	.reg .f64 	%fd<3>;
	{ // callseq 0, 0
	.param .b64 param0;
	call.uni (retval0),
	rare_0,
	(
	param0
	);
	} // callseq 0
$L__BB1_2:
	ret;
}
.visible .entry stay_1234abcd_cuda_kernel_forward(
)
{
	ret;
}
"""
SAID = """ptxas info    : Compiling entry function 'stay_1234abcd_cuda_kernel_forward' for 'sm_90'
ptxas info    : Function properties for stay_1234abcd_cuda_kernel_forward
    0 bytes stack frame, 0 bytes spill stores, 0 bytes spill loads
ptxas info    : Used 8 registers, used 0 barriers
ptxas info    : Compiling entry function 'make_x__locals__move_1234abcd_cuda_kernel_forward' for 'sm_90'
ptxas info    : Function properties for make_x__locals__move_1234abcd_cuda_kernel_forward
    64 bytes stack frame, 16 bytes spill stores, 24 bytes spill loads
ptxas info    : Used 100 registers, used 0 barriers, 96 bytes cumulative stack size, 8 bytes smem
ptxas info    : Function properties for rare_0
    0 bytes stack frame, 4 bytes spill stores, 8 bytes spill loads
"""
DISASSEMBLY = """
	.section	.text.make_x__locals__move_1234abcd_cuda_kernel_forward,"ax",@progbits
        /*0000*/                   LDC R1, c[0x0][0x28] ;
        /*0010*/              @!P0 LDG.E.128 R4, desc[UR4][R2.64] ;
        /*0020*/                   EXIT ;
	.section	.text.stay_1234abcd_cuda_kernel_forward,"ax",@progbits
        /*0000*/                   EXIT ;
"""


def test_a_kernel_counts_with_the_functions_that_it_calls():
    figures = count(PTX, SAID, DISASSEMBLY)
    moved = {"registers": 100, "stack": 96, "spill_stores": 20, "spill_loads": 32, "ptx": 5, "ptx_own": 2}
    assert figures["move"] == {**moved, "sass": 3, "wide_loads": 1, "warps": 19}
    assert figures["stay"]["registers"] == 8 and figures["stay"]["ptx"] == 1 and figures["stay"]["sass"] == 1
    assert "sass" not in count(PTX, SAID)["move"]


@pytest.mark.parametrize(("registers", "expected"), [(16, 64), (32, 64), (64, 32), (128, 16), (168, 12), (255, 8)])
def test_warps_that_the_registers_of_a_multiprocessor_allow(registers, expected):
    assert warps(registers) == expected


def test_without_ptxas_the_error_says_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(cuda_code, "find_tool", lambda name: None)
    assert cuda_code.main(["--output", str(tmp_path)]) == 1
    assert "pip install -e '.[cuda-tools]'" in capsys.readouterr().err


def test_a_ptxas_older_than_the_ptx_is_named(tmp_path):
    old = tmp_path / "ptxas"
    old.write_text("#!/bin/sh\necho \"ptxas fatal : Unsupported .version 9.4; current version is '9.0'\" >&2\nexit 1\n")
    old.chmod(0o755)
    with pytest.raises(ValueError, match=r"Unsupported .version 9\.4.*cuda-tools"):
        cuda_code.assemble(old, PTX, 90, tmp_path / "x.cubin")


def test_figures_stand_beside_those_from_before():
    before = {"a: move": {"registers": 255}, "a: gone": {"registers": 8}}
    lines = cuda_code.as_table({"a: move": {"registers": 96}}, before).splitlines()
    assert "| 255 → 96 |" in lines[2] and "| 8 → – |" in lines[3]


def test_the_command_writes_the_figures_of_a_module(tmp_path, capsys):
    try:
        cuda_code.require_ptxas()
    except ValueError as error:
        pytest.skip(str(error))
    status = cuda_code.main(["--output", str(tmp_path), "--modules", "body_boxes"])
    captured = capsys.readouterr()
    if "Unsupported .version" in captured.err:
        pytest.skip("ptxas is older than the compiler of Warp")
    assert status == 0, captured.err
    kernels = json.loads((tmp_path / "cuda_code.json").read_text())["kernels"]
    assert kernels and all(row["registers"] > 0 and row["ptx"] > 0 for row in kernels.values())
    assert all(f"| {name} |" in captured.out for name in kernels)


def test_a_word_that_no_module_has_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(cuda_code, "require_ptxas", lambda: tmp_path / "ptxas")
    assert cuda_code.main(["--output", str(tmp_path), "--modules", "nothing"]) == 1
    assert "no module has one of ['nothing']" in capsys.readouterr().err
