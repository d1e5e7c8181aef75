"""The population as arrays."""

import numpy as np
import pytest

from multicell.cells import rows_of


@pytest.mark.parametrize("spread", [1, 3, 1000], ids=["all", "some", "few"])
def test_rows_of_identities_are_those_of_a_dictionary(spread):
    """With a table where identities lie close, and by sorting where they are far apart."""
    rng = np.random.default_rng(spread)
    known = 10**9 + rng.choice(3000 * spread, 3000, replace=False)
    ids = 10**9 + rng.integers(-50, 3000 * spread + 50, (700, 2))
    expected = {int(one): row for row, one in enumerate(known)}
    found = rows_of(known, ids)
    assert found.tolist() == [[expected.get(int(one), -1) for one in pair] for pair in ids]
    assert rows_of(known, np.array([-1, 2**62, *known[:3]])).tolist() == [-1, -1, 0, 1, 2]
    assert rows_of(np.array([], dtype=int), ids).tolist() == [[-1, -1]] * 700
