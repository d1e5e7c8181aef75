"""Settings for all tests."""

import os

# before numba starts its threads: those of another worker wait without taking a core away from
# this one, and no machine has too few or too many of them
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# processes import the package that the tests import, also where the current folder has another one,
# for which numba would compile everything once more
os.environ["PYTHONSAFEPATH"] = "1"

import gc
import subprocess

import pytest
from hypothesis import settings

# modules and tests live until the end: to look through all of them for garbage, again and again
# while they come, takes two fifths of the time
gc.disable()

# Two workers begin at the first test, with kernels of mechanics, and at the one in the middle, with
# those of fields, so that they seldom compile the same. No long test comes last.
ROOMS = ("contact", "conformance", "mechanics", "integrators", "biology", "comparison",
         "calibration", "studies", "docs", "examples", "validation", "nutrient", "tests",
         "results", "cli", "report", "scene")  # fmt: skip

# the first example of a test may have to compile a kernel; the same examples every time,
# so that a failure can be seen again
settings.register_profile("multicell", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("multicell")


def pytest_addoption(parser):
    group = parser.getgroup("multicell", "how long the harnesses search")
    group.addoption("--scenes", type=int, default=80, help="scenes drawn and loaded")
    group.addoption("--runs", type=int, default=8, help="small scenes drawn and run")
    group.addoption("--draws", type=int, default=8, help="scenes with parts and methods")
    group.addoption("--first-seed", type=int, default=0, help="of what is drawn; others each time")
    group.addoption("--kills", type=int, default=2, help="runs that are killed")
    group.addoption("--full-disks", type=int, default=2, help="runs on a disk that gets full")
    group.addoption("--damages", type=int, default=6, help="folders of each kind that are damaged")
    group.addoption("--interrupts", type=int, default=2, help="processes that are interrupted")
    group.addoption("--keys", type=int, default=0, help="keys of each scene that are changed")
    group.addoption("--calibrations", type=int, default=0, help="repeats of fits on known data")
    group.addoption(
        "--coupling-steps", type=int, default=500, help="of each run that must not leak"
    )


USUAL = {"hertz", "jkr", "none", "auto", "cvode", "euler", "rkc2"}
"""Contact laws and methods whose kernels short tests compile."""


def _compiles_more(item):
    """Return whether a parameter of a test is a law or a method other than the usual ones."""
    from multicell.contact.registry import CONTACT_LAWS
    from multicell.integrators.registry import METHODS

    laws = {kind: name for name, kind in CONTACT_LAWS.items()}
    for value in item.callspec.params.values() if hasattr(item, "callspec") else ():
        kind = value if isinstance(value, type) else type(value)
        name = getattr(getattr(kind, "info", None), "name", laws.get(kind, value))
        if isinstance(name, str) and name in {*METHODS, *CONTACT_LAWS} - USUAL:
            return True
    return False


def _sample(items, whole):
    """Mark as slow what the marker ``sample`` does not name; all that it names must be there."""
    missing = {}
    for item in items:
        if marker := item.get_closest_marker("sample"):
            left = missing.setdefault(item.nodeid.partition("[")[0], set(marker.args))
            left.discard(item.callspec.id)
            if item.callspec.id not in marker.args:
                item.add_marker(pytest.mark.slow)
    wrong = {name: left for name, left in missing.items() if left}
    if whole and wrong:
        raise pytest.UsageError(f"the marker sample names parameters that are not there: {wrong}")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    moving = [item.nodeid for item in items if " at 0x" in item.nodeid]
    if moving:
        raise pytest.UsageError(
            f"{moving[0]}: an address in its name differs from process to process"
        )
    for item in items:
        if item.get_closest_marker("kernels") and _compiles_more(item):
            item.add_marker(pytest.mark.slow)
    _sample(items, whole=not any("::" in name for name in config.args))
    # here and not by an option -m, in whose place the user's would stand
    if "benchmark" not in config.option.markexpr:
        timed = [item for item in items if item.get_closest_marker("benchmark")]
        config.hook.pytest_deselected(items=timed)
        items[:] = [item for item in items if item not in timed]
    order = {name: place for place, name in enumerate(ROOMS)}
    items.sort(key=lambda item: order.get(item.path.parent.name, len(ROOMS)))


def pytest_collection_finish():
    # the collector leaves alone what is there now, and numba's types are many: it looks more seldom
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
    gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config):
    # each worker begins with neighbouring tests, which share fixtures and kernels
    if getattr(config.option, "numprocesses", None) and config.option.dist == "no":
        config.option.dist = "worksteal"


@pytest.hookimpl(tryfirst=True, optionalhook=True)
def pytest_xdist_auto_num_workers():
    # beyond eight the longest test decides
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(cores or 1, 8, _memory() // (3 * 2**29)))


def _memory():
    """Return the memory of the machine in bytes; a worker takes up to 1.2 GB."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 8 * 2**30


@pytest.fixture(scope="session", autouse=True)
def letters_of_pages():
    """Check every picture that any test puts into a page: its letters can be read there."""
    from letters import PAGE, SMALLEST, smallest_letters

    from multicell.report.plots import style

    inline = style.inline_picture

    def checked(figure, path=None):
        size, text = smallest_letters(figure)
        assert size >= SMALLEST, f"{text!r} has {size:.2f} pt at the width of its page"
        shown = inline(figure, path)
        size, text = smallest_letters(figure, shown.least)
        assert size + 1e-9 >= SMALLEST, f"{text!r} has {size:.2f} pt on a narrow page"
        assert shown.least <= PAGE
        return shown

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "inline_picture", checked)
        yield


@pytest.fixture(scope="session")
def forks():
    from forks import Forks

    with Forks() as made:
        yield made


@pytest.fixture
def here(monkeypatch):
    """Carry runs of studies out in this process; return the names of those that ran."""
    from studied import in_this_process

    return in_this_process(monkeypatch)


@pytest.fixture
def small_disk(tmp_path):
    """Give a function that makes a small disk, and one that gives it another size."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = []

    def mount(kilobytes):
        options = f"size={kilobytes}k"
        again = [*(["remount"] if mounted else []), options]
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", ",".join(again), "tmpfs", str(place)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0 and not mounted:
            pytest.skip(f"a small disk cannot be mounted here: {done.stderr.strip()}")
        assert done.returncode == 0, done.stderr
        mounted.append(kilobytes)
        return place

    def unmount():
        if mounted:
            subprocess.run(["umount", str(place)], check=True)
            mounted.clear()

    if os.name != "posix" or not hasattr(os, "geteuid") or os.geteuid() != 0:
        pytest.skip("to mount a small disk one must be root")
    yield mount, unmount
    unmount()


@pytest.fixture(scope="module")
def browser():
    """A browser without a window; software draws for it."""
    import shutil

    names = ("chromium", "chromium-browser", "google-chrome")
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        pytest.skip("there is no Chromium on this machine")
    from playwright.sync_api import sync_playwright

    software = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as tools:
        started = tools.chromium.launch(executable_path=found, args=software)
        yield started
        started.close()
