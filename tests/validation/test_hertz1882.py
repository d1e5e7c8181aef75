"""Elastic spheres: Hertz (1882)."""

import numpy as np

import multicell as mc
from multicell.contact.law import effective_modulus, effective_radius

SUBJECT, SOURCE = "contact", "hertz1882"


def test_the_force_of_two_spheres(compare):
    modulus, radius = effective_modulus(1.0, 0.5, 1.0, 0.5), effective_radius(10.0, 10.0)
    h = np.linspace(0.05, 9.0, 400)
    theirs = 4 / 3 * 0.75 * modulus * np.sqrt(radius) * h**1.5
    off = abs(mc.Hertz().force(h, modulus, radius) / theirs - 1).max()
    compare.deviation("Hertz: force, relative", "4/3 E* √r h^1.5", off, 1e-12)
