"""Springs of CBMOS, Mathias et al. (2020), written as there: as functions of the distance."""

import numpy as np

from multicell.contact.springs import CubicSpring, LinearSpring

SUBJECT, SOURCE = "contact", "mathias2020"


def test_springs_are_those_of_cbmos(compare):
    s, mu, cut = 20.0, 2.0, 1.5  # rest distance, stiffness, cutoff
    d = np.linspace(12.0, 29.9, 400)
    options = {"stiffness_at_rest": mu, "cutoff": cut}
    cubic = mu / (s / 2) ** 2 * (d - cut * s) ** 2 * (d - s)
    for name, law, theirs, words in (
        ("linear", LinearSpring(**options), mu * (d - s), "μ (d − s)"),
        ("cubic", CubicSpring(**options), cubic, "4 μ/s² (d − 1.5 s)² (d − s)"),
    ):
        off = abs(law.force(s - d, 1.0, 5.0, rest=s) + theirs).max()
        compare.deviation(f"`{name}`: force", words, off, 1e-12, "nN")
