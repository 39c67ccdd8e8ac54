"""Fuzz of the readers: damaged files of every format, and an independent reader as the judge of what was accepted.

    python -m ccd_warp.benchmarks.fuzz_files --cases 50000

A case is one file of a format, cut, or with bytes, words, attributes, base64 or records of a ZIP archive changed. It is
read in a process that may take 1 GB more than it has and 10 s. Where the mesh is another than that of the whole file, a
second reader says what the file holds: VTK's, meshio for XDMF, NumPy for archives of arrays, for ZIP one that goes from
member to member; in processes of their own, which may die. A mesh on which both agree is what the damaged file means (a
digit is another digit); where they do not, it is kept, and the status is 1 unless the judge refuses the file.
"""

import argparse
import multiprocessing
import os
import re
import resource
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from ccd_warp.benchmarks.file_judge import Files, judged, whole_files
from tqdm import tqdm

from ccd_warp._files.mesh import read_mesh
from ccd_warp._files.series import find_series
from ccd_warp._input.messages import InputError

MEMORY, SECONDS, MAX_BYTES = 1 << 30, 10, 1 << 28

# ---- Damage ----------------------------------------------------------------------------------------------------------


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """A file with one thing changed, or two."""
    at = int(rng.integers(len(data)))
    words = list(re.finditer(rb"[^\s<>=\"]+", data)) if b"\0" not in data[:200] or data[:1] == b"<" else []
    kind = rng.integers(8 if words else 4)
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + bytes([data[at] ^ 1 << int(rng.integers(8))]) + data[at + 1 :]
    if kind == 2:  # near the end, too, where an archive has its records
        at = at if rng.random() < 0.5 else max(len(data) - 1 - int(rng.integers(200)), 0)
        return data[:at] + bytes([int(rng.integers(256))]) * int(rng.integers(3)) + data[at + 1 :]
    if kind == 3:  # a few bytes dropped or doubled
        end = at + int(rng.integers(1, 12))
        return data[:at] + data[end:] if rng.random() < 0.5 else data[:end] + data[at:]
    one, two = (words[int(k)] for k in rng.integers(len(words), size=2))
    if kind == 4:  # one word for another
        return data[: one.start()] + two[0] + data[one.end() :]
    if kind == 5:  # a digit or letter within a word
        k = int(rng.integers(one.start(), one.end()))
        return data[:k] + rng.choice(list(b"0123456789.-eAZ=!*#\n ")).tobytes()[:1] + data[k + 1 :]
    if kind == 6:  # a word left out, or doubled
        return data[: one.start()] + (b"" if rng.random() < 0.5 else one[0] + b" " + one[0]) + data[one.end() :]
    line = data.find(b"\n", one.end()) + 1 or len(data)
    begin = data.rfind(b"\n", 0, one.start()) + 1
    return data[:begin] + (data[line:] if rng.random() < 0.5 else data[begin:line] + data[begin:])


def cases(whole: dict[str, Files], count: int, seed: int) -> Iterator[tuple[str, Files]]:
    """Every cut of the first file of each format as far as two thirds of the cases go, then formats in turn."""
    cuts = [(kind, at) for kind, files in whole.items() for at in range(len(next(iter(files.values()))))]
    step = max(1, -(-3 * len(cuts) // (2 * count)))
    for kind, at in cuts[::step]:
        name, data = next(iter(whole[kind].items()))
        yield kind, {**whole[kind], name: data[:at]}
    for k in range(count - len(cuts[::step])):
        rng = np.random.default_rng([seed, k])
        kind = list(whole)[k % len(whole)]
        name = str(rng.choice(list(whole[kind])))
        data = damaged(whole[kind][name], rng)
        yield kind, {**whole[kind], name: damaged(data, rng) if rng.random() < 0.2 and data else data}


# ---- Reading ---------------------------------------------------------------------------------------------------------


def read(folder: Path, files: Files) -> np.ndarray | str:
    """The corners of all triangles, [n, 3, 3]; or why there are none."""
    path = _written(folder, files)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, resource.RLIM_INFINITY))
    signal.alarm(SECONDS)
    try:
        if path.suffix in (".npz", ".pvd") or path.name == "series.xdmf":
            displacement = "u" if path.suffix == ".xdmf" else None
            (series,) = find_series([path], max_bytes=MAX_BYTES, displacement=displacement)
            meshes = [series.read(k) for k in range(len(series.labels))]
        else:
            meshes = [read_mesh(path, MAX_BYTES)]
        return np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes])
    except InputError as error:
        return "above 1 GB" if "MemoryError" in "".join(traceback.format_exception(error)) else "refused"
    except Exception as error:
        return f"raised {type(error).__name__}"
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def _written(folder: Path, files: Files) -> Path:
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder / next(iter(files))


def judge(folder: Path, files: Files) -> np.ndarray | str:
    """The corners of all triangles by another reader, [n, 3, 3]; or why there are none."""
    signal.alarm(SECONDS)
    try:
        return judged(_written(folder, files))
    except Exception as error:
        return f"refused ({type(error).__name__})"
    finally:
        signal.alarm(0)


# ---- The run ---------------------------------------------------------------------------------------------------------


def in_children(function: Callable, tasks: list[Files]) -> Iterable[np.ndarray | str]:
    """What a function says of each task, in processes that may end at any; each does as many as it lives for."""
    done = 0
    with tempfile.TemporaryDirectory() as folder:
        while done < len(tasks):
            receive, send = multiprocessing.Pipe(duplex=False)
            arguments = (function, Path(folder), tasks[done:], send)
            child = multiprocessing.get_context("fork").Process(target=_child, args=arguments)
            child.start()
            send.close()
            try:
                while done < len(tasks):
                    yield receive.recv()
                    done += 1
            except EOFError:
                child.join()
                yield "above 10 s" if child.exitcode == -signal.SIGALRM else f"died ({child.exitcode})"
                done += 1
            child.join()


def _child(function: Callable, folder: Path, tasks: list[Files], send) -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    for task in tasks:
        send.send(function(folder, task))


def _same(one: np.ndarray | str, other: np.ndarray | str) -> bool:
    """To single precision, to which VTK reads text."""
    if isinstance(one, str) or isinstance(other, str):
        return isinstance(one, str) and one == other
    one, other = (_without_repeats(corners.astype(np.float32)) for corners in (one, other))
    return one.shape == other.shape and np.allclose(one, other, rtol=1e-6, atol=1e-30, equal_nan=True)


def _without_repeats(corners: np.ndarray) -> np.ndarray:
    """Without the triangles that repeat a corner and are an edge or a corner of another, which readers keep or not."""
    sets = [{*map(tuple, triangle.tolist())} for triangle in corners]
    return corners[[not any(each < other for other in sets) for each in sets]]


def main() -> int:
    parser = argparse.ArgumentParser(description="Fuzz the readers of files against independent ones.")
    parser.add_argument("--cases", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--failures", type=Path, default=Path("fuzz_files"), help="folder for what is listed")
    arguments = parser.parse_args()
    whole = whole_files()
    expected = dict(zip(whole, in_children(read, list(whole.values())), strict=True))
    for (kind, ours), verdict in zip(expected.items(), in_children(judge, list(whole.values())), strict=True):
        assert not isinstance(ours, str) and _same(ours, verdict), f"{kind}: {ours} and {verdict} of a whole file"
    counts: dict[str, Counter] = {kind: Counter() for kind in whole}
    drawn = list(cases(whole, arguments.cases, arguments.seed))
    differ = []
    answers = in_children(read, [files for _, files in drawn])
    for (kind, files), answer in zip(drawn, tqdm(answers, "reading", len(drawn)), strict=True):
        counts[kind]["cases"] += 1
        if isinstance(answer, str):
            counts[kind][answer] += 1
        elif _same(answer, expected[kind]):
            counts[kind]["as the whole"] += 1
        else:
            differ.append((kind, files, answer))
    verdicts = in_children(judge, [files for _, files, _ in differ])
    for (kind, files, answer), verdict in zip(differ, tqdm(verdicts, "judging", len(differ)), strict=True):
        agrees = _same(answer, verdict)
        text = "both agree" if agrees else f"judge {verdict}" if isinstance(verdict, str) else "DIFFERENT"
        counts[kind][text] += 1
        if not agrees:
            folder = arguments.failures / f"{kind}_{counts[kind][text]}"
            folder.mkdir(parents=True, exist_ok=True)
            _written(folder, files)
    total = sum(counts.values(), Counter())
    for kind, count in {**counts, "all": total}.items():
        print(f"{kind:14}", ", ".join(f"{name} {value}" for name, value in count.items()))
    return int(any(name.startswith(("DIFFERENT", "above", "died", "raised")) for name in total))


if __name__ == "__main__":
    sys.exit(main())
