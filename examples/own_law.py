"""Your own contact laws: a spring that stiffens with the overlap, and a second JKR
================================================================================

Problem
    Two laws as Python functions, checked, then run: 50 cells relax to equilibrium by each.
Scaling
    The stiffness of the spring is 2 k h / r_ij: with k = 2 nN/um that of Hertz's law for
    1 kPa at an overlap of 0.2 um.
Cost
    Half a minute, nearly all of it to compile the two laws; a few seconds afterwards. It is not
    run in the documentation, which is to be built quickly.
Command
    .. code-block:: sh

        python examples/own_law.py
        multicell run settle --law examples/own_law.py:Square --set contact.stiffness=2 -o o
        multicell compare settle --law examples/own_law.py:Sticky -o chart
"""

import math

import multicell as mc
from multicell.schema import quantity


@mc.pair_law(parameters={"stiffness": "nN/um"})
def Square(overlap, modulus, radius, p):  # noqa: N802 - a law is a class
    """F = k h^2 / r_ij, with the stiffness k in nN/um."""
    return p.stiffness * overlap * overlap / radius


@mc.pair_law(
    parameters={"surface_energy": quantity("nN/um", default=0.1, at_least=0.0)},
    stiffness=lambda overlap, modulus, radius, p, adhesion: (
        1.5 * modulus * math.sqrt(radius * overlap)
        - 0.75 * adhesion * math.sqrt(modulus * radius * math.sqrt(radius / overlap))
    ),
    energy=lambda overlap, modulus, radius, p, adhesion: (
        0.4 * modulus * overlap * overlap * math.sqrt(radius * overlap)
        - 4.0 / 7.0 * adhesion * math.sqrt(modulus * radius * math.sqrt(radius)) * overlap**1.75
    ),
)
def Sticky(overlap, modulus, radius, p, adhesion):  # noqa: N802 - a law is a class
    """Approximate JKR once more (eq. 3.6): powers would take twice the time."""
    q = math.sqrt(radius * overlap)
    return modulus * overlap * q - adhesion * q * math.sqrt(modulus * q)


def main():
    """Check both laws, and let 50 cells come to rest by each; return where the cells are."""
    for law in (Square(stiffness=2.0), Sticky(surface_energy="0.1 nN/um")):
        mc.testing.check_pair_law(law)
        print(f"{law} keeps what runs rely on.")
    scene = mc.load_scene("settle").with_changes({"initial.count": 50, "duration": "20 min"})
    ends = {}
    for law in (Square(stiffness=2.0), Sticky(surface_energy=0.1)):
        cells = mc.run(scene.with_changes({"contact": law})).frames[-1].cells
        ends[type(law).__name__] = cells.position
        print(f"{type(law).__name__:7} {len(cells)} cells, spread {cells.position.std():.2f} um")
    return ends


if __name__ == "__main__":
    main()
