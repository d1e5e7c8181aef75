"""The equation of a frame of a run, for py-pde's solvers and for ours."""

from dataclasses import replace

import numpy as np
import pytest

import multicell as mc
from multicell.nutrient.fields import FieldSystem

SUGAR = {
    "diffusion": "600 um^2/s", "boundary": "5 mM", "uptake": "30 amol/s",
    "half_saturation": "0.04 mM", "spacing": "15 um", "regime": "steady",
}  # fmt: skip
AIR = {"boundary": "0.07 mM", "uptake": "20 amol/s", "spacing": "15 um", "regime": "steady"}


def scene_with(nutrients, **changes):
    scene = mc.load_scene("growth")
    tables = {f"nutrients.{name}": table for name, table in nutrients.items()}
    return scene.with_changes(
        {"initial.count": 60, "duration": "40 min", "coupling_step": "20 min", **tables, **changes}
    )


def frames_of(scene):
    return mc.run(scene).frames


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"nutrients.oxygen.geometry": "radial"},
        {"nutrients.oxygen.diffusion_medium": "3000 um^2/s", "nutrients.oxygen.decay": "0.01 1/s"},
        {
            "nutrients.oxygen.media": [["10 min", "0.03 mM"]],
            "nutrients.oxygen.perfusion": "0.02 1/s",
            "nutrients.oxygen.secretion": "1 amol/s",
        },
        {"dimensions": 2, "nutrients.oxygen.height": "10 um"},
        {
            "nutrients.oxygen.finite_medium": {"volume": "1e7 um^3"},
            "nutrients.oxygen.media": [["10 min", "0.03 mM"]],
        },
    ],
)
def test_a_steady_field_of_a_frame_is_at_rest_in_its_equation(changes):
    scene = scene_with({"oxygen": AIR}, **changes)
    for frame in frames_of(scene)[::2]:
        problem = mc.field_problem(scene, frame)
        assert problem.time == frame.time
        np.testing.assert_array_equal(
            problem.state.data.ravel(), frame.fields["oxygen"].values.ravel()
        )
        balance = problem.equation.balance(problem.state, problem.time)["oxygen"]
        assert balance["uptake"] > 100.0
        assert abs(balance["stored"]) < 1e-8 * balance["uptake"]
        capacity = problem.equation.substances["oxygen"].substance.capacity
        assert capacity.shape == (len(frame.cells),)
        again = problem.equation.solve(
            problem.equation.state({"oxygen": 0.05}),
            (problem.time, problem.time + 1.0),
            solver="multicell-steady",
            tracker=None,
        )
        np.testing.assert_allclose(again.data, problem.state.data, atol=1e-9)


def test_what_a_finite_medium_holds_is_the_frame_s():
    scene = scene_with({"oxygen": AIR | {"finite_medium": {"volume": "5e6 um^3"}}})
    first, *_, last = frames_of(scene)
    levels = []
    for frame in (first, last):
        equation = mc.field_problem(scene, frame).equation
        state = equation.state({"oxygen": 0.01})
        account = equation.balance(state, frame.time)["oxygen"]
        gained = account["inflow"] + account["secreted"] - account["uptake"] - account["decayed"]
        assert account["stored"] == pytest.approx(gained, rel=1e-10)
        levels.append(equation.substances["oxygen"].schedule.at(frame.time + 1e9))
    assert levels[0] == pytest.approx(0.07)
    assert levels[1] == frame.progress.ledger["oxygen"]["level"] != levels[0]
    with pytest.raises(mc.SceneError, match="does not say what the finite medium of oxygen holds"):
        mc.field_problem(scene, replace(last, progress=None))


def test_fields_that_depend_on_each_other_do_so_in_one_equation():
    """They rest where the fields' own solvers rest, and take the same course by SciPy."""
    nutrients = {
        "oxygen": AIR | {"uptake_on": {"glucose": {"effect": 2.0, "half": "1 mM"}}},
        "glucose": SUGAR,
        "lactate": SUGAR
        | {"boundary": "0 mM", "uptake": "0 amol/s", "secretion_from": {"glucose": 1.8}},
    }
    scene = scene_with(nutrients)
    frame = frames_of(scene)[0]
    problem = mc.field_problem(scene, frame)
    equation, state, cells = problem.equation, problem.state, frame.cells
    assert equation.names == list(scene.nutrients)
    assert list(state.labels) == equation.names
    system = FieldSystem(scene)
    system.begin(cells, 0.0)
    for name in equation.names:
        values = state[name].data
        np.testing.assert_allclose(values, system.fields[name].field().values, atol=1e-9 * 5.0)
    found = equation.balance(state)
    for name, account in found.items():
        size = max(abs(x) for x in account.values())
        assert abs(account["stored"]) < 1e-7 * size, name
    taken = found["glucose"]["uptake"]
    assert found["lactate"]["secreted"] == pytest.approx(1.8 * taken, rel=1e-12)
    start = equation.state({"oxygen": 0.07, "glucose": 0.5, "lactate": 0.0})
    rest = equation.solve(start, 1.0, solver="multicell-steady", tracker=None)
    np.testing.assert_allclose(rest.data, state.data, atol=1e-8)
    span = (0.0, 0.2)
    ours = equation.solve(start, span, solver="multicell-implicit", rtol=1e-7, tracker=None)
    theirs = equation.solve(
        start, span, solver="scipy", method="RK45", rtol=1e-8, atol=1e-10, backend="numpy",
        tracker=None,
    )  # fmt: skip
    np.testing.assert_allclose(ours.data, theirs.data, rtol=2e-6, atol=5e-6)
    assert np.abs(ours.data - start.data).max() > 1e-3
    # alone it keeps the uptake that the frame's glucose gives it
    alone = mc.field_problem(scene, frame, ["oxygen"])
    expected = 20.0 * (1.0 + 2.0 / (1.0 + frame.concentrations["glucose"]))
    np.testing.assert_allclose(alone.equation.substances["oxygen"].substance.capacity, expected)


def test_what_cannot_be_had_is_said():
    without = mc.load_scene("settle").with_changes({"initial.count": 3, "duration": "1 min"})
    frame = frames_of(without)[0]
    with pytest.raises(mc.SceneError, match="nutrients: are none"):
        mc.field_problem(without, frame)
    scene = scene_with({"oxygen": AIR, "glucose": SUGAR | {"spacing": "18 um"}})
    with pytest.raises(mc.SceneError, match="frame: holds no field 'oxygen'"):
        mc.field_problem(scene, frame)
    frame = frames_of(scene)[-1]
    with pytest.raises(mc.SceneError, match=r"different grids.*\['oxygen'\] and \['glucose'\]"):
        mc.field_problem(scene, frame)
    assert mc.field_problem(scene, frame, ["glucose"]).equation.names == ["glucose"]
    with pytest.raises(mc.SceneError, match=r"'sugar', which is no field .*\(oxygen, glucose\)"):
        mc.field_problem(scene, frame, ["sugar"])
    for wrong in ("oxygen", []):
        with pytest.raises(mc.SceneError, match="expected a list of names"):
            mc.field_problem(scene, frame, wrong)
