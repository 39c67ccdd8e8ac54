"""Every example runs in a short form and finds what it is there to show: by its own count, with CCD and without."""

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from programs import NO_MPI

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NUMBER = r"(-?[\d.,]+(?:e-?\d+)?)"


class Example(NamedTuple):
    """The arguments of a short form of an example, and what it prints: patterns in turn, `#` for a number.

    What has to be true of these numbers is promised. Without the packages that it needs it is skipped, and constants
    are values of names of the module that make the scene a small one.
    """

    arguments: str
    printed: str
    promised: Callable[..., bool]
    needs: tuple[str, ...] = ()
    constants: tuple[tuple[str, Any], ...] = ()


TABLE = {
    # never later than the exact 0.5, and earlier by at most the tolerance 1e-6 of the motion's 9 units over the speed 9
    "bullet_through_wall": Example(
        "", "start of the step: MISS ... end of the step:   MISS ... toi = #", lambda toi: 0.5 - 1e-6 <= toi <= 0.5
    ),
    # δ = 1e-4 over the speed 9, and the bisection's box
    "bullet_2d": Example(
        "",
        "bisection  toi = # ... gap <= #, # boxes ... clipping   toi = # ... # steps",
        lambda early, gap, boxes, toi, steps: (
            0.5 - 1e-4 <= early <= toi <= 0.5 and gap <= 1e-4 and steps < boxes < 1000
        ),
    ),
    # a vertex of the small ball, which comes from the left, and a face of the large one: the normal points to the left
    "mesh_against_mesh": Example(
        "",
        "toi = #, vertex # of the small ball and face # of the large ball ... normal .# ... "
        "step +#, # i ... step +#, # i",
        lambda toi, vertex, face, normal, step, free, _, crossing: (
            0.0 < step < toi < 1.0 and vertex < 642 and face >= 1280 and normal < -0.9 and free == 0 < crossing
        ),
    ),
    # with toi the error is in proportion to the size of a step, without it the derivative is 1
    "bounce_gradient": Example(
        "",
        "\n   25 +# +# ... \n  200 +# +# ... true +#",
        lambda few, one, many, same, true: abs(few - true) < 0.02 and abs(many - true) < 0.005 and one == same == 1.0,
    ),
    "aim": Example("--throws 60", "# of # throws hit on time", lambda hit, throws: hit == throws == 60),
    # where the whole step is cut, what would have opened the gap is cut with it
    "scripted_ball": Example(
        "--frames 50 --resolution 13",
        "contacts: 50 frames, # with inter.* # stand ... distance # of ... cut: 50 frames, # with inter.* # stand",
        lambda crossing, still, least, cut_crossing, cut_still: (
            crossing == cut_crossing == still == 0 and least > 1.0 - 1e-6 and cut_still > 10
        ),
    ),
    # in a strict search no vertex rises; with a fraction of the gap at the start hardly any distance is left
    "two_layers": Example(
        "--frames 24 --resolution 9",
        "frames, # with inter ... distance # mm, after the lift # mm ... by # mm.* rose by # ... frames, # with",
        lambda crossing, least, then, lift, rise, without: (
            crossing == 0 < without and min(least, then) > 1.0 - 1e-9 and abs(rise - lift) < 1e-9
        ),
    ),
    "fsi_membrane": Example(
        "--frames 52 --resolution 10",
        "with CCD: # of # particles are below ... without CCD: # of",
        lambda below, particles, without: below == 0 and without > 0.5 * particles,
    ),
    # the straight way, through the walls, is 6 long, and a string through the windows 7.06
    "many_worlds": Example(
        "--generations 20",
        "with CCD, generation 19: # ways of 1000 seem free, .* costs # ... without CCD, generation 19: .* costs #",
        lambda free, cost, without: free > 0 and 7.0 < cost < 7.2 and without == 6.0,
    ),
    "dice": Example(
        "--frames 40 --dice 4",
        "with CCD: # of 40 frames with penetrations, turns of up to # rad.* in the end # mm/s ... without CCD: # of 40",
        lambda with_ccd, turn, speed, without: with_ccd == 0 < without and turn > 1.0 and speed < 10.0,
    ),
    "rotor": Example(
        "--frames 26 --grains 60",
        "arcs +# times a grain got into a blade, in # turns ... waited for # frames ... chords +# times",
        lambda arcs, turns, waited, chords: arcs == 0 < chords and turns > 0.2 and waited < 0.1,
    ),
    # it stops at the distance kept, never beyond; a nut of another pitch jams when the clearance is used up
    "nut_on_bolt": Example(
        "",
        "sits on the head after # turns, # by its lengths ... up: # steps ... too fast: it jams after # turns",
        lambda turns, expected, up, jams: expected - 1e-3 < turns <= expected and up > 0 and 0.5 < jams < 2.0,
        constants=(("BOLT_TURNS", 6), ("NUT_TURNS", 2), ("START", 2)),
    ),
    "robot_path": Example(
        "--edges 60 --seed 3 --samples 40",
        "configurations, # edges ... # edges are free; the others go on to # of ... "
        "# edges touch at one of 40 samples of what is free",
        lambda edges, free, part, missed: 0.1 * edges < free < 0.9 * edges and 0.0 < part < 1.0 and missed == 0,
    ),
    "barrier_solver": Example(
        "--frames 4",
        "with CCD: 4 frames, # with faces that cross ... least distance # mm ... without CCD: 4 frames, # with",
        lambda with_ccd, least, without: with_ccd == 0 < least and without > 0,
        needs=("skfem", "igl.copyleft.cgal"),
        constants=(("CELLS", (1, 2, 20)),),
    ),
    # both stop where the next step is below a tolerance, and converge; small differences grow once the strip buckles
    "barrier_ipctk": Example(
        "--frames 2",
        "ccd_warp: 2 frames, # with faces that cross ... ipctk: 2 frames, # with faces ... at most # mm apart",
        lambda ours, theirs, apart: ours == theirs == 0 and apart < 1.0,
        needs=("skfem", "igl.copyleft.cgal", "ipctk"),
    ),
    "valve": Example(
        "--frames 24",
        "with CCD: 24 frames, # with crossings ... without CCD: 24 frames, # with crossings",
        lambda with_ccd, without: with_ccd == 0 < without,
        needs=("skfem",),
        constants=(("COLUMNS", 36), ("ROWS", 12), ("SEGMENTS", 20)),
    ),
    "newton_cloth": Example(
        "--frames 6 --resolution 16",
        "iterations # of .* plate, # of 6 f ... end +# of .* plate, # of 6 f ... newton +# of # vertices end below",
        lambda below, crossing, also, too, newton, vertices: (
            newton == vertices and below == crossing == also == too == 0
        ),
        needs=("newton",),
    ),
    "mpi_cloth": Example(
        "--frames 10 --resolution 11",
        "# vertices, 10 frames ... # frames with intersecting faces ... fingerprint of all positions [0-9a-f]{16}",
        lambda vertices, crossing: vertices == 121 and crossing == 0,
    ),
}


@pytest.fixture
def load(monkeypatch) -> Callable[[str], ModuleType]:
    """Loads an example anew, as a module, where Warp looks up the source of its kernels; it may import another."""
    monkeypatch.syspath_prepend(EXAMPLES)
    for path in EXAMPLES.glob("*.py"):
        monkeypatch.setitem(sys.modules, path.stem, None)  # so that it is taken out in the end
        del sys.modules[path.stem]
    return importlib.import_module


def _printed(name: str, example: Example, monkeypatch, capsys, request, folder) -> str:
    """What a short form prints, in this process where MPI does not start with it."""
    arguments = example.arguments.split()
    if name == "mpi_cloth":
        status, shown, error = request.getfixturevalue("python")(folder, EXAMPLES / "mpi_cloth.py", *arguments)
        if NO_MPI.search(error):
            pytest.skip("no MPI")
        assert status == 0, error
        return shown
    for module in example.needs:
        pytest.importorskip(module, reason="an extra is not installed")
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    module = request.getfixturevalue("load")(name)
    vars(module).update(example.constants)
    module.main()
    return "\n" + capsys.readouterr().out


@pytest.mark.parametrize("name", TABLE)
def test_an_example_shows_what_it_is_there_for(name, monkeypatch, capsys, request, tmp_path):
    printed, numbers = _printed(name, TABLE[name], monkeypatch, capsys, request, tmp_path), []
    rest = printed
    for pattern in TABLE[name].printed.split(" ... "):
        found = re.search(pattern.replace("#", NUMBER), rest)
        assert found, f"{pattern!r} is not in:\n{printed}"
        numbers += [float(number.rstrip(",.").replace(",", "")) for number in found.groups()]
        rest = rest[found.end() :]
    assert TABLE[name].promised(*numbers), printed


def test_every_example_is_in_the_table_is_read_in_ten_minutes_and_says_how_long_it_takes():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {*TABLE, "key_frames"}
    for name in TABLE:
        lines = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 200 and re.search(r"\btakes\b", "\n".join(lines[:30])), name


def test_key_frames_of_both_runs_are_drawn_into_a_new_folder(load, monkeypatch, tmp_path):
    image = pytest.importorskip("PIL.Image")
    monkeypatch.setattr(sys, "argv", f"dice --frames 2 --dice 2 --output {tmp_path / 'new' / 'folder'}".split())
    load("dice").main()
    drawn = image.open(tmp_path / "new" / "folder" / "dice.png")
    assert drawn.size == (2 * 360, 2 * 300) and len(drawn.convert("RGB").getcolors(1 << 16)) > 50


@pytest.mark.parametrize(
    ("name", "missing", "arguments", "extra"),
    [
        ("dice", "", "--output new", "viz"),
        ("bullet_2d", "", "--output new", "viz"),
        ("newton_cloth", "newton", "", "newton"),
        ("mpi_cloth", "mpi4py", "", "mpi"),
        ("barrier_solver", "skfem", "", "examples"),
        ("valve", "skfem", "", "examples"),
    ],
)
def test_what_is_missing_is_named_with_its_extra(name, missing, arguments, extra, load, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [name, *arguments.split()])
    if missing:
        monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(SystemExit) as error:
        module = load(name)
        monkeypatch.setattr(module, "find_spec", lambda _: None)
        module.main()
    assert re.search(rf"pip install (-e )?'(ccd-warp|\.)\[{extra}\]'", f"{error.value} {capsys.readouterr().err}")
