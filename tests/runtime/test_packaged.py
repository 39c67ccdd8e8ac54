"""Kernels that come with the package: loaded without a compiler or a cache; compiled where they are no good."""

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import one_kernel
import pytest
import warp as wp
from ccd_warp.kernels.kept_code import codes
from ccd_warp.kernels.later import sources
from one_kernel import double, load_anew
from programs import begun
from scenes import sheet_over_floor
from shared_objects import SharedObjects
from warp._src import build

import ccd_warp as ccd
from ccd_warp._cli.compile import WORDS, needed
from ccd_warp._runtime import kept_hashes, launch, packaged
from ccd_warp._runtime.beforehand import compile_modules
from ccd_warp._runtime.every_module import every_module
from ccd_warp._runtime.kept_hashes import hashes_of
from ccd_warp._runtime.kernel_cache import load_or_repair
from ccd_warp._runtime.lanes import cpu_lanes
from ccd_warp._runtime.quiet import start_warp
from ccd_warp._runtime.target import cpu_target, set_flags


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder in place of that of the package, for objects from the usual cache."""
    start_warp()
    monkeypatch.setattr(packaged, "FOLDER", tmp_path / "objects")
    yield packaged.FOLDER
    packaged._index.cache_clear()


@pytest.fixture
def package(folder, tmp_path, monkeypatch):
    """The folder with a kernel, and an empty cache; what the compiler makes of the kernel is kept in the usual one."""
    objects = SharedObjects(Path(wp.config.kernel_cache_dir) / "ccd_warp_objects")
    monkeypatch.setattr(build, "build_cpu", objects.build_cpu)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "made"))
    _fill({"double": double.module})
    (tmp_path / "cache").mkdir()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path / "cache"))
    return folder


def _fill(modules):
    """Put modules into the folder of the package."""
    packaged._index.cache_clear()
    packaged.FOLDER.mkdir()
    for name, path in compile_modules(modules, cpu_target()).items():
        shutil.copyfile(path, packaged.FOLDER / name)
    hashes = {key: kept for module in modules.values() for key, kept in hashes_of(module, 1).items()}
    packaged.write_index(packaged.FOLDER, hashes)
    packaged._index.cache_clear()


def _load_anew():
    """Load the kernel and launch it; whether it was compiled."""
    load_anew()
    return any(Path(wp.config.kernel_cache_dir).iterdir())


@pytest.mark.filterwarnings("error")
def test_a_kernel_of_the_package_is_loaded_from_there_and_nothing_is_written(package):
    files = {path: path.stat() for path in package.iterdir()}
    assert not _load_anew()
    assert files == {path: path.stat() for path in package.iterdir()}


DAMAGE = one_kernel.DAMAGE | {
    "another object of its length": (".o", lambda content: content[::-1]),
    "an object that is gone": (".o", None),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_kernel_of_the_package_is_named_and_compiled_instead(package, name):
    ending, damage = DAMAGE[name]
    (path,) = package.glob(f"*{ending}")
    path.write_bytes(damage(path.read_bytes())) if damage else path.unlink()
    with pytest.warns(RuntimeWarning, match="of the package cannot be loaded .it is damaged.* is compiled instead"):
        assert _load_anew()
    assert path.exists() == bool(damage)


def test_an_object_that_was_empty_when_it_was_packed_is_passed_over(package):
    (path,) = package.glob("*.o")
    path.write_bytes(bytes(path.stat().st_size))
    packaged.write_index(package, {})
    packaged._index.cache_clear()
    assert _load_anew()


def _of_other_warp(package):
    index = json.loads((package / packaged.INDEX).read_text("utf-8"))
    (package / packaged.INDEX).write_text(json.dumps(index | {"warp": "1.18.0"}))
    return f"those of the package are for Warp 1.18.0; this is {wp.config.version}"


def _half_an_index(package):
    text = (package / packaged.INDEX).read_text("utf-8")
    (package / packaged.INDEX).write_text(text[: len(text) // 2])
    return "this installation holds none"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("change", [_of_other_warp, _half_an_index])
def test_a_package_that_does_not_fit_is_as_if_it_were_not_there(package, change):
    assert packaged.why_none(wp.get_device("cpu")) == "" and packaged.has_any()
    reason = change(package)
    packaged._index.cache_clear()
    assert _load_anew()
    assert packaged.why_none(wp.get_device("cpu")).startswith(reason) and not packaged.has_any()


def test_a_hash_is_recalled_for_the_same_sources_code_and_options_alone(package, monkeypatch):
    def is_recalled():
        double.module.mark_modified()
        set_flags(double.module, wp.get_device("cpu"))
        kept_hashes.recall(double.module, 1, packaged._index())
        return 1 in double.module.hashers

    double.module.mark_modified()
    computed = double.module.get_module_hash(1), double.hash, double.grid_stride
    assert is_recalled()
    assert computed == (double.module.get_module_hash(1), double.hash, double.grid_stride)
    assert not _load_anew()
    with monkeypatch.context() as patch:
        patch.setitem(double.module.options, "max_unroll", 3)
        assert not is_recalled()
    with monkeypatch.context() as patch:
        path = next(iter(codes))
        patch.setitem(codes, path, compile(f"{sources[path].decode()}\nSTALE = 1", path, "exec"))
        patch.setattr(kept_hashes, "_as_written", set())
        assert not is_recalled()
        with pytest.raises(ValueError, match="stale bytecode of kernels; remove the folders __pycache__"):
            packaged.write_index(package, {})
    assert is_recalled()
    monkeypatch.setattr(kept_hashes, "digest_of_sources", lambda: "of others")
    assert not is_recalled()


@pytest.mark.parametrize(("arch", "chosen"), [(90, None), (89, 86), (86, 86), (80, 80), (75, None), (121, 120)])
def test_a_gpu_is_given_the_newest_code_of_its_own_generation(package, arch, chosen):
    module = SimpleNamespace(get_module_hash=lambda _: b"\x01", loads=[], name="m", hashers={64: None})
    module.load = lambda *_, **where: module.loads.append((where["output_arch"], where["binary_path"].name))
    for name in ("01.meta", "01.sm80.cubin", "01.sm86.cubin", "01.sm120.cubin"):
        (package / name).touch()
    packaged.write_index(package, {})
    packaged._index.cache_clear()
    loads = [(chosen, f"01.sm{chosen}.cubin")] if chosen else []
    device = SimpleNamespace(is_cpu=False, arch=arch)
    assert packaged.load_packaged(module, device, 64) == bool(chosen) and module.loads == loads


OF_PROCESS = """
import sys
from pathlib import Path

from warp._src import build

from ccd_warp._runtime import packaged

packaged.FOLDER = Path(sys.argv[1])
build.build_cpu = None
from runtime import test_packaged

print(test_packaged.ccd.mesh_ccd(*test_packaged.sheet_over_floor(4)).vertex_toi.tobytes().hex())
"""


def test_two_processes_at_once_need_neither_a_compiler_nor_a_cache(folder, tmp_path):
    every = every_module(cpu_lanes())
    _fill({name: every[name] for name in needed(every, {"mesh_ccd"})})
    (tmp_path / "file").touch()
    variables = {"WARP_CACHE_PATH": str(tmp_path / "file"), "TMPDIR": str(tmp_path)}

    def shown_with(objects):
        return begun(tmp_path, "-P", "-c", OF_PROCESS, objects, **variables)[1:]

    with ThreadPoolExecutor(2) as threads:
        both = [*threads.map(shown_with, [folder, folder])]
    expected = ccd.mesh_ccd(*sheet_over_floor(4)).vertex_toi.tobytes().hex()
    assert [out.split()[-1:] for out, _ in both] == [[expected]] * 2, both[0][1]
    assert not list(tmp_path.glob("ccd_warp_*")), "the cache in place of that which cannot be is gone at the end"
    assert f"cannot be written in {tmp_path}/file" in shown_with(tmp_path)[1]


def _planar():
    square, edges = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), [[0, 1], [1, 2], [2, 3], [3, 0]]
    mesh = ccd.CollisionMesh.from_arrays([(square, edges), (square + [2, 0], edges)])
    return mesh, mesh.vertices, mesh.vertices - np.outer(mesh.vertex_body == 1, [1.5, 0])


def _launch(mesh, start, end):
    vec = wp.vec3d if mesh.dimension == 3 else wp.vec2d
    ends = [wp.array(x, dtype=vec, device="cpu") for x in (start, end)]
    return ccd.CollisionPipeline(mesh, device="cpu").launch(*ends)


def _ground(mesh, start, end):
    plane = ccd.HalfSpace([0, 0, -0.1], [0, 0, 1.0])
    mesh = ccd.CollisionMesh.from_arrays([(start[:25], mesh.faces[:32]), plane])
    return ccd.mesh_ccd(mesh, mesh.vertices, end[:25])


def _turn(mesh, start, end):
    bodies = [(x, mesh.faces[:32]) for x in np.split(start, 2)]
    turning = ccd.CollisionMesh.from_arrays(bodies, rigid=[0], static=[1], self_collision=False)
    motion = ccd.RigidMotion([[0, 0, 0, 0, 0, 0, 1.0]], twist=[[0, 0, 0.1, 0, 0.3, 1.0]])
    return ccd.mesh_ccd(turning, turning.vertices, turning.vertices, motion=motion)


SEPARATION = {"minimum_separation": 0.5}
OF_WORDS = {
    "mesh_ccd": ccd.mesh_ccd,
    "pairs": lambda *_: ccd.point_point_ccd(np.zeros((600, 2, 3)), np.ones((600, 2, 3)), device="cpu"),
    "collision_free_step,separation": lambda mesh, *ends: ccd.collision_free_step(mesh, *ends[::-1], **SEPARATION),
    "line_search,separation": lambda mesh, *ends: ccd.line_search(mesh, *ends[::-1], **SEPARATION),
    "launch": _launch,
    "thickness": lambda *scene: ccd.mesh_ccd(*scene, minimum_distance=0.01),
    "float32": lambda *scene: ccd.mesh_ccd(*scene, precision="float32"),
    "2d,launch": lambda *_: _launch(*_planar()),
    "hash": lambda *scene: ccd.mesh_ccd(*scene, broad_phase="hash"),
    "half_spaces": _ground,
    "excluded_pairs": lambda mesh, *ends: ccd.mesh_ccd(mesh.excluding({"bodies": [[0, 1]]}), *ends),
    "find_candidates": ccd.find_candidates,
    "find_proximity": lambda mesh, start, end: ccd.find_proximity(mesh, start, 2.0),
    "find_intersections": lambda mesh, start, end: ccd.find_intersections(mesh, start * [1, 1, 0.0]),
    "motion": _turn,
    "gradients": lambda *scene: ccd.mesh_ccd(*scene).contacts.toi_gradient(),
}


def test_every_word_has_a_call():
    assert {word for words in OF_WORDS for word in words.split(",")} == WORDS.keys()


@pytest.mark.parametrize("words", OF_WORDS)
def test_a_call_finds_all_modules_that_its_words_have_compiled(words, monkeypatch):
    names = {module.name: name for name, module in every_module(cpu_lanes()).items()}
    loaded = set()

    def load(kernel, device, block_dim):
        loaded.add(names[kernel.module.name])
        load_or_repair(kernel, device, block_dim)

    monkeypatch.setattr(launch, "load_or_repair", load)
    monkeypatch.setattr(launch, "_loaded", set())
    with wp.ScopedDevice("cpu"):
        OF_WORDS[words](*sheet_over_floor(4))
    compiled = {*needed(names.values(), words.split(","))}
    assert loaded <= compiled
    is_plain = words in ("mesh_ccd", "pairs")
    assert (loaded <= {*needed(names.values(), ["mesh_ccd"])}) == is_plain, "the words are needed"


HASHES = """
import json
import sys

from ccd_warp._runtime import every_module

is_backwards = sys.argv[2] == "backwards"
step = -1 if is_backwards else 1
for name in ("_REALS", "_NORMS"):
    setattr(every_module, name, getattr(every_module, name)[::step])
import warp as wp

from ccd_warp._engine.stages import measure_pairs_in
from ccd_warp._runtime.lanes import narrow_phase_on, search_on
from ccd_warp._runtime.target import set_flags
from ccd_warp._runtime.quiet import start_warp
from ccd_warp.kernels.pair.norm import Norm

start_warp()
cpu, asked = wp.get_device("cpu"), []
if is_backwards:  # as calls do, before all others
    asked += [measure_pairs_in(norm, cpu) for norm in (Norm.MAXIMUM, Norm.EUCLIDEAN)]
    asked += [narrow_phase_on(cpu, real, Norm.EUCLIDEAN).solve_pairs for real in (wp.float32, wp.float64)]
    asked += [search_on(cpu, "search_trees", end, False, is_cuda=False) for end in ("boxes", "cull")]
modules = every_module.every_module(int(sys.argv[1]))
hashes = []
for module in [kernel.module for kernel in asked] + [*modules.values()][::step]:
    set_flags(module, cpu)
    hashes.append(module.get_module_hash(1).hex())
print(json.dumps([hashes[: len(asked)], {name: module.get_module_hash(1).hex() for name, module in modules.items()}]))
"""


def test_the_hash_of_a_module_does_not_depend_on_what_the_process_has_built_before_and_calls_ask_for_it(tmp_path):
    found = []
    for order in ("forwards", "backwards"):
        status, shown, error = begun(tmp_path, "-P", "-c", HASHES, cpu_lanes(), order)
        assert status == 0, error
        found.append(json.loads(shown.splitlines()[-1]))
    (_, hashes), (asked, others) = found
    assert hashes == others and len(hashes) > 50 and len(asked) == 6 and set(asked) <= set(hashes.values())
