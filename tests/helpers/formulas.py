"""Second formulas for what the kernels compute, from sources and by hand, never from the package.

``force`` and ``energy`` of a pair at an overlap h take E_ij (kPa), r_ij and the rest distance
r_i + r_j (µm); arrays broadcast. ``Pairs`` sums them over a population.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial import cKDTree

# scenes of populations keep ν = ½: 1 - ν² = ¾
POISSON = 0.5


def reduced(young_i, young_j, radius_i, radius_j, poisson=POISSON):
    """Return E_ij and r_ij of pairs (eqs. 3.3, 3.4)."""
    soft = 0.75 * (1.0 - poisson**2) * (1.0 / young_i + 1.0 / young_j)
    return 1.0 / soft, 1.0 / (1.0 / radius_i + 1.0 / radius_j)


def hertz(law, h, modulus, radius, rest, sigma):
    h = np.maximum(h, 0.0)
    stiff = modulus * np.sqrt(radius)
    return stiff * h**1.5, 0.4 * stiff * h**2.5


def approximate_jkr(law, h, modulus, radius, rest, sigma):
    """Eq. 3.6, and below a smoothing length h_s: h^(3/4) becomes h_s^(3/4) (5 s - s²) / 4."""
    h, length = np.maximum(h, 0.0), law.smoothing
    sticky = np.sqrt(6.0 * np.pi * sigma * modulus * radius**1.5)
    pull, well = h**0.75, h**1.75 / 1.75
    if length > 0.0:
        s = np.minimum(h / length, 1.0)
        below = length**1.75 * (5.0 * s**2 / 2.0 - s**3 / 3.0) / 4.0
        pull = np.where(h < length, length**0.75 * (5.0 * s - s**2) / 4.0, pull)
        well = np.where(h < length, below, below + well - length**1.75 / 1.75)
    force, energy = hertz(law, h, modulus, radius, rest, sigma)
    return force - sticky * pull, energy - sticky * well


def exact_jkr(law, h, modulus, radius, rest, sigma):
    """Johnson, Kendall and Roberts 1971: the larger root of a²/r - √(2πσ a / E*) = h.

    For F the load of a sphere pressed in without adhesion, less that of a flat punch. The energy
    is elastic energy less σ times the area of contact. NaN where no contact can be.
    """
    h, modulus, radius, sigma = np.broadcast_arrays(h, modulus, radius, sigma)
    star = 0.75 * modulus
    a = np.array([
        _contact_radius(*values)
        for values in zip(h.flat, star.flat, radius.flat, sigma.flat, strict=True)
    ]).reshape(h.shape)  # fmt: skip
    load = 4.0 * star * a**3 / (3.0 * radius)
    force = load - np.sqrt(8.0 * np.pi * sigma * star * a**3)
    elastic = 0.4 * load * a**2 / radius - (load**2 - force**2) / (4.0 * star * a)
    return force, elastic - sigma * np.pi * a**2


def _contact_radius(h, star, radius, sigma):
    """Return a_c = x² from x⁴ / r - √(2πσ/E*) x - h = 0."""
    roots = np.roots([1.0 / radius, 0.0, 0.0, -np.sqrt(2.0 * np.pi * sigma / star), -h])
    real = roots.real[np.abs(roots.imag) < 1e-6 * np.abs(roots).max()]
    return real.max() ** 2 if len(real) else np.nan


# springs, as the other programs write them: r the distance, s at rest, positive attracts


def cbmos_linear(r, mu=1.0, s=1.0, rA=1.5):
    return np.where(r < rA, mu * (r - s), 0.0)


def cbmos_cubic(r, mu=50.0, s=1.0, rA=1.5):
    return np.where(r < rA, mu * (r - rA) ** 2 * (r - s), 0.0)


def chaste_nodes(r, mu=15.0, s=1.0, rA=1.5, alpha=5.0):
    apart = mu * (r - s) * np.exp(-alpha * (r - s) / s)
    return np.where(r < rA, np.where(r <= s, mu * s * np.log(r / s), apart), 0.0)


def linear(law, h, modulus, radius, rest, sigma):
    return _spring(
        lambda r: -cbmos_linear(r, law.stiffness_at_rest, rest, law.cutoff * rest), law, h, rest
    )


def cubic(law, h, modulus, radius, rest, sigma):
    """Cubic of CBMOS, whose coefficient is the stiffness over the square of the range."""
    mu = law.stiffness_at_rest / ((law.cutoff - 1.0) * rest) ** 2
    return _spring(lambda r: -cbmos_cubic(r, mu, rest, law.cutoff * rest), law, h, rest)


def generalised_linear(law, h, modulus, radius, rest, sigma):
    """Springs between the nodes of Chaste."""
    return _spring(
        lambda r: -chaste_nodes(r, law.stiffness_at_rest, rest, law.cutoff * rest, law.decay),
        law, h, rest,
    )  # fmt: skip


def physicell(law, h, modulus, radius, rest, sigma):
    """PhysiCell's velocities times the drag of a cell of the mean radius."""

    def force(d):
        push = modulus * law.length * np.maximum(1.0 - d / rest, 0.0) ** 2
        return rest * (push - sigma * np.maximum(1.0 - d / (law.cutoff * rest), 0.0) ** 2)

    return _spring(force, law, h, rest)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(60)


def _spring(force, law, h, rest):
    """Return the force at an overlap and its integral from the end of the law on."""
    end = -(law.cutoff - 1.0) * rest
    energy = 0.0
    # in two parts, since the slope of the force may jump at rest
    for low, high in ((end, np.clip(h, end, 0.0)), (0.0 * end, np.maximum(h, 0.0))):
        half, middle = 0.5 * (high - low), 0.5 * (high + low)
        places = np.asarray(rest - middle)[..., None] - np.asarray(half)[..., None] * _NODES
        values = np.stack([force(places[..., k]) for k in range(len(_NODES))], axis=-1)
        energy = energy + half * (values @ _WEIGHTS)
    return force(rest - h), energy


def scaled(law, h, modulus, radius, rest, sigma):
    """A spring whose attraction has a factor: its energy is that up to rest, and what follows."""
    plain = FORMULAS[type(law.law).__name__]
    force, energy = plain(law.law, h, modulus, radius, rest, sigma)
    at_rest = plain(law.law, np.minimum(h, 0.0), modulus, radius, rest, sigma)[1]
    factor = law.factor if sigma is None or not np.ndim(sigma) else sigma
    pulls = np.where(force < 0.0, factor * force, force)
    return pulls, factor * at_rest + (energy - at_rest)


FORMULAS = {
    "ScaledAttraction": scaled,
    "Hertz": hertz,
    "JKR": approximate_jkr,
    "ExactJKR": exact_jkr,
    "LinearSpring": linear,
    "CubicSpring": cubic,
    "GeneralisedLinearSpring": generalised_linear,
    "PhysiCell": physicell,
}


def pair(law, h, modulus, radius, rest=None, *, touching=False, sigma=None):
    """Return force (nN) and energy (fJ) of pairs; zero where there is no contact."""
    sigma = getattr(law, "surface_energy", 0.0) if sigma is None else sigma
    name = type(law).__name__
    h = np.asarray(h, dtype=float)
    if name != "ExactJKR":
        return FORMULAS[name](law, h, modulus, radius, rest, sigma)
    force, energy = exact_jkr(law, h, modulus, radius, rest, sigma)
    held = np.isfinite(force) & ((h >= 0.0) | touching)
    return np.where(held, force, 0.0), np.where(held, energy, 0.0)


class Pairs:
    """All pairs of a population by a k-d tree, and what their law makes of them.

    Parameters
    ----------
    position, radius, young : (n, 3), (n,), (n,)
    law : pair law
    touching : (m, 2), optional
        Pairs in contact before, smaller index first.
    sigma : (n, n) or scalar, optional
        Surface energy of each pair instead of the law's own.
    """

    def __init__(self, position, radius, young, law, touching=None, sigma=None):
        found = cKDTree(position).query_pairs(3.2 * radius.max(), output_type="ndarray")
        self.i, self.j = i, j = np.sort(found, axis=1).T
        self.position, self.radius = position, radius
        self.vector = position[j] - position[i]
        self.distance = np.linalg.norm(self.vector, axis=1)
        self.rest = radius[i] + radius[j]
        self.overlap = self.rest - self.distance
        self.modulus, self.reduced = reduced(young[i], young[j], radius[i], radius[j])
        known = set(map(tuple, [] if touching is None else np.asarray(touching).tolist()))
        held = np.array([(a, b) in known for a, b in zip(i.tolist(), j.tolist(), strict=True)])
        if np.ndim(sigma) == 2:
            sigma = sigma[i, j]
        self.force, self.energy = pair(
            law, self.overlap, self.modulus, self.reduced, self.rest, touching=held, sigma=sigma
        )

    def forces(self, magnitude=None):
        """Return the sums over the pairs of each cell, (n, 3)."""
        magnitude = self.force if magnitude is None else magnitude
        total = np.zeros_like(self.position)
        pull = (magnitude / self.distance)[:, None] * self.vector
        np.add.at(total, self.i, -pull)
        np.add.at(total, self.j, pull)
        return total

    def pressures(self):
        """Return the virial F d / 2 of each cell's pairs over three times its volume, (n,)."""
        virial = np.zeros(len(self.radius))
        for cell in (self.i, self.j):
            np.add.at(virial, cell, 0.5 * self.force * self.distance)
        return virial / (4.0 * np.pi * self.radius**3)


def end_of(position, radius, young, law, duration, *, rate=0.0, viscosity=5.0, outer=None):
    """Return where few cells are in the end, by SciPy's DOP853 over all pairs without a list.

    ``outer`` gives further forces (n, 3) for positions, radii (n, 3), (n,).
    """
    i, j = np.triu_indices(len(radius), 1)

    def velocity(t, y):
        x, size = y.reshape(-1, 3), radius + rate * t
        away = x[j] - x[i]
        distance = np.linalg.norm(away, axis=1)
        modulus, small = reduced(young[i], young[j], size[i], size[j])
        force, _ = pair(law, size[i] + size[j] - distance, modulus, small, size[i] + size[j])
        total = np.zeros_like(x) if outer is None else outer(x, size)
        np.add.at(total, i, -(force / distance)[:, None] * away)
        np.add.at(total, j, (force / distance)[:, None] * away)
        return (total / (6.0 * np.pi * viscosity * size[:, None])).ravel()

    span = (0.0, duration)
    found = solve_ivp(velocity, span, position.ravel(), "DOP853", rtol=1e-12, atol=1e-12)
    return found.y[:, -1].reshape(-1, 3)


# derivatives


def slope(function, place, direction, step):
    """Return the derivative of a function along a direction, by a central difference."""
    ahead, behind = function(place + step * direction), function(place - step * direction)
    return (ahead - behind) / (2.0 * step)


def velocity_of(system, time=0.0):
    """Return the right-hand side of a population as a function of positions."""

    def velocity(position):
        out = np.empty_like(position)
        system.velocity(time, position, out)
        return out

    return velocity


def product_of(system, direction):
    out = np.empty_like(direction)
    system.jacobian_product(direction, out)
    return out


def dense_jacobian(system, position, step=1e-6):
    """Return J of the velocity by central differences, column by column, (3n, 3n)."""
    units = np.eye(position.size).reshape(-1, *position.shape)
    return np.stack(
        [slope(velocity_of(system), position, unit, step).ravel() for unit in units], axis=1
    )


def growth_rate_of(system, position, dimensions=3):
    """Return the largest real part of an eigenvalue of the dense J, 1/s."""
    free = np.arange(position.size) % 3 < dimensions
    return np.linalg.eigvals(dense_jacobian(system, position)[np.ix_(free, free)]).real.max()
