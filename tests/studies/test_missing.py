"""Packages that only studies need."""

import subprocess
import sys

import pytest

from multicell.errors import MissingPackage
from multicell.host.extras import needs

HEAVY = ("dask", "distributed", "xarray", "pandas", "optuna", "SALib", "h5netcdf")


def test_a_missing_package_is_told_with_what_to_do():
    needs("json", "numpy")
    with pytest.raises(MissingPackage) as error:
        needs("numpy", "no_such_package", "nor_this")
    assert str(error.value) == (
        'no_such_package and nor_this are not installed: pip install "multicell[study]"'
    )
    assert error.value.exit_code == 2


@pytest.mark.parametrize(
    "code",
    [
        "from multicell.cli.main import main; main(['run', '--help'], standalone_mode=False)",
        "import multicell.runner",
    ],
)
def test_nothing_else_loads_them(code):
    check = f"{code}\nimport sys\nprint(sorted(set({HEAVY}) & set(sys.modules)))"
    found = subprocess.run(
        [sys.executable, "-c", check], capture_output=True, text=True, check=True
    )
    assert found.stdout.splitlines()[-1] == "[]"
