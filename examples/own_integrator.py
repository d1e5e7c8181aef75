"""Your own integrator: the explicit midpoint rule, checked, run and compared
==========================================================================

Problem
    50 cells relax to equilibrium, by the midpoint rule and by CVODE.
Scaling
    Stable for steps below 2 / lambda_max: 107 s for a pair (`multicell explain settle`),
    several times less in tissue. The step here is 5 s.
Cost
    A few seconds once the kernels are compiled.
Command
    .. code-block:: sh

        python examples/own_integrator.py
        multicell run settle --integrator examples/own_integrator.py:Midpoint -o out
        multicell compare settle --methods cvode,heun,examples/own_integrator.py:Midpoint -o chart
"""

# sphinx_gallery_thumbnail_path = 'figures/compare-stiff-inclusions.png'

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import multicell as mc


@dataclass(frozen=True)
class Midpoint:
    """x <- x + h f(t + h/2, x + h/2 f(t, x)) with equal steps no longer than ``step``."""

    step: float
    info: ClassVar = mc.MethodInfo(
        "midpoint",
        "explicit midpoint rule with a fixed step",
        order=2,
        stable=2.0,
        colour="#c0392b",
    )

    def integrate(self, system, position):
        """Carry the positions, (n, 3) um, over one coupling step."""
        begin, end = system.motion.begin, system.motion.end
        # what rounding alone adds to the interval is no step
        count = max(1, math.ceil((end - begin) / self.step * (1.0 - 1e-12)))
        h = (end - begin) / count
        x, slope = np.array(position), np.empty_like(position)
        for k in range(count):
            t = begin + k * h
            try:
                system.velocity(t, x, slope)
                system.velocity(t + 0.5 * h, x + 0.5 * h * slope, slope)
            except mc.StateRejected as error:
                return mc.Outcome(t, x, str(error), "Choose a shorter integrator.step")
            x = x + h * slope
            system.work.steps += 1
        return mc.Outcome(end, x)


def main():
    """Check the method, then run a scene by it and by CVODE."""
    mc.testing.check_integrator(Midpoint)
    print("Midpoint keeps what runs rely on.")
    scene = mc.load_scene("settle").with_changes({"initial.count": 50, "duration": "20 min"})
    mine = mc.run(scene, integrator=Midpoint(step=5.0))
    ours = mc.run(scene, integrator="cvode")
    for name, result in (("midpoint", mine), ("cvode", ours)):
        work = result.summary()["integrator"]
        print(f"{name:9} {work['evaluations']:6,} evaluations, recorded as {work['method']}")


if __name__ == "__main__":
    main()
