"""Does the effect of a small shift warn of large errors? Rank correlations over coupling steps.

Problem: from the start of each of some coupling steps of a growing population of 200 to 500 cells
every method goes once as it is and once from positions shifted by 0.01 µm. The true error of the
worst cell is that against RKC2 at a thousandth of the tolerance. Printed are Spearman's rank
correlation of effect and error over the steps, the medians of both in µm, and how many of the
quarter of steps with the largest errors are in that with the largest effects.
Cost: about a minute.
Command: python tests/benchmarks/compare_shift_effect.py [STEPS]
"""

import sys

import numpy as np
from scipy.stats import spearmanr

import multicell as mc
from multicell.comparison.record import record
from multicell.integrators.auto import Auto
from multicell.integrators.registry import from_options
from multicell.integrators.rkc import Rkc2
from multicell.integrators.shift import SHIFT, replay_step, shifted_positions
from multicell.scene.parts import IntegratorOptions

METHODS = ("auto", "rkc2", "euler-adaptive", "cvode", "rosenbrock")
ATOL = 0.1


def scene_of(viscosity):
    return mc.load_scene("growth").with_changes({
        "initial.count": 200, "initial.stage": "uniform", "duration": "20 h",
        "drag.viscosity": viscosity,
    })  # fmt: skip


def measured(problem, method):
    """Return the shift effect and the true worst error of each step, µm."""
    seed, system = problem.scene.seed, problem.system()
    effects, errors = [], []
    for k, (step, start) in enumerate(zip(problem.steps, problem.starts, strict=True)):
        system.begin(step.motion)
        exact = Rkc2(1e-9, 1e-3 * ATOL, max_steps=10**6).integrate(system, start)
        system.begin(step.motion)
        found = method.integrate(system, start)
        assert exact.done
        assert found.done
        shifted = shifted_positions(start, SHIFT, seed, k, np.arange(len(start)), 3)
        effects.append(replay_step(method, system, start, found.position, shifted)[0])
        errors.append(np.linalg.norm(found.position - exact.position, axis=1).max())
    return np.array(effects), np.array(errors)


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 28
    print("viscosity  method          correlation  effect  error  found of the worst quarter")
    for viscosity in (5.0, 0.5):
        problem, _ = record(scene_of(viscosity), Auto(atol=0.01), samples=count)
        worst = max(count // 4, 1)
        for name in METHODS:
            method = from_options(IntegratorOptions(method=name, atol=ATOL))
            effects, errors = measured(problem, method)
            correlation = spearmanr(effects, errors).statistic
            top = set(np.argsort(effects)[-worst:]) & set(np.argsort(errors)[-worst:])
            print(
                f"{viscosity:9g}  {name:14}  {correlation:11.2f}  {np.median(effects):6.3f}  "
                f"{np.median(errors):5.3f}  {len(top)} of {worst}",
                flush=True,
            )


if __name__ == "__main__":
    main()
