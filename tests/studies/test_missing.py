"""Packages that are loaded only where they are needed."""

import subprocess
import sys

import pytest

from multicell.errors import MissingPackage
from multicell.host.extras import needs

STUDIES = ("dask", "distributed", "xarray", "pandas", "optuna", "SALib", "h5netcdf")
RUNNING = ("numba", "pde", "sksundae")


def test_a_missing_package_is_told_with_what_to_do():
    needs("json", "numpy")
    with pytest.raises(MissingPackage) as error:
        needs("numpy", "no_such_package", "nor_this")
    assert str(error.value) == (
        'no_such_package and nor_this are not installed: pip install "multicell[study]"'
    )
    assert error.value.exit_code == 2


MAIN = "from multicell.cli.main import main; main({}, standalone_mode=False)"
DRAWING = ("matplotlib", "h5py", "rich")


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        (MAIN.format(["run", "--help"]), STUDIES),
        ("import multicell.runner", STUDIES),
        (MAIN.format(["explain", "settle", "--json"]), (*RUNNING, *DRAWING, "jinja2")),
        (
            "import multicell.scene.scene as s; s.load_scene('spheroid')",
            (*RUNNING, *DRAWING, "pint", "scipy.sparse", "scipy.fft", "tomli_w"),
        ),
    ],
    ids=["help", "runner", "explain", "scene"],
)
def test_nothing_else_loads_them(code, heavy):
    check = f"{code}\nimport sys\nprint(sorted(set({heavy}) & set(sys.modules)))"
    found = subprocess.run(
        [sys.executable, "-c", check], capture_output=True, text=True, check=True
    )
    assert found.stdout.splitlines()[-1] == "[]"
