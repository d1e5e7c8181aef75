"""Speed of the right-hand side for each contact law and addition, against the plain JKR one.

Targets: at most 1.3 times the plain JKR kernel for the laws of scenes; friction at 10 000 cells at
most 8 times the right-hand side without. Run ``pytest -m benchmark -s``; ratios of one run count.
"""

from pathlib import Path

import numpy as np
import pytest
from strategies import cluster

from multicell.contact.custom import load_law
from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.hertz import Hertz
from multicell.contact.jkr import JKR
from multicell.contact.springs import Cubic, GeneralisedLinear, Linear
from multicell.mechanics import binning
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

pytestmark = pytest.mark.benchmark


def tissue(n):
    position, radius, young = cluster(n, 0, spacing=0.88)
    order = binning.spatial_order(position, 10.0)
    return position[order], radius[order], young[order]


TISSUE = {}
OWN = Path(__file__).parents[2] / "examples" / "own_law.py"

CASES = {
    "jkr": (JKR(), {}, {}),
    "hertz": (Hertz(), {}, {}),
    "smoothed jkr": (JKR(smoothing=0.5), {}, {}),
    "exact jkr": (ExactJKR(), {}, {}),
    "linear": (Linear(cutoff=1.0), {}, {}),
    "cubic": (Cubic(cutoff=1.05), {}, {}),
    "generalised linear": (GeneralisedLinear(cutoff=1.0), {}, {}),
    "one's own square": (load_law(f"{OWN}:Square")(stiffness=2.0), {}, {}),
    "one's own jkr": (load_law(f"{OWN}:Sticky")(surface_energy=0.1), {}, {}),
    "jkr between types": (JKR(), {"surface_energies": np.array([[0.1, 0.05], [0.05, 0.1]])}, {}),
    "jkr and receptors": (JKR(), {"bond_strength": 0.1}, {"bonds": True}),
    "jkr and external force": (JKR(), {}, {"push": True}),
    "jkr and friction": (JKR(), {"friction": (0.1, 0.1)}, {}),
}


def system(n, law, options, extra):
    position, radius, young = TISSUE.setdefault(n, tissue(n))
    made = Mechanics(law, 5.0, **options)
    nothing = np.zeros(n)
    motion = {}
    if "bonds" in extra:
        motion["bonds"] = np.tile([0.9, 0.9, 0.0, 0.0], (n, 1))
    if "push" in extra:
        motion["push"] = np.ones((n, 6))
    kind = np.arange(n) % 2
    made.begin(Motion(radius, nothing, young, nothing + 0.5, 0.0, 60.0, kind=kind, **motion))
    return made, position


@pytest.mark.parametrize("n", [10_000, 100_000])
@pytest.mark.parametrize("case", CASES)
def test_right_hand_side(benchmark, case, n):
    made, position = system(n, *CASES[case])
    plain, _ = system(n, *CASES["jkr"])
    out = np.empty_like(position)

    def both():
        plain.velocity(0.0, position, out)

    benchmark.pedantic(made.velocity, (0.0, position, out), rounds=60, warmup_rounds=3)
    found = benchmark.stats.stats.median * 1e9 / n
    import time

    reference = []
    for _ in range(60):
        begin = time.perf_counter()
        both()
        reference.append(time.perf_counter() - begin)
    base = float(np.median(reference)) * 1e9 / n
    print(f"\n{case}, {n} cells: {found:.1f} ns per cell, {found / base:.2f} times plain JKR")
    assert np.isfinite(out).all()
    assert made.work.list_builds == 1
