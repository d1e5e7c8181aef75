"""Pairs with offset: their law sees the overlap beyond it, and nothing else changes."""

import functools
from dataclasses import fields, replace

import numpy as np
import pytest
from formulas import pair, product_of, slope, velocity_of
from formulas import reduced as pairwise
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from strategies import ONE_OF_A_KIND, cluster, seeds
from test_prescribed import friction_matrix

from multicell import JKR, Hertz, load_scene
from multicell.comparison import cache as archive
from multicell.comparison.replay import Problem, Step, Trajectory, replay
from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.law import effective_modulus
from multicell.contact.springs import Cubic, Linear
from multicell.integrators.cvode import Cvode
from multicell.integrators.registry import from_options
from multicell.mechanics.jacobian import sparse_jacobian
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics
from multicell.scene.parts import IntegratorOptions

LAWS = {
    "hertz": Hertz(),
    "jkr": JKR(surface_energy=0.1),
    "exact": ExactJKR(surface_energy=0.1),
    "linear": Linear(),
    "cubic": Cubic(),
}
# each law with one kind of adhesion: kernels are compiled for each combination
SMOOTH = st.sampled_from([
    (LAWS[name], {"receptors": receptors, "types": types})
    for name, receptors, types in (
        ("hertz", False, False), ("jkr", True, True), ("exact", True, False),
        ("cubic", False, True),
    )
])  # fmt: skip
RATE = -1e-3


def population(n, seed, law, *, offset=True, receptors=False, types=False, factor=1.0, **options):
    """Return positions, mechanics and the pairs with offset: every third pair in contact."""
    position, radius, young = cluster(n, seed, spacing=0.78)
    kind = np.arange(n) % 2
    if types:
        options["surface_energies"] = np.array([[0.1, 0.02], [0.02, 0.15]])
    if receptors:
        options["bond_strength"] = 0.1
    motion = Motion(
        radius, 0.001 * radius, young, np.full(n, 0.5), 0.0, 100.0, kind=kind,
        bonds=np.tile([0.9, 0.8, 1e-4, 0.0], (n, 1)) if receptors else None,
    )  # fmt: skip
    system = Mechanics(law, 5.0, **options)
    system.begin(motion)
    pairs = system.contacts(0.0, position)
    motion = replace(motion, touching=pairs)
    chosen = pairs[::3]
    if offset:
        amount = factor * np.random.default_rng(seed).uniform(0.2, 3.0, len(chosen))
        values = np.stack([amount, np.full(len(chosen), RATE)], axis=1)
        motion = replace(motion, offset_pairs=chosen, offset=values)
    system.begin(motion)
    return position, system


def felt(system, time, position):
    """Return the pairs with offset, the overlap that each should feel, and the unit vectors."""
    motion = system.motion
    radius = motion.radius + motion.radius_rate * time
    i, j = motion.offset_pairs.T
    vector = position[j] - position[i]
    distance = np.linalg.norm(vector, axis=1)
    offset = np.maximum(motion.offset[:, 0] + motion.offset[:, 1] * time, 0.0)
    overlap = radius[i] + radius[j] - distance
    constants = pairwise(motion.young[i], motion.young[j], radius[i], radius[j])
    return overlap, offset, vector / distance[:, None], *constants, radius[i] + radius[j]


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("time", [0.0, 100.0])
def test_law_of_a_pair_sees_the_overlap_beyond_its_offset(law, time):
    """The difference that offset makes to the forces is the vectorised law's, summed.

    At both ends of the step, where exact JKR's units are those of the radii there.
    """
    position, system = population(400, 2, law, chunk=64)
    _, without = population(400, 2, law, offset=False, chunk=64)
    i, j = system.motion.offset_pairs.T
    overlap, offset, normal, young, reduced, rest = felt(system, time, position)
    beyond = pair(law, overlap - offset, young, reduced, rest, touching=True)
    whole = pair(law, overlap, young, reduced, rest, touching=True)
    change = beyond[0] - whole[0]
    expected = without.force(time, position)
    np.subtract.at(expected, i, change[:, None] * normal)
    np.add.at(expected, j, change[:, None] * normal)
    found = system.force(time, position)
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())
    gained = system.energy(time, position) - without.energy(time, position)
    assert gained == pytest.approx((beyond[1] - whole[1]).sum(), rel=1e-9)


def _smooth_state(n, seed, law, time, **options):
    """Return a state without a pair so near its onset that a slope has no meaning there."""
    position, system = population(n, seed, law, **options)
    plain = np.linalg.norm(position[:, None] - position[None], axis=2)
    radius = system.motion.radius * (1 + 0.001 * time)
    gap = np.abs(radius[:, None] + radius[None] - plain)[np.triu_indices(n, 1)]
    overlap, offset, *_ = felt(system, time, position)
    reach = getattr(law, "cutoff", 1.0)
    edge = np.abs(reach * (radius[:, None] + radius[None]) - plain)[np.triu_indices(n, 1)]
    assume(gap.min(initial=1.0) > 0.02 and edge.min(initial=1.0) > 0.02)
    assume(np.abs(overlap - offset).min(initial=1.0) > 0.02)
    if law.remembers:
        _, _, _, young, reduced, _ = felt(system, time, position)
        broken = overlap - offset - law.breaking_overlap(young, reduced)
        assume(np.abs(broken).min(initial=1.0) > 0.05)
    return position, system


@given(seeds, SMOOTH, st.integers(2, 15), st.sampled_from([0.0, 40.0]))
def test_force_is_minus_the_gradient_of_the_energy(seed, law, n, time):
    position, system = _smooth_state(n, seed, law[0], time, **law[1])
    direction = np.random.default_rng(seed).normal(size=position.shape)
    rise = slope(lambda x: system.energy(time, x), position, direction, 1e-5)
    force = system.force(time, position)
    assert np.abs(force.sum(axis=0)).max() <= 1e-12 * max(np.abs(force).sum(), 1e-300)
    scale = np.abs(force * direction).sum() + 1e-9
    assert rise == pytest.approx(-(force * direction).sum(), abs=2e-6 * scale)


@given(seeds, SMOOTH, st.integers(2, 15), st.sampled_from([0.0, 40.0]))
def test_jacobian_product_is_the_directional_derivative(seed, law, n, time):
    position, system = _smooth_state(n, seed, law[0], time, **law[1])
    direction = np.random.default_rng(seed).normal(size=position.shape)
    system.linearise(time, position)
    product, matrix = product_of(system, direction), sparse_jacobian(system)
    expected = slope(velocity_of(system, time), position, direction, 1e-6)
    np.testing.assert_allclose(product, expected, atol=1e-6 * np.abs(expected).max() + 1e-10)
    np.testing.assert_allclose(
        (matrix @ direction.ravel()).reshape(-1, 3), product, atol=1e-12 * np.abs(product).max()
    )


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_no_offset_and_a_offsets_of_zero_change_no_bit(law):
    found = []
    for options in ({"offset": False}, {"factor": 0.0}):
        position, system = population(300, 5, law, chunk=64, friction=(0.1, 0.2), **options)
        if system.motion.offset is not None:
            system.begin(replace(system.motion, offset=0.0 * system.motion.offset))
        out = np.empty_like(position)
        system.velocity(7.0, position, out)
        system.linearise(7.0, position)
        product = np.empty_like(out)
        system.jacobian_product(position, product)
        energy, pressure = system.energy(7.0, position), system.pressure(7.0, position)
        found.append((out, product, energy, pressure, system.contacts(7.0, position)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_offset_ends_where_it_reaches_zero():
    position, system = population(60, 1, JKR())
    _, without = population(60, 1, JKR(), offset=False)
    values = np.tile([0.05, RATE], (len(system.motion.offset), 1))
    system.begin(replace(system.motion, offset=values))
    np.testing.assert_array_equal(system.force(80.0, position), without.force(80.0, position))
    assert np.abs(system.force(20.0, position) - without.force(20.0, position)).max() > 0.0


@pytest.mark.parametrize("law", [JKR(), ExactJKR()], ids=["jkr", "exact"])
def test_contacts_and_pressure_are_those_of_the_overlap_felt(law):
    position, system = population(300, 6, law, chunk=64, factor=2.0)
    _, without = population(300, 6, law, offset=False, chunk=64)
    overlap, offset, _, young, reduced, rest = felt(system, 0.0, position)
    onset = law.breaking_overlap(young, reduced) if law.remembers else 0.0 * offset
    parted = system.motion.offset_pairs[overlap - offset < onset]
    assert 0 < len(parted) < len(offset)
    before = {tuple(pair) for pair in without.contacts(0.0, position)}
    after = {tuple(pair) for pair in system.contacts(0.0, position)}
    assert before - after == {tuple(pair) for pair in parted}
    # both cells of a pair take half of F d: the sum of the virials tells the change of all
    change = pair(law, overlap - offset, young, reduced, rest, touching=True)[0]
    change = change - pair(law, overlap, young, reduced, rest, touching=True)[0]
    volume = 4.0 / 3.0 * np.pi * system.motion.radius**3
    gained = system.pressure(0.0, position) - without.pressure(0.0, position)
    expected = (change * (rest - overlap)).sum() / 3.0
    assert (gained * volume).sum() == pytest.approx(expected, rel=1e-10)


def test_friction_rubs_over_the_contact_that_is_felt():
    """Γ v = F with B = π r h γ of the overlap beyond the offset, against a dense solution."""
    position, system = population(40, 8, JKR(), friction=(0.4, 0.1), chunk=16)
    known = zip(system.motion.offset_pairs.tolist(), system.motion.offset[:, 0], strict=True)
    gamma = friction_matrix(system, position, {tuple(pair): amount for pair, amount in known})
    out = np.empty_like(position)
    system.velocity(0.0, position, out)
    expected = np.linalg.solve(gamma, system.force(0.0, position).ravel()).reshape(-1, 3)
    np.testing.assert_allclose(out, expected, atol=1e-5 * np.abs(expected).max())


def sisters(law, radius, phase, viscosity=5.0, **options):
    """Return two fresh daughters of a mother of radius 2^(1/3) ``radius``, at rest by offset."""
    distance = 2.0 * radius * (2.0 ** (1.0 / 3.0) - 1.0)
    modulus, reduced = effective_modulus(1.0, 0.5, 1.0, 0.5), 0.5 * radius
    rest = float(law.equilibrium_overlap(modulus, reduced))
    offset = 2.0 * radius - distance - rest
    system = Mechanics(law, viscosity, **options)
    ones = np.ones(2)
    motion = Motion(
        radius * ones, 0.0 * ones, ones, 0.5 * ones, 0.0, phase,
        touching=np.array([[0, 1]]),
        offset_pairs=np.array([[0, 1]]), offset=np.array([[offset, -offset / phase]]),
    )  # fmt: skip
    system.begin(motion)
    return np.array([[0.0, 0, 0], [0.6, 0.8, 0.0] * np.array(distance)]), system, rest, offset


@pytest.mark.parametrize("law", [JKR(), ExactJKR(), Hertz()], ids=["jkr", "exact", "hertz"])
def test_sisters_part_as_the_offset_falls(law):
    """Quasi-static: the distance is 2 r - h₀ - s(t), behind by Γ ṡ / (2 k) (derived)."""
    phase = 36_000.0
    position, system, rest, offset = sisters(law, 4.0, phase)
    assert np.abs(system.force(0.0, position)).max() < 1e-12
    outcome = Cvode(rtol=1e-9, atol=1e-6).integrate(system, position)
    apart = np.linalg.norm(outcome.position[1] - outcome.position[0])
    if isinstance(law, Hertz):
        # no stiffness at rest: the lag is where Hertz's force drags both cells along
        modulus = float(effective_modulus(1.0, 0.5, 1.0, 0.5))
        speed = offset / phase / 2.0
        lag = (system.drag * 4.0 * speed / (modulus * np.sqrt(2.0))) ** (2.0 / 3.0)
    else:
        stiffness = float(
            law.stiffness(rest, effective_modulus(1, 0.5, 1, 0.5), 2.0, touching=True)
        )
        lag = system.drag * 4.0 * (offset / phase) / (2.0 * stiffness)
    assert apart == pytest.approx(8.0 - rest - lag, abs=0.03 * lag)
    np.testing.assert_allclose(outcome.position.mean(axis=0), position.mean(axis=0), atol=1e-9)


@pytest.fixture(scope="module")
def parted():
    """How far sisters are apart in the end, by SciPy: d' = 2 F(2 r - d - s(t)) / Γ."""
    phase, law = 600.0, JKR()
    position, system, _, offset = sisters(law, 4.0, phase)
    modulus = effective_modulus(1.0, 0.5, 1.0, 0.5)

    def rhs(t, d):
        overlap = 8.0 - d - offset * (1.0 - t / phase)
        return 2.0 * pair(law, overlap, modulus, 2.0)[0] / (system.drag * 4.0)

    begin = np.linalg.norm(position[1] - position[0])
    return solve_ivp(rhs, (0.0, phase), [begin], "DOP853", rtol=1e-11, atol=1e-11).y[0, -1]


@pytest.mark.parametrize("method", ONE_OF_A_KIND)
def test_methods_agree_with_scipy(method, parted):
    """Offset stays while lists are built anew, inside compiled loops too."""
    first = method in ("euler", "euler-adaptive", "multirate-euler", "backward-euler")
    options = IntegratorOptions(
        method=method, step=0.5, rtol=1e-9, atol=1e-3 if first else 1e-6, max_steps=100_000
    )
    position, system, _, _ = sisters(JKR(), 4.0, 600.0, skin=0.01)
    end = from_options(options).integrate(system, position)
    assert end.done
    apart = np.linalg.norm(end.position[1] - end.position[0])
    assert apart == pytest.approx(parted, abs=0.02 if first else 1e-3)
    assert system.work.list_builds > 1


CONTACTS = {
    "exact": (ExactJKR(), {}),
    "types and friction": (JKR(), {"friction": (0.1, 0.1), "types": True}),
}


@functools.cache
def tight_end(contact):
    law, more = CONTACTS[contact]
    position, system = population(60, 3, law, **more)
    return Cvode(rtol=1e-9, atol=1e-8).integrate(system, position).position


@pytest.mark.parametrize("method", ["ab2-adaptive", "dopri5", "cvode"])
@pytest.mark.parametrize("contact", CONTACTS)
def test_contacts_are_kept_in_all_kinds_of_loop(contact, method):
    law, more = CONTACTS[contact]
    position, system = population(60, 3, law, **more)
    options = IntegratorOptions(method=method, rtol=1e-7, atol=1e-5)
    outcome = from_options(options).integrate(system, position)
    assert outcome.done
    away = np.linalg.norm(outcome.position - tight_end(contact), axis=1)
    assert np.sqrt(np.mean(away**2)) < 0.02


def _problem():
    scene = load_scene("growth")
    position, system, _, _ = sisters(JKR(), 4.0, 600.0)
    first = replace(system.motion, touching=None)
    second = replace(first, begin=600.0, end=1200.0, offset_pairs=None, offset=None)
    return Problem(scene, system, position, first.radius, [Step(first), Step(second)])


def test_replay_and_archive_keep_the_offset(tmp_path):
    problem = _problem()
    method = Cvode()
    trajectory = replay(problem, method)
    assert trajectory.done
    assert archive.save(tmp_path / "cache.npz", problem, trajectory, {"a": 1})
    blank = replace(problem, steps=())
    loaded, _, _ = archive.load(tmp_path / "cache.npz", blank)
    for one, other in zip(problem.steps, loaded.steps, strict=True):
        for spec in fields(Motion):
            np.testing.assert_array_equal(
                getattr(one.motion, spec.name), getattr(other.motion, spec.name)
            )
    again = replay(loaded, method)
    assert isinstance(again, Trajectory)
    np.testing.assert_array_equal(again.positions, trajectory.positions)


@pytest.mark.parametrize(
    ("pairs", "offset", "words"),
    [
        ([[0, 1]], None, "go together"),
        ([[0, 1]], [[1.0]], "must both be"),
        ([[1, 0]], [[1.0, 0.0]], r"\[1, 0\] in offset_pairs"),
        ([[0, 3]], [[1.0, 0.0]], "two of 3 cells"),
        ([[1, 1]], [[1.0, 0.0]], "smaller index first"),
        ([[0, 1], [0, 1]], [[1.0, 0.0], [1.0, 0.0]], "stands twice"),
        ([[0, 1]], [[-1.0, 0.0]], "is -1 µm"),
        ([[0, 1]], [[1.0, np.nan]], "must be finite"),
    ],
)
def test_offset_without_meaning_is_refused(pairs, offset, words):
    ones = np.ones(3)
    motion = Motion(
        5 * ones, 0 * ones, ones, 0.5 * ones, 0.0, 1.0,
        offset_pairs=np.array(pairs), offset=None if offset is None else np.array(offset),
    )  # fmt: skip
    with pytest.raises(ValueError, match=words):
        Mechanics(JKR(), 5.0).begin(motion)


def test_no_pairs_with_offset_are_as_none():
    position, system = population(20, 1, JKR(), offset=False)
    expected = system.force(0.0, position)
    empty = np.empty((0, 2))
    system.begin(replace(system.motion, offset_pairs=empty.astype(np.int64), offset=empty))
    np.testing.assert_array_equal(system.force(0.0, position), expected)
