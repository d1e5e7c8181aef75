"""Limits of methods, where there is nothing to solve and where double precision ends: every method,
every law."""

import itertools

import numpy as np
import pytest
from strategies import mechanics

import multicell as mc
from multicell.contact.registry import CONTACT_LAWS
from multicell.errors import SceneError
from multicell.integrators import limits
from multicell.integrators.cvode import Cvode
from multicell.integrators.registry import METHODS, from_options
from multicell.integrators.restarts import IntegrationProgress
from multicell.mechanics import blocks
from multicell.mechanics import preconditioners as sparse
from multicell.mechanics.motion import StateRejected
from multicell.scene.parts import IntegratorOptions

pytestmark = pytest.mark.kernels

LONE = {
    "nobody": np.empty((0, 3)),
    "one cell": np.zeros((1, 3)),
    "far apart": np.array([[0.0, 0.0, 0.0], [1e3, 0.0, 0.0], [0.0, 1e3, 0.0]]),
    "far apart in space": np.array([[0.0, 0.0, 0.0], [1e3, 0.0, 0.0], [0.0, 0.0, 1e3]]),
}
NO_FRICTION = {name for name, info in METHODS.items() if not info.friction}


def method(name, **options):
    return from_options(IntegratorOptions(method=name, **options))


# every method with one law and every law with some methods: a compiled loop is made for each law
LONELY = [
    (name, law)
    for name, law in itertools.product(sorted(METHODS), sorted(CONTACT_LAWS))
    if law == "jkr" or name in ("cvode", "backward-euler", "scipy-rk45")
]


@pytest.mark.parametrize(
    ("name", "law", "friction"),
    [*((*each, (0.0, 0.0)) for each in LONELY),
     *((name, "jkr", (0.1, 0.05)) for name in sorted(METHODS))],
)  # fmt: skip
def test_cells_without_neighbours_stay_where_they_are(name, law, friction):
    for start, duration in [*((start, 100.0) for start in LONE.values()), (LONE["one cell"], 0.0)]:
        n = len(start)
        system = mechanics(np.full(n, 5.0), np.ones(n), CONTACT_LAWS[law](), rate=np.full(n, 1e-3),
                           duration=duration, friction=friction)  # fmt: skip
        if friction[0] > 0.0 and name in NO_FRICTION:
            with pytest.raises(SceneError, match="friction"):
                method(name).integrate(system, start)
            continue
        outcome = method(name).integrate(system, start)
        assert outcome.done, outcome.problem
        assert outcome.time == duration
        assert np.array_equal(outcome.position, start)


# beyond double precision


@pytest.fixture
def open_door(monkeypatch):
    """Let scenes in that are refused by their numbers: what integrates must not rely on that."""
    monkeypatch.setitem(mc.Scene.check.__globals__, "check_sizes", lambda scene: None)


def forced(scene, numbers):
    """Return a scene with numbers that no scene may have, put in behind all checks."""
    for path, value in numbers.items():
        *parts, last = path.split(".")
        part = scene
        for name in parts:
            part = getattr(part, name)
        object.__setattr__(part, last, value)
    return scene


EXTREME = {
    "thin medium": {"drag.viscosity": 1e-30},
    "thin": {"drag.viscosity": 1e-15},
    "hard cells": {"cells.young": 1e30},
}


@pytest.mark.parametrize(
    ("name", "scene", "what"),
    [*((name, "settle", "thin") for name in sorted(METHODS)),
     *(("cvode", "doublet-settle", what) for what in EXTREME)],
)  # fmt: skip
def test_what_double_precision_cannot_follow_is_refused_at_once(what, scene, name, open_door):
    """At 1e-30 kPa s two cells of a doublet ended out of contact, 15.2 um across for 10.97."""
    plain = {"initial.count": 2, "integrator": name, "coupling_step": "10 min"}
    scene = forced(mc.load_scene(scene).with_changes(plain), EXTREME[what])
    with pytest.raises(mc.StepFailed, match=r"double precision follows up to 4\.5e\+12"):
        mc.run(scene)


@pytest.mark.parametrize("viscosity", [1e-6, 1e-11])
@pytest.mark.parametrize(
    "name", ["cvode", "cvode-adams", "backward-euler", "scipy-radau", "scipy-bdf"]
)
def test_up_to_there_a_doublet_finds_its_equilibrium(name, viscosity, open_door):
    """Where stiffness outruns everything, what is left is the rest distance of the law."""
    scene = mc.load_scene("doublet-settle").with_changes({"integrator": name, "duration": "20 min"})
    scene = forced(scene, {"drag.viscosity": viscosity})
    cells = mc.run(scene).frames[-1].cells
    radius = cells.radius[0]
    modulus = 1.0 / (2 * 0.75 * (1 - cells.poisson[0] ** 2) / cells.young[0])
    rest = 2 * radius - float(scene.contact.equilibrium_overlap(modulus, radius / 2))
    assert np.linalg.norm(cells.position[0] - cells.position[1]) == pytest.approx(rest, abs=2e-3)
    # nothing pulls a doublet as a whole
    start = np.zeros(3)
    assert cells.position.mean(axis=0) == pytest.approx(start, abs=1e-2)


@pytest.mark.parametrize("law", sorted(n for n, law in CONTACT_LAWS.items() if law.acts))
def test_the_scale_of_stiffness_is_that_of_the_jacobian(law):
    """Against the bound from the blocks of J, for packed cells of several sizes."""
    for radius in (0.01, 5.0, 500.0):
        n = 4
        lattice = 1.5 * radius * np.array(
            [[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], float
        ) / np.sqrt(2)  # fmt: skip
        system = mechanics(np.full(n, radius), np.ones(n), CONTACT_LAWS[law]())
        exact = system.stiffness_bound(0.0, lattice)
        assert 0.05 < limits.stiffness_scale(system) / exact < 20.0


def test_an_empty_step_has_no_stiffness():
    assert limits.stiffness_scale(mechanics(np.full(1, 5.0), np.ones(1))) == 0.0
    assert limits.find_failure(mechanics(np.empty(0), np.empty(0)), np.empty((0, 3))) is None


@pytest.mark.parametrize("name", [n for n, info in METHODS.items() if info.control == "tolerance"])
def test_a_tolerance_larger_than_the_cells_is_refused(name, open_door):
    scene = mc.load_scene("doublet-settle").with_changes(
        {"cells.division_radius": "1e-4 um", "integrator": name, "duration": "10 min",
         "contact.surface_energy": 0.0}
    )  # fmt: skip
    with pytest.raises(mc.StepFailed, match="no error would be too large"):
        mc.run(scene)


def inverse(six):
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.parametrize("stiffness", [1e2, 1e8, 1e12])
@pytest.mark.parametrize("contacts", [1, 2, 3])
def test_blocks_are_inverted_at_any_stiffness(stiffness, contacts):
    """One stiff contact beside two free directions: cofactors would give nonsense or 1 / 0."""
    rng = np.random.default_rng(contacts)
    worst = 0.0
    for _ in range(200):
        normals = rng.normal(size=(contacts, 3))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        block = sum(np.outer(n, n) for n in normals)
        six = np.array(
            [[block[0, 0], block[1, 1], block[2, 2], block[0, 1], block[0, 2], block[1, 2]]]
        )
        out = np.empty((1, 6))
        rows = np.zeros((1, 5))
        rows[0, 3] = 1.0
        blocks.invert_blocks(rows, six, stiffness, 1.0, out)
        whole = np.eye(3) + stiffness * block
        vector = rng.normal(size=3)
        # what it is for: the answer to a right-hand side, at most off by what rounding costs
        product = whole @ (inverse(out[0]) @ vector)
        worst = max(worst, float(np.abs(product - vector).max() / np.abs(vector).max()))
        small = 1e-20 * (np.array([[1.0, 1.0, 1.0, 0.0, 0.0, 0.0]]) + stiffness * six)
        sparse._invert(small, 0)
        assert np.isfinite(small).all()
        assert np.linalg.eigvalsh(inverse(small[0] * 1e-20))[0] > 0.0
    assert np.isfinite(worst)
    # below the change of method cofactors lose the square, as they always did
    lost = stiffness if stiffness > blocks.NEARLY_SINGULAR else stiffness**2
    assert worst <= max(1e-13 * lost, 1e-12)


# solvers that fail before their first step


def test_a_solver_that_cannot_be_made_is_a_named_failure():
    system = mechanics(np.full(2, 5.0), np.ones(2))
    run = IntegrationProgress(
        Cvode(max_steps=100), system, np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    )

    def start(run, ceiling):
        raise StateRejected("a position is not a number")

    outcome = run.integrate(start)
    assert not outcome.done
    assert "not a number" in outcome.problem


def test_a_singular_matrix_of_scipy_is_a_named_failure(monkeypatch):
    from scipy.integrate import BDF

    def singular(self):
        raise RuntimeError("Factor is exactly singular")

    monkeypatch.setattr(BDF, "step", singular)
    system = mechanics(np.full(2, 5.0), np.ones(2))
    start = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    outcome = method("scipy-bdf").integrate(system, start)
    assert "SciPy: Factor is exactly singular" in outcome.problem


@pytest.mark.parametrize("viscosity", [1e-2, 1e-6, 1e-10])
def test_backward_euler_ends_at_solutions(viscosity):
    """The residual of each step against SciPy's root finder's measure, not by the correction."""
    start = np.array([[0.0, 0.0, 0.0], [5.0, 5.0, 0.0]])
    system = mechanics(np.full(2, 5.0), np.ones(2), duration=10.0, viscosity=viscosity)
    outcome = method("backward-euler").integrate(system, start)
    assert outcome.done
    velocity = np.empty_like(start)
    system.velocity(10.0, outcome.position, velocity)
    assert np.abs(outcome.position - start - 10.0 * velocity).max() <= 1e-2
    assert outcome.position.mean(axis=0) == pytest.approx(start.mean(axis=0), abs=1e-2)
