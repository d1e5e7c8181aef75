"""All pair laws of the package, listed once: each with unusual parameters, and at its limits."""

from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.jkr import JKR
from multicell.contact.physicell import PhysiCell
from multicell.contact.registry import CONTACT_LAWS
from multicell.contact.springs import CubicSpring, LinearSpring
from multicell.schema import specs

# neither those that other tests have made, nor the one without forces
NAMES = [name for name, law in CONTACT_LAWS.items() if ":" not in name and law.acts]


def unusual(kind):
    """Return a law all of whose parameters are a tenth below their defaults."""
    usual = kind()
    return kind(**{name: 0.9 * getattr(usual, name) for name in specs(kind)})


UNUSUAL = {name: unusual(CONTACT_LAWS[name]) for name in NAMES}
LIMITS = {
    "smooth jkr": JKR(surface_energy=0.1, smoothing=0.6),
    "jkr that does not stick": JKR(surface_energy=0.0),
    "exact jkr that does not stick": ExactJKR(surface_energy=0.0),
    "cubic that pulls less": CubicSpring(stiffness_at_rest=1.2).scaled_by_pairs().for_pair(0.3),
    "repulsive": LinearSpring(stiffness_at_rest=1.7, cutoff=1.0),
    "sticky physicell": PhysiCell(length=0.8, surface_energy=0.6, cutoff=1.4),
}
SAMPLES = UNUSUAL | LIMITS
