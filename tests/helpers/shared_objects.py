"""What was compiled once of kernels, for other processes and other Pythons that write the same C++."""

import hashlib
import os
import shutil
from pathlib import Path

import warp as wp
from warp._src import build


class SharedObjects:
    """What processes have compiled: where one writes the same C++ as another, it takes the other's object code.

    Each reads the source of the kernels by itself, which is where Pythons may differ; the compiler is the same.
    `build_cpu` stands for Warp's.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.compiled, self.taken = folder, 0, 0
        self._build = build.build_cpu

    def build_cpu(self, object_path: str, source_path: str, **options: object) -> None:
        lines = Path(source_path).read_text(encoding="utf-8").splitlines()
        source = [line for line in lines if not line.startswith("//")]  # these name files of the environment
        flags = sorted((name, str(value)) for name, value in options.items() if name != "pch_dir")
        name = hashlib.sha256(repr((wp.__version__, flags, source)).encode()).hexdigest()
        if (kept := self.folder / f"{name}.o").exists():
            shutil.copy(kept, object_path)
            self.taken += 1
            return
        self._build(object_path, source_path, **options)
        shutil.copy(object_path, made := kept.with_suffix(f".{os.getpid()}"))
        made.rename(kept)
        self.compiled += 1
