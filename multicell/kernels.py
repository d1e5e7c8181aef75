"""Pack of compiled kernels, which spares a new installation the compilation of its first runs.

``python -m multicell.kernels FOLDER SCENE...`` runs scenes on an empty cache, with numba compiling
for a level of processors, and writes what was compiled into a wheel. Installed beside multicell it
serves all processors of that level (:mod:`multicell.compiling.pack`).
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import os
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_DEFLATED, ZipFile

import llvmlite
import numba

from multicell import __version__
from multicell.compiling.cache import PACKAGE_FOLDER
from multicell.compiling.numba_068 import files_of, processor
from multicell.compiling.pack import LEVELS, setting
from multicell.host.closed import PACK


def build_pack(
    folder: Path, scenes: Sequence[str], level: str = "x86-64-v3", changes: Sequence[str] = ()
) -> Path:
    """Run scenes with kernels for a level of processors, and return the wheel with these.

    - ``folder``: of the wheel; ``scenes``: names or paths, as ``multicell run`` takes them
    - ``level``: key of :data:`multicell.compiling.pack.LEVELS` that this processor has
    - ``changes``: of all scenes, as ``--set`` takes them
    """
    triple, _, features = processor()
    lacking = {f"+{name}" for name in LEVELS[level].split()} - set(features.split(","))
    if lacking:
        raise SystemExit(f"this processor cannot run code for {level}: {', '.join(lacking)}")
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as work:
        chosen = {"CACHE_DIR": f"{work}/code", "CPU_NAME": level, "CPU_FEATURES": ""}
        others = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        environment = others | {f"NUMBA_{name}": value for name, value in chosen.items()}
        sets = [part for change in changes for part in ("--set", change)]
        run = [sys.executable, "-P", "-m", "multicell", "run", "--no-report", *sets]
        for number, scene in enumerate(scenes):
            for threads in dict.fromkeys((1, os.cpu_count() or 1)):
                output = ["-o", f"{work}/{number}-{threads}", "--threads", str(threads)]
                subprocess.run([*run, *output, scene], env=environment, check=True)
        compiled = dict(_compiled(f"{work}/code"))
    about = {
        "level": level,
        "processor": [triple, level, ""],
        "setting": setting(),
        "files": {name: hashlib.sha256(code).hexdigest() for name, code in compiled.items()},
    }
    return _write_wheel(folder, level, {"about.json": json.dumps(about).encode(), **compiled})


def _compiled(code: str) -> Iterator[tuple[str, bytes]]:
    for source in sorted(Path(PACKAGE_FOLDER).rglob("*.py")):
        room = source.parent.relative_to(PACKAGE_FOLDER)
        for file in files_of(code, str(source)):
            yield (room / Path(file).name).as_posix(), Path(file).read_bytes()


def _write_wheel(folder: Path, level: str, files: dict[str, bytes]) -> Path:
    version = f"{__version__}+{level.replace('-', '.')}"
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    system = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    needed = {"multicell": __version__, "numba": numba.__version__, "llvmlite": llvmlite.__version__}
    metadata = f"Metadata-Version: 2.1\nName: multicell-kernels\nVersion: {version}\n"
    metadata += f"Summary: Compiled kernels of multicell for {level}\n"
    metadata += "".join(f"Requires-Dist: {name}=={number}\n" for name, number in needed.items())
    tags = "Wheel-Version: 1.0\nGenerator: multicell\nRoot-Is-Purelib: false\n"
    info = f"{PACK}-{version}.dist-info"
    whole = {f"{PACK}/{name}": content for name, content in files.items()}
    whole[f"{info}/METADATA"] = metadata.encode()
    whole[f"{info}/WHEEL"] = f"{tags}Tag: {python}-{python}-{system}\n".encode()
    record = f"{info}/RECORD"
    lines = [f"{name},{_recorded(content)}\n" for name, content in whole.items()]
    whole[record] = "".join([*lines, f"{record},,\n"]).encode()
    path = folder / f"{PACK}-{version}-{python}-{python}-{system}.whl"
    with ZipFile(path, "w", ZIP_DEFLATED) as wheel:
        for name, content in whole.items():
            wheel.writestr(name, content)
    return path


def _recorded(content: bytes) -> str:
    digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
    return f"sha256={digest},{len(content)}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse a command line, build the pack and print where it is."""
    parser = argparse.ArgumentParser("python -m multicell.kernels", description=__doc__)
    parser.add_argument("folder", type=Path, help="where the wheel is written")
    parser.add_argument("scenes", nargs="*", default=["spheroid"], help="names or files of scenes")
    parser.add_argument("--level", choices=LEVELS, default="x86-64-v3", help="of the processors")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE, for all scenes")
    given = parser.parse_args(arguments)
    print(build_pack(given.folder, given.scenes, given.level, given.set))


if __name__ == "__main__":
    main()
