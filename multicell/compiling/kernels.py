"""Pack of compiled kernels, which spares a new installation the compilation of its first runs.

``python -m multicell.compiling.kernels FOLDER SCENE...`` runs scenes on an empty cache, with numba
compiling for a level of processors, and writes what was compiled into a wheel. Installed beside
multicell it serves all processors of that level (:mod:`multicell.compiling.pack`).
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import os
import re
import subprocess
import sys
import sysconfig
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_DEFLATED, ZipFile

import llvmlite
import numba

from multicell import __version__
from multicell.compiling.numba_068 import processor
from multicell.compiling.pack import PROCESSOR_LEVELS, setting
from multicell.host.closed import PACK


def build_pack(
    folder: Path, scenes: Sequence[str], level: str = "x86-64-v3", changes: Sequence[str] = ()
) -> Path:
    """Run scenes with kernels for a level of processors, and return the wheel with these.

    - ``folder``: of the wheel; ``scenes``: names or paths, as ``multicell run`` takes them
    - ``level``: key of :data:`multicell.compiling.pack.PROCESSOR_LEVELS` that this processor has
    - ``changes``: of all scenes, as ``--set`` takes them
    """
    triple, _, features = processor()
    lacking = {f"+{name}" for name in PROCESSOR_LEVELS[level].split()} - set(features.split(","))
    if lacking:
        raise SystemExit(f"this processor cannot run code for {level}: {', '.join(lacking)}")
    with TemporaryDirectory() as work:
        environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        environment |= {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": ""}
        environment |= {"MULTICELL_NO_PACK": "1"}
        environment["NUMBA_CACHE_DIR"] = code = f"{work}/code"
        run = [sys.executable, "-P", "-m", "multicell", "run", "--no-report", "--overwrite"]
        run += ["-o", f"{work}/out", *(part for change in changes for part in ("--set", change))]
        for scene, threads in product(scenes, sorted({1, os.cpu_count() or 1})):
            done = subprocess.run([*run, "--threads", str(threads), scene], env=environment)
            if done.returncode:  # the command has said why
                raise SystemExit(done.returncode)
        # numba's folders are called by rooms and digests of their paths
        found = {(x.parent.name.rpartition("_")[0], x.name): x for x in Path(code).glob("*/*.nb?")}
        files = {"/".join(name): file.read_bytes() for name, file in sorted(found.items())}
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    processors = [triple, level, ""]
    about = {"level": level, "for": processors, "setting": setting(), "files": digests}
    return _write_wheel(folder, level, {"about.json": json.dumps(about).encode(), **files})


def _write_wheel(folder: Path, level: str, files: dict[str, bytes]) -> Path:
    version = f"{__version__}+{level.replace('-', '.')}"
    python = "cp{}{}".format(*sys.version_info)
    tag = f"{python}-{python}-{re.sub('[-.]', '_', sysconfig.get_platform())}"
    metadata = f"""Metadata-Version: 2.1
Name: multicell-kernels
Version: {version}
Summary: Compiled kernels of multicell for {level}
Requires-Dist: multicell=={__version__}
Requires-Dist: numba=={numba.__version__}
Requires-Dist: llvmlite=={llvmlite.__version__}
"""
    about = f"Wheel-Version: 1.0\nGenerator: multicell\nRoot-Is-Purelib: false\nTag: {tag}\n"
    info = f"{PACK}-{version}.dist-info"
    whole = {f"{PACK}/{name}": content for name, content in files.items()}
    whole |= {f"{info}/METADATA": metadata.encode(), f"{info}/WHEEL": about.encode()}
    record = f"{info}/RECORD,,\n"
    for name, content in whole.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
        record += f"{name},sha256={digest},{len(content)}\n"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{PACK}-{version}-{tag}.whl"
    with ZipFile(path, "w", ZIP_DEFLATED) as wheel:
        for name, content in (whole | {f"{info}/RECORD": record.encode()}).items():
            wheel.writestr(name, content)
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser("python -m multicell.compiling.kernels", description=__doc__)
    parser.add_argument("folder", type=Path, help="where the wheel is written")
    parser.add_argument("scenes", nargs="*", default=["spheroid"], help="names or files of scenes")
    parser.add_argument("--level", choices=PROCESSOR_LEVELS, default="x86-64-v3")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE, for all scenes")
    given = parser.parse_args()
    print(build_pack(given.folder, given.scenes, given.level, given.set))
