"""An outside reference for ``rkc2``: the stabilised methods of SUNDIALS on the same steps.

Problem   coupling steps of growing clusters of some 300 cells (tile_problems.py)
Methods   ``rkc2``, and RKC and RKL of order 2 from ARKODE's LSRKStep, with a power iteration for
          the dominant eigenvalue, at the same tolerance and the same share of it in the norm
Needs     Python 3.12 or later and the package sundials4py, beside multicell
Cost      a minute of CPU
Command   python docs/programs/lsrk.py
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sundials4py.arkode as ark
import sundials4py.core as core
from tile_problems import Solved, Tile, solved
from tile_tables import markdown

from multicell.comparison.ladders import find_method
from multicell.comparison.replay import replay
from multicell.integrators.limits import norm_share
from multicell.mechanics.motion import StateRejected

STEPS = (("typical", 1e2), ("typical", 1e3), ("quiet", 1e4))
TOLERANCES = (0.1, 0.01)  # µm
KINDS = ark.ARKODE_LSRKMethodType
MOST_STAGES, ITERATIONS, LOOSE, REFRESHED = 200, 100, 0.05, 10
"""Stages of a step; power iterations and their tolerance; steps between estimates."""


def lsrk(step: Solved, tolerance: float, kind: Any) -> tuple[int, float]:
    """Return evaluations and error of a coupling step by a method of LSRKStep."""
    problem, system = step.problem, step.problem.system()
    motion, n = problem.steps[0].motion, len(problem.start)
    system.begin(motion)
    _, context = core.SUNContext_Create(0)
    state, probe = (core.N_VNew_Serial(3 * n, context) for _ in range(2))
    core.N_VGetArrayPointer(state)[:] = problem.start.ravel()
    core.N_VGetArrayPointer(probe)[:] = np.random.default_rng(1).normal(size=3 * n)

    def velocity(time: float, y: Any, out: Any, _: Any) -> int:
        place, found = np.array(core.N_VGetArrayPointer(y)).reshape(-1, 3), np.empty((n, 3))
        try:
            system.velocity(motion.begin + time, place, found)
        except StateRejected:
            return 1
        core.N_VGetArrayPointer(out)[:] = found.ravel()
        return 0

    made = ark.LSRKStepCreateSTS(velocity, 0.0, state, context)
    memory = made.get() if hasattr(made, "get") else made
    share = norm_share(n)
    estimator = core.SUNDomEigEstimator_Power(probe, ITERATIONS, LOOSE, context)
    length = motion.end - motion.begin
    failed = [
        ark.LSRKStepSetSTSMethod(memory, kind),
        ark.ARKodeSStolerances(
            memory, share * 0.01 * tolerance / problem.mean_radius, share * tolerance
        ),
        ark.LSRKStepSetDomEigEstimator(memory, estimator),
        ark.LSRKStepSetMaxNumStages(memory, MOST_STAGES),
        ark.LSRKStepSetDomEigFrequency(memory, REFRESHED),
        ark.ARKodeSetMaxNumSteps(memory, 100_000),
        ark.ARKodeSetStopTime(memory, length),
    ]
    flag, _ = ark.ARKodeEvolve(memory, length, state, ark.ARK_NORMAL)
    if any(failed) or flag < 0:
        raise SystemExit(f"LSRKStep ended with {failed}, {flag}")
    end = np.array(core.N_VGetArrayPointer(state)).reshape(-1, 3)
    return system.work.evaluations, step.errors(end)[0]


def main() -> None:
    """Print the table."""
    rows = []
    for state, stiffness in STEPS:
        step = solved(Tile(state, 350, stiffness, 1))
        for tolerance in TOLERANCES:
            radius = step.problem.mean_radius
            made = find_method("rkc2", step.problem.scene, radius).make(tolerance / radius)
            found = replay(step.problem, made)
            cells = [(found.work.evaluations, step.errors(found.positions[0])[0])]
            cells += [
                lsrk(step, tolerance, kind)
                for kind in (KINDS.ARKODE_LSRK_RKC_2, KINDS.ARKODE_LSRK_RKL_2)
            ]
            name = f"{state}, λΔt {stiffness:g}, {tolerance} µm"
            rows.append([name, *(f"{n}, {100.0 * error:.2g} %" for n, error in cells)])
    head = ["coupling step, tolerance", "`rkc2`", "RKC of SUNDIALS", "RKL of SUNDIALS"]
    print(markdown(head, rows))


if __name__ == "__main__":
    main()
