"""Settings for all tests."""

from hypothesis import settings

# the first example of a test may have to compile a kernel; the same examples every time,
# so that a failure can be seen again
settings.register_profile("multicell", deadline=None, derandomize=True)
settings.load_profile("multicell")


def pytest_addoption(parser):
    parser.addoption(
        "--coupling-steps", type=int, default=1000, help="of each run in tests/test_memory.py"
    )
