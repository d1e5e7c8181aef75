"""The example about an equation of py-pde's runs, and its solvers agree with the exact front."""

import numpy as np
from test_examples import is_picture, load


def test_fisher_front_is_cheap_and_right(tmp_path):
    found = load("fisher_front").main(tmp_path)
    assert is_picture(tmp_path / "fisher_front.png")
    ours = [result for name, result in found.items() if name.startswith("multicell")]
    assert [result.discrete < 5e-4 for result in ours] == [True] * 3
    for result, bound in zip(ours, (1e-2, 2e-4, 2e-6), strict=True):
        assert result.error < bound
    # as exact as explicit Euler at a tenth of the evaluations
    euler = found["py-pde euler"]
    assert 1e-4 < euler.error < 1e-2
    assert ours[1].error < 0.1 * euler.error
    assert ours[1].evaluations < 0.25 * euler.evaluations
    assert found["py-pde runge-kutta"].error < 1e-6
    assert found["py-pde scipy (RK45)"].error < 1e-4
    assert np.isnan(found["py-pde crank-nicolson, step 8 limits"].error)
