"""Compiled code is run: it comes from folders and files that are the user's own, or root's."""

import os
import shutil
import subprocess
import sys
import warnings

import pytest

from multicell.host import closed

pytestmark = pytest.mark.skipif(not closed._OWNERS, reason="folders have no owners here")
as_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away"
)
NOBODY = 65534


@pytest.fixture
def folder(tmp_path):
    """A folder of the user's own that nobody else can write to."""
    made = tmp_path / "above" / "within"
    made.mkdir(parents=True)
    for part in (made, made.parent):
        part.chmod(0o700)
    assert closed.why_open(str(made)) == ""
    return made


@pytest.mark.parametrize("mode", [0o702, 0o777, 0o1777])
def test_a_folder_that_all_can_write_to_is_open(folder, mode):
    folder.chmod(mode)
    assert closed.why_open(str(folder)) == f"others can write to {folder}"


@pytest.mark.parametrize(("mode", "is_open"), [(0o777, True), (0o1777, False), (0o755, False)])
def test_folders_above_count_unless_they_are_sticky(folder, mode, is_open):
    folder.parent.chmod(mode)
    assert bool(closed.why_open(str(folder))) == is_open


@as_root
@pytest.mark.parametrize("group", [1, 12345])
def test_a_folder_of_a_shared_group_is_open(folder, group):
    os.chown(folder, 0, group)
    folder.chmod(0o2770)
    assert "others can write" in closed.why_open(str(folder))


@as_root
@pytest.mark.parametrize("above", [False, True])
def test_a_folder_of_another_user_is_open(folder, above):
    given = folder.parent if above else folder
    os.chown(given, NOBODY, NOBODY)
    given.parent.chmod(0o1777)
    assert closed.why_open(str(folder)) == f"{given} belongs to another user"


@as_root
def test_a_link_of_another_user_is_open(folder, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(folder)
    assert closed.why_open(str(link)) == ""
    os.chown(link, NOBODY, NOBODY, follow_symlinks=False)
    assert closed.why_open(str(link)) == f"{link} belongs to another user"


def test_a_link_into_an_open_folder_is_open(folder, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(folder)
    folder.parent.chmod(0o777)
    assert closed.why_open(str(link)) == f"others can write to {folder.parent}"


@pytest.fixture
def chosen(monkeypatch, tmp_path):
    """Return where compiled code is kept with some settings, and what is said."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # and what it was is set again afterwards
    package = tmp_path / "package"
    (package / "room" / "__pycache__").mkdir(parents=True)
    for part in (package, package / "room"):
        (part / "__init__.py").touch()
    monkeypatch.setattr(closed, "PACKAGE", str(package))
    writable = {str(package): True}
    plain = os.access
    monkeypatch.setattr(
        closed.os, "access", lambda path, mode: writable.get(str(path), plain(path, mode))
    )

    def choose(named="", *, installed_by_others=False):
        writable[str(package)] = not installed_by_others
        settings = {"CACHE_DIR": named}
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            closed.choose_cache(settings)
        return settings["CACHE_DIR"], [str(warning.message) for warning in said]

    return choose, package, tmp_path


def test_closed_folders_are_used_as_they_are(chosen):
    choose, _, tmp_path = chosen
    assert choose() == ("", [])
    assert choose(str(tmp_path / "mine")) == (str(tmp_path / "mine"), [])
    assert choose(installed_by_others=True) == ("", [])


def test_a_named_folder_that_is_open_is_replaced(chosen):
    choose, _, tmp_path = chosen
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(0o777)
    folder, said = choose(str(tmp_path / "shared"))
    assert folder == str(tmp_path / "caches" / "multicell")
    assert len(said) == 1
    assert folder in said[0]
    assert closed.why_open(folder) == ""
    assert os.environ["NUMBA_CACHE_DIR"] == folder  # of the processes that this one starts


def test_an_open_folder_beside_the_files_is_replaced(chosen):
    choose, package, tmp_path = chosen
    (package / "room" / "__pycache__").chmod(0o777)
    assert choose()[0] == str(tmp_path / "caches" / "multicell")


def test_an_open_home_is_replaced_by_a_folder_for_temporary_files(chosen, monkeypatch):
    choose, _, tmp_path = chosen
    (tmp_path / "caches" / "numba").mkdir(parents=True)
    (tmp_path / "caches").chmod(0o777)
    monkeypatch.setattr("tempfile.tempdir", None)
    folder, said = choose(installed_by_others=True)
    assert folder == str(tmp_path / f"multicell-{os.geteuid()}")
    assert "others can write" in said[0]
    # somebody else was there first
    os.rename(folder, f"{folder}-before")
    os.mkdir(folder)
    os.chmod(folder, 0o777)
    other, _ = choose(installed_by_others=True)
    assert other.startswith(str(tmp_path / "multicell-"))
    assert other != folder
    assert closed.why_open(other) == ""


KERNEL = """
import numpy as np
from multicell import philox
from multicell.nutrient import stencil
node = np.ones((1, 1, 1))
stencil.account(node, node, 1.0, node)
print(sum(stencil.account.stats.cache_hits.values()))
"""


def hits(cache):
    """Return how many kernels a process has found in a folder for compiled code."""
    done = subprocess.run(
        [sys.executable, "-c", KERNEL],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A closed folder in which a process finds what another has compiled."""
    cache = tmp_path_factory.mktemp("compiled") / "cache"
    cache.mkdir(mode=0o700)
    assert [hits(cache), hits(cache)] == [0, 1]
    return cache


@pytest.mark.slow
@as_root
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("how", ["owner", "mode", "link"])
def test_files_of_others_in_a_closed_folder_are_not_read(compiled, tmp_path, ending, how):
    cache = tmp_path / "cache"
    shutil.copytree(compiled, cache)
    (file,) = cache.rglob(f"stencil.account-*.{ending}")
    if how == "owner":
        os.chown(file, NOBODY, NOBODY)
    elif how == "mode":
        file.chmod(0o666)
    else:
        elsewhere = tmp_path / "elsewhere"
        file.rename(elsewhere)
        file.symlink_to(elsewhere)
        os.chown(file, NOBODY, NOBODY, follow_symlinks=False)
    assert [hits(cache), hits(cache)] == [0, 1]
