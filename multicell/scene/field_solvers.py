"""Solvers of py-pde's registry that the fields of a scene may name, and how long their steps are.

Explicit solvers, and py-pde's implicit ones, whose equations are solved by fixed-point iteration,
need steps that the fastest rate of a field bounds. All take fixed steps of half of that, so that a
scene predicts their cost; SciPy's and ours choose their own by a tolerance.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from multicell.cells import SPHERE
from multicell.errors import SceneError
from multicell.scene.nutrient import OWN_SOLVERS
from multicell.scene.scales import largest_spacing, regime, scales
from multicell.scene.sizes import typical_radius
from multicell.schema import near_miss

if TYPE_CHECKING:
    from multicell.scene.scene import Scene

_ADDED: Final = "multicell-implicit"
"""What the package adds to the registry besides, when its equations are loaded."""

_UNFIT: Final = {
    "explicit_mpi": "which shares a grid among processes, and a run is one process",
    "milstein": "which solves equations with noise, and fields have none",
}
"""Solvers of the registry that no field can take, and why."""

MOST_FIELD_STEPS: Final = 1_000_000  # in one coupling step, or until a field is at rest

_AT_REST: Final = 3.0
"""Diffusion times until a field rests to the tolerance of runs: 21 of its slowest mode, a tenth of
that time each in a ball, and half of that more, since times are doubled until it does."""

_LIMITS: Final = {
    "runge-kutta": 2.785,  # the real interval of stability of the method of fourth order
    "crank-nicolson": 2.0,  # where half of a step's rates still contract
    "adams-bashforth": 1.0,  # that of the method of second order
    "implicit": 1.0,  # where a step's rates still contract
}
_EULER: Final = 2.0  # the interval of explicit Euler, for all others
_SHARE: Final = 0.5  # of the limit that is taken: explicit Euler then keeps concentrations positive

HELD_RATE: Final = 20.0
"""Rate of exchange with the medium, over D/h², of a node beyond the layer of medium round a tissue,
and the largest of one at its end. About a twentieth of the difference across a spacing is left
between such a node and the medium, as if the layer ended by so much of a spacing later. Larger
rates lose more digits of the account, and let explicit solvers take more steps."""

_OWN_STEPS: Final = ("scipy", "multicell-implicit")
"""Solvers that choose their steps by a tolerance."""


def longest_step(solver: str, fastest: float) -> float:
    """Return the longest step in s for a field whose fastest rate is given in 1/s.

    Infinite for solvers that choose their steps by a tolerance.
    """
    return math.inf if solver in _OWN_STEPS else _SHARE * _LIMITS.get(solver, _EULER) / fastest


def expected_step(scene: Scene, name: str) -> float:
    """Return the longest step in s of the solver that a field names, where cells are dense."""
    nutrient = scene.nutrients[name]
    size = SPHERE * typical_radius(scene) ** 3
    uptake = float(nutrient.largest_uptake(size)) / size / nutrient.half_saturation
    diffusion = 4.0 * scene.dimensions
    # of a layer that ends inside of the grid, multicell.nutrient.layer
    shells = nutrient.layout == "radial" and scene.dimensions == 3
    diffusion += HELD_RATE if nutrient.margin_shape == "tissue" and not shells else 0.0
    diffusion *= nutrient.diffusion / largest_spacing(scene, name) ** 2
    return longest_step(nutrient.solver, diffusion + nutrient.decay + nutrient.perfusion + uptake)


def expected_steps(scene: Scene, name: str) -> int:
    """Return the steps of a solver of fixed ones in a coupling step, or until the field rests.

    Zero for solvers that choose their steps by a tolerance.
    """
    time = scene.coupling_step
    if regime(scene, name) == "steady":
        time = _AT_REST * scales(scene, name).time
    return math.ceil(time / expected_step(scene, name))


def known_solvers() -> list[str]:
    """Return the values that ``solver`` of a field may have."""
    from pde.solvers import registered_solvers

    # py-pde lists each of its own by the name of its class, too
    names = {name for name in registered_solvers() if not name.endswith("Solver")}
    return [*OWN_SOLVERS, *sorted({_ADDED, *names} - {*OWN_SOLVERS, *_UNFIT})]


def check_solver(scene: Scene, name: str) -> None:
    """Raise ``SceneError`` for a solver that is not known, or not one of such a field."""
    nutrient, path = scene.nutrients[name], f"nutrients.{name}.solver"
    solver = nutrient.solver
    if solver == "auto":
        return
    if solver not in OWN_SOLVERS:
        known = known_solvers()
        if solver not in known:
            why = _UNFIT.get(solver, "no solver")
            raise SceneError(path, f"is '{solver}', {why}", near_miss(solver, known))
        if nutrient.finite_medium is not None:
            problem = f"is '{solver}', but a finite medium is solved for together with the field"
            raise SceneError(path, problem, "Let it be 'auto', or leave finite_medium out.")
        _check_steps(scene, name, path)
        return
    wanted = {"steady": "multicell-steady", "transient": "multicell-march"}[regime(scene, name)]
    if solver != wanted:
        problem = f"is '{solver}', but the field is {regime(scene, name)}"
        raise SceneError(path, problem, f"Take '{wanted}' or 'auto', or state another regime.")


def _check_steps(scene: Scene, name: str, path: str) -> None:
    """Refuse a solver that would need too many steps."""
    solver, number = scene.nutrients[name].solver, expected_steps(scene, name)
    if number > MOST_FIELD_STEPS:
        steady = regime(scene, name) == "steady"
        until = "until the field rests" if steady else "in a coupling step"
        problem = (
            f"is '{solver}', which would need about {number:,} steps of "
            f"{expected_step(scene, name):.2g} s {until}, more than {MOST_FIELD_STEPS:,}"
        )
        raise SceneError(path, problem, "Take 'auto' or 'multicell-implicit'.")
