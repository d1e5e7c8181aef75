"""A long run holds no more memory than a short one.

``pytest tests/test_memory.py --coupling-steps 20000`` is the long form.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import steady

PER_STEP, ONCE = 100, 300_000
"""Bytes of growth that are taken for the allocator's: 2.3 MB over 20,000 coupling steps."""


@pytest.mark.harness
@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="there is no /proc/self/statm")
@pytest.mark.parametrize("case", sorted(steady.CASES))
def test_memory_is_flat(case, tmp_path, request):
    steps = request.config.getoption("--coupling-steps")
    done = subprocess.run(
        [sys.executable, steady.__file__, case, str(steps), str(tmp_path / "o")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found[-1][0] == steps
    # the first tenth fills caches and pools
    begin, warm = found[1]
    grown = max(resident for _, resident in found[1:]) - warm
    assert grown < ONCE + PER_STEP * (steps - begin), [r for _, r in found]
