"""A pair law of one's own: a spring that stiffens with the square of the overlap.

As it stands, or through the command line:

    python examples/own_law.py
    multicell run doublet-settle --law examples/own_law.py:Square --set contact.stiffness=2 -o out
    multicell compare settle --law examples/own_law.py:Square --set contact.stiffness=2 -o chart
"""

import multicell as mc


@mc.pair_law(parameters={"stiffness": "nN/um"})
def Square(overlap, modulus, radius, p):  # noqa: N802 - a law is a class
    """F = k h^2 / r_ij, with the stiffness k in nN/um."""
    return p.stiffness * overlap * overlap / radius


@mc.pair_law(
    parameters={"surface_energy": "nN/um"},
    stiffness=lambda overlap, modulus, radius, p, adhesion: (
        1.5 * modulus * (radius * overlap) ** 0.5
        - 0.75 * adhesion * (modulus * radius**1.5 * overlap**-0.5) ** 0.5
    ),
    energy=lambda overlap, modulus, radius, p, adhesion: (
        0.4 * modulus * radius**0.5 * overlap**2.5
        - 4.0 / 7.0 * adhesion * (modulus * radius**1.5) ** 0.5 * overlap**1.75
    ),
)
def Sticky(overlap, modulus, radius, p, adhesion):  # noqa: N802 - a law is a class
    """Approximate JKR once more (eq. 3.6), with its derivative and its integral."""
    elastic = modulus * overlap * (radius * overlap) ** 0.5
    return elastic - adhesion * (modulus * (radius * overlap) ** 1.5) ** 0.5


def main():
    """Check both laws, and let two cells come to rest by one and 50 by the other."""
    for law in (Square(stiffness=2.0), Sticky(surface_energy="0.1 nN/um")):
        mc.testing.check_pair_law(law)
        print(f"{law} keeps what runs rely on.")
    scene = mc.load_scene("settle").with_changes({"initial.count": 50, "duration": "20 min"})
    for law in (Square(stiffness=2.0), Sticky(surface_energy=0.1)):
        result = mc.run(scene.with_changes({"contact": law}))
        cells = result.frames[-1].cells
        print(f"{type(law).__name__:7} {len(cells)} cells, spread {cells.position.std():.2f} um")


if __name__ == "__main__":
    main()
