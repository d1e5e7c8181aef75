"""SBML as read, compared with closed forms."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

pytest.importorskip("sbmlode")

from sbml_text import document, event, function, reaction

from multicell.errors import SceneError
from multicell.networks.files import read_network

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


def read(tmp_path, text, inputs=(), given=(), name="own.xml"):
    path = tmp_path / name
    path.write_text(text)
    return read_network(path, inputs, given)


def solve(network, end, *, parameters=None, inputs=None, start=None):
    """Return the states at a time, by name."""
    p, u = np.array(network.values), np.array(network.defaults)
    for name, value in (parameters or {}).items():
        p[network.parameters.index(name)] = value
    for name, value in (inputs or {}).items():
        u[network.inputs.index(name)] = value
    y = np.array(network.start)
    network.initial(u, p, y)

    def slope(t, y):
        out = np.empty(len(y))
        network.rates(np.float64(t), y, u, p, out)
        return out

    found = solve_ivp(slope, (0.0, end), y, method="LSODA", rtol=1e-10, atol=1e-12)
    return dict(zip(network.states, found.y[:, -1], strict=True))


def value(tmp_path, formula, x=0.7, **more):
    """Return the rate of a formula of x."""
    text = document(parameters={"x": str(x), "z": "0"}, rates={"z": formula}, **more)
    network = read(tmp_path, text)
    out = np.empty(1)
    y, p = np.array(network.start), np.array(network.values)
    network.rates(np.float64(2.0), y, np.empty(0), p, out)
    return out[0]


def test_decay_of_a_concentration_is_its_exponential(tmp_path):
    text = document(
        species={"A": "2", "B": "0"}, parameters={"k": "0.3"}, sizes={"cell": "5"},
        reactions=reaction("r", "A", "2B", "k * A * cell"),
    )  # fmt: skip
    network = read(tmp_path, text)
    assert network.states == ("A", "B")
    assert network.observed == ("r",)
    end = solve(network, 4.0)
    assert end["A"] == pytest.approx(2 * math.exp(-1.2), rel=1e-8)
    assert end["B"] == pytest.approx(4 * (1 - math.exp(-1.2)), rel=1e-8)


def test_a_parameter_of_the_scene_changes_the_solution(tmp_path):
    text = document(species={"A": "2"}, parameters={"k": "0.3"},
                    reactions=reaction("r", "A", "", "k * A * cell"))  # fmt: skip
    end = solve(read(tmp_path, text), 4.0, parameters={"k": 0.5})
    assert end["A"] == pytest.approx(2 * math.exp(-2.0), rel=1e-8)


def test_a_species_in_a_growing_compartment_is_diluted(tmp_path):
    text = document(
        species={"A": "2"}, sizes={"cell": "1"}, parameters={"g": "0.25"},
        rates={"cell": "g * cell"}, reactions=reaction("r", "A", "", "0.1 * A * cell"),
    )  # fmt: skip
    network = read(tmp_path, text)
    end = solve(network, 3.0)
    assert end["A"] == pytest.approx(2 * math.exp(-0.35 * 3), rel=1e-8)
    assert end["cell"] == pytest.approx(math.exp(0.75), rel=1e-8)
    assert network.amounts == {"cell"}


def test_amounts_are_known_from_concentrations(tmp_path):
    text = document(
        species={"A": "2", "N": 'initialAmount="8" hasOnlySubstanceUnits="true"'},
        sizes={"cell": "4"}, reactions=reaction("r", "A N", "", "0.1 * A * N"),
    )  # fmt: skip
    network = read(tmp_path, text)
    assert dict(zip(network.states, network.start, strict=True)) == {"A": 2.0, "N": 8.0}
    assert network.amounts == {"N"}
    out = np.empty(2)
    network.rates(0.0, np.array([2.0, 8.0]), np.empty(0), np.array(network.values), out)
    assert out == pytest.approx([-1.6 / 4, -1.6])  # of 1.6 amounts per time


def test_initial_assignments_follow_parameters_that_are_set_later(tmp_path):
    text = document(parameters={"k": "2", "m": "0", "x": "0"}, rates={"x": "0 * m"},
                    initial={"m": "3 * k", "x": "m + 1"})  # fmt: skip
    network = read(tmp_path, text)
    assert network.start == (7.0,)
    assert network.computed == {"m"}
    p, y = np.array([5.0, 0.0]), np.empty(1)
    network.initial(np.empty(0), p, y)
    assert (p[1], y[0]) == (15.0, 16.0)


def test_rules_and_rates_of_reactions_are_observed_in_the_order_of_their_needs(tmp_path):
    text = document(species={"A": "2"}, parameters={"twice": "0", "more": "0"},
                    assigned={"more": "twice + 1", "twice": "2 * r"},
                    reactions=reaction("r", "A", "", "0.5 * A"))  # fmt: skip
    network = read(tmp_path, text)
    out = np.empty(3)
    network.observe(0.0, np.array([2.0]), np.empty(0), np.array(network.values), out)
    assert dict(zip(network.observed, out, strict=True)) == {"r": 1.0, "twice": 2.0, "more": 3.0}


@pytest.mark.parametrize(
    ("formula", "wanted"),
    [
        ("x^2 - x^-1 + x^0.5", 0.49 - 1 / 0.7 + math.sqrt(0.7)),
        ("root(3, x) + sqrt(x) + log10(x) + log(2, x) + ln(x)",
         0.7 ** (1 / 3) + 0.7**0.5 + math.log10(0.7) + math.log2(0.7) + math.log(0.7)),
        ("sec(x) + csc(x) + cot(x) + sech(x) + csch(x) + coth(x)",
         1 / math.cos(0.7) + 1 / math.sin(0.7) + 1 / math.tan(0.7)
         + 1 / math.cosh(0.7) + 1 / math.sinh(0.7) + 1 / math.tanh(0.7)),
        ("arcsec(2) + arccsc(2) + arccot(x) + arcsech(x) + arccsch(x) + arccoth(2)",
         math.acos(0.5) + math.asin(0.5) + math.atan(1 / 0.7) + math.acosh(1 / 0.7)
         + math.asinh(1 / 0.7) + math.atanh(0.5)),
        ("factorial(4) + floor(-0.5) + ceil(0.2) + abs(-x) + exp(x)", 24.7 + math.exp(0.7)),
        ("max(x, 3, 2) - min(x, 3, 2)", 2.3),
        ("quotient(-7, 2) + rem(-7, 2)", -4.0),
        ("piecewise(1, x > 1, 2, x > 0.5, 3)", 2.0),
        ("piecewise(1, x > 1)", math.nan),
        ("(x > 0.5) + 2 * (x < 0.5 || x == 0.7) + 4 * !(x)", 3.0),
        ("xor(true, true, true) + implies(true, false) + 2 * and() + 4 * or()", 3.0),
        ("piecewise(5, x, 6)", 5.0),
        ("time + pi + exponentiale", 2 + math.pi + math.e),
        ("avogadro", 6.02214179e23),
        ("1e300 * 1e300", math.inf),
        ("x - 1 - 2 - 3 / 4 / 5", 0.7 - 3 - 0.15),
        ("<apply><lt/><cn>1</cn><ci>x</ci><cn>2</cn></apply>", 0.0),
        ('<cn type="rational">3<sep/>8</cn>', 0.375),
        ('<cn type="e-notation">3<sep/>-2</cn>', 0.03),
    ],
)  # fmt: skip
def test_formulas_have_the_values_of_their_mathematics(tmp_path, formula, wanted):
    assert value(tmp_path, formula) == pytest.approx(wanted, rel=1e-14, nan_ok=True)


def test_function_definitions_take_their_arguments_by_place(tmp_path):
    functions = function("less", "a, b", "a - b") + function("more", "a, b", "less(b, a) * x0(a)")
    functions += function("x0", "x", "piecewise(x, x > 0, 0)")
    assert value(tmp_path, "more(x, 3)", functions=functions) == pytest.approx(2.3 * 0.7)


def test_rates_of_change_are_read(tmp_path):
    text = document(parameters={"x": "1", "w": "0"}, rates={"x": "-2 * x", "w": "rateOf(x)"})
    assert solve(read(tmp_path, text), 1.0)["w"] == pytest.approx(math.exp(-2) - 1, rel=1e-8)


def test_long_and_nested_formulas_are_read(tmp_path):
    long = " + ".join(f"{k} * x" for k in range(500))
    assert value(tmp_path, long) == pytest.approx(0.7 * 499 * 500 / 2)
    deep = "<apply><sin/>" * 90 + "<ci>x</ci>" + "</apply>" * 90
    wanted = 0.7
    for _ in range(90):
        wanted = math.sin(wanted)
    assert value(tmp_path, deep) == pytest.approx(wanted, rel=1e-14)


def test_names_of_python_mean_nothing_in_a_document(tmp_path):
    names = ("import_", "lambda", "np", "math", "exec", "y", "p", "u", "t", "out", "v0", "a0")
    text = document(parameters={name: str(k) for k, name in enumerate(names)} | {"x": "0"},
                    rates={"x": " + ".join(set(names) - {"lambda"})})  # fmt: skip
    network = read(tmp_path, text)
    assert network.parameters == names
    assert not any(name in network.source for name in ("lambda", "exec", "import", "a0", "np"))


def test_levels_1_and_2_are_read(tmp_path):
    old = (
        '<sbml xmlns="http://www.sbml.org/sbml/level1" level="1" version="2"><model name="m">'
        '<listOfCompartments><compartment name="c" volume="2"/></listOfCompartments>'
        '<listOfSpecies><species name="A" compartment="c" initialAmount="4"/></listOfSpecies>'
        '<listOfParameters><parameter name="k" value="0.5"/></listOfParameters>'
        '<listOfReactions><reaction name="r" reversible="false"><listOfReactants>'
        '<speciesReference species="A"/></listOfReactants><kineticLaw formula="k*A*c"/>'
        "</reaction></listOfReactions></model></sbml>"
    )
    assert solve(read(tmp_path, old), 2.0)["A"] == pytest.approx(2 * math.exp(-1), rel=1e-8)


def test_an_input_takes_the_place_of_a_parameter_and_of_a_species(tmp_path):
    text = document(species={"A": "2", "O2": "0.1"}, parameters={"k": "0.3"},
                    reactions=reaction("r", "A O2", "", "k * A * O2 * cell"))  # fmt: skip
    network = read(tmp_path, text, inputs=("O2", "k"))
    assert (network.states, network.inputs, network.defaults) == (("A",), ("O2", "k"), (0.1, 0.3))
    end = solve(network, 4.0, inputs={"O2": 0.5, "k": 1.0})
    assert end["A"] == pytest.approx(2 * math.exp(-2.0), rel=1e-8)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("O3", "has no 'O3'"),
        ("cell", "it is a compartment"),
        ("r", "has no 'r'"),
        ("s", "an assignment rule gives it"),
        ("w", "it has a rate of its own"),
        ("d", "an event changes it"),
    ],
)
def test_what_has_an_equation_of_its_own_is_no_input(tmp_path, name, problem):
    text = document(
        species={"O2": "0.1"}, parameters={"s": "1", "w": "1", "d": "1"},
        assigned={"s": "2 * d"}, rates={"w": "s"}, reactions=reaction("r", "O2", "", "O2"),
        events=event("e", "time > 1", {"d": "2"}),
    )  # fmt: skip
    with pytest.raises(SceneError, match=problem) as caught:
        read(tmp_path, text, inputs=(name,))
    assert caught.value.hint == ("Did you mean 'O2'?" if name == "O3" else "")


def test_a_parameter_without_a_value_is_refused_unless_it_is_given(tmp_path):
    text = document(parameters={"k": 'name="none"', "x": "1"}, rates={"x": "k"})
    with pytest.raises(SceneError, match="has no value for 'k'"):
        read(tmp_path, text)
    assert read(tmp_path, text, given=("k",)).parameters == ("k",)
    assert read(tmp_path, text, inputs=("k",)).inputs == ("k",)


def test_conditions_of_events_are_exact_at_their_roots(tmp_path):
    events = event("strict", "time > 1", {"d": "2"}) + event("not_strict", "time >= 1", {"d": "3"})
    text = document(parameters={"d": "1", "x": "0"}, rates={"x": "d"}, events=events)
    network = read(tmp_path, text)
    arrays = np.array(network.start), np.empty(0), np.array(network.values)
    strict, other = (event.trigger for event in network.events)
    assert [strict(t, *arrays) > 0 for t in (0.9, 1.0, 1.1)] == [False, False, True]
    assert [other(t, *arrays) > 0 for t in (0.9, 1.0, 1.1)] == [False, True, True]
    assert strict(0.25, *arrays) == -0.75


def test_an_event_takes_values_of_its_time_or_of_its_execution(tmp_path):
    for then, wanted in ((True, 20.0), (False, 70.0)):
        events = event("e", "time >= 1", {"d": "10 * x"}, then=then)
        text = document(parameters={"d": "1", "x": "2"}, rates={"x": "d"}, events=events)
        network = read(tmp_path, text)
        y, p = np.array([7.0]), np.array([1.0])
        network.events[0].assign(1.0, y, np.empty(0), p, np.array([2.0]), p.copy())
        assert (y[0], p[0]) == (7.0, wanted)


def test_an_event_that_changes_nothing_is_left_out(tmp_path):
    events = event("none", "x > 1", {}) + event("e", "x > 2", {"x": "0"})
    text = document(parameters={"x": "0"}, rates={"x": "1"}, events=events)
    text = text.replace("<listOfEventAssignments></listOfEventAssignments>", "")
    network = read(tmp_path, text)
    assert [one.name for one in network.events] == ["e"]
    assert network.events[0].trigger(0.0, np.array([3.0]), np.empty(0), np.empty(0)) == 1.0


def test_an_event_that_resizes_a_compartment_keeps_the_amounts_in_it(tmp_path):
    events = event("e", "time >= 1", {"cell": "2 * cell"}, initial=False, persistent=False)
    text = document(species={"A": "6", "B": "1"}, sizes={"cell": "3"},
                    reactions=reaction("r", "A", "B", "A"), events=events)  # fmt: skip
    network = read(tmp_path, text)
    assert (network.events[0].initial, network.events[0].persistent) == (False, False)
    y, p = np.array(network.start), np.array(network.values)
    network.events[0].assign(1.0, y, np.empty(0), p, y.copy(), p.copy())
    assert (list(y), list(p)) == ([3.0, 0.5], [6.0])


def test_units_are_those_that_the_document_states(tmp_path):
    def unit(name, *parts):
        listed = "".join(
            f'<unit kind="{kind}" exponent="{power}" scale="{scale}" multiplier="{size}"/>'
            for kind, power, scale, size in parts
        )
        return f'<unitDefinition id="{name}"><listOfUnits>{listed}</listOfUnits></unitDefinition>'

    units = unit("um", ("mole", 1, -6, 1)) + unit("minute", ("second", 1, 0, 60))
    units += unit("odd", ("second", 1, 0, 160)) + unit("rate", ("second", -1, 0, 60))
    text = document(
        species={"A": "2"}, units=units,
        parameters={"k": 'value="1" units="rate"', "s": 'value="1" units="odd"', "n": "1"},
        reactions=reaction("r", "A", "", "k * A * cell"),
        model=' substanceUnits="um" volumeUnits="litre" timeUnits="minute" extentUnits="um"',
    )  # fmt: skip
    network = read(tmp_path, text)
    assert network.time_unit == 60.0
    assert network.units == {"A": "uM", "cell": "l", "k": "1/min", "s": "160 s", "r": "umol/min"}


def test_a_document_without_units_states_none(tmp_path):
    network = read(tmp_path, document(parameters={"x": "1"}, rates={"x": "x"}))
    assert (network.units, network.time_unit) == ({}, None)


def test_compiled_functions_give_what_python_gives(tmp_path):
    from numba import njit

    text = document(
        species={"A": "2", "B": "0"}, parameters={"k": "0.3", "s": "0"},
        assigned={"s": "piecewise(A^2, A > 1, 0.5) / (1 + exp(-B)) + hill(A, 4)"},
        functions=function("hill", "x, n", "x^n / (1 + x^n)"),
        reactions=reaction("r", "A", "2B", "k * A * cell * s"),
        events=event("e", "A < 1", {"k": "0.1 + s"}),
    )  # fmt: skip
    network = read(tmp_path, text)
    y, u, p = np.array([1.3, 0.2]), np.empty(0), np.array(network.values)
    for function_, count in ((network.rates, 2), (network.observe, 2)):
        plain, compiled = np.empty(count), np.empty(count)
        function_(0.5, y, u, p, plain)
        njit(error_model="numpy")(function_)(0.5, y, u, p, compiled)
        assert plain == pytest.approx(compiled, rel=1e-14)
    change = network.events[0]
    assert njit(error_model="numpy")(change.trigger)(0.5, y, u, p) == change.trigger(0.5, y, u, p)
    mine, theirs = p.copy(), p.copy()
    change.assign(0.5, y.copy(), u, mine, y, p)
    njit(error_model="numpy")(change.assign)(0.5, y.copy(), u, theirs, y, p)
    assert mine == pytest.approx(theirs, rel=1e-14)
    assert mine[network.parameters.index("k")] != 0.3
