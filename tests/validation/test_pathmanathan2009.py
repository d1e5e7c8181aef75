"""The generalised linear spring of Chaste's nodes, Pathmanathan et al. (2009), as written there."""

import numpy as np

from multicell.contact.springs import GeneralisedLinearSpring

SUBJECT, SOURCE = "contact", "pathmanathan2009"


def test_the_generalised_linear_spring_is_that_of_chaste(compare):
    s, mu = 20.0, 2.0  # rest distance, stiffness
    d = np.linspace(12.0, 29.9, 400)
    theirs = np.where(d < s, mu * s * np.log(d / s), mu * (d - s) * np.exp(-5 * (d - s) / s))
    law = GeneralisedLinearSpring(stiffness_at_rest=mu, cutoff=1.5, decay=5.0)
    off = abs(law.force(s - d, 1.0, 5.0, rest=s) + theirs).max()
    words = "μ s ln(d/s) to s, μ (d − s) exp(−5 (d − s)/s) beyond"
    compare.deviation("`generalised-linear`: force", words, off, 1e-12, "nN")
