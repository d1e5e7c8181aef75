"""Settings for all tests."""

from hypothesis import settings

# the first example of a test may have to compile a kernel; the same examples every time,
# so that a failure can be seen again
settings.register_profile("multicell", deadline=None, derandomize=True)
settings.load_profile("multicell")


def pytest_addoption(parser):
    parser.addoption("--kills", type=int, default=4, help="runs that are killed")
    parser.addoption("--full-disks", type=int, default=4, help="runs on a disk that gets full")
    parser.addoption("--damages", type=int, default=36, help="result folders that are damaged")
