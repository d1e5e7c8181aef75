"""The check of methods of integration: each broken promise is named."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import multicell as mc
from multicell.integrators.base import EqualSteps, info_of
from multicell.integrators.rkc import Rkc2
from multicell.testing import check_integrator


@pytest.mark.slow
def test_an_object_keeps_its_other_settings():
    assert info_of(Rkc2(step=1.0, stages=5)).make(step=2.0) == Rkc2(step=2.0, stages=5)
    check_integrator("rkc2-5")


@dataclass(frozen=True)
class Own(EqualSteps):
    """Euler's method, which a test breaks in one place."""

    info = mc.MethodInfo("own", order=1)

    def integrate(self, system, position):
        x, slope = np.array(position), np.empty_like(position)
        begin, end = system.motion.begin, system.motion.end
        count = round((end - begin) / self.step)
        try:
            for k in range(count):
                system.velocity(begin + k * self.step, x, slope)
                x += self.step * slope
                system.work.steps += 1
        except mc.StateRejected as error:
            return mc.Outcome(begin, x, str(error))
        return mc.Outcome(end, x)


def broken(change):
    """Return a class whose solves are changed."""

    @dataclass(frozen=True)
    class Broken(EqualSteps):
        info = Own.info

        def integrate(self, system, position):
            return change(self, system, position)

    return Broken


def in_place(method, system, position):
    outcome = Own(method.step).integrate(system, position)
    position[:] = outcome.position
    return outcome


def handed_back(method, system, position):
    if not np.isfinite(position).all():
        return Own(method.step).integrate(system, position)
    position += 0.0
    return replace(Own(method.step).integrate(system, position), position=position)


def remembering(method, system, position):
    seen.append(len(position))
    outcome = Own(method.step).integrate(system, position)
    return replace(outcome, position=outcome.position + 1e-12 * len(seen))


def careless(method, system, position):
    x, slope = np.array(position), np.empty_like(position)
    system.velocity(system.motion.begin, x, slope)
    return Own(method.step).integrate(system, x)


def uncounted(method, system, position):
    outcome = Own(method.step).integrate(system, position)
    system.work.steps = 0
    return outcome


def too_short(method, system, position):
    outcome = Own(method.step).integrate(system, position)
    return outcome if outcome.problem else replace(outcome, time=outcome.time - 1.0)


def nothing(method, system, position):
    system.work.steps += 1
    system.velocity(system.motion.begin, position, np.empty_like(position))
    return mc.Outcome(system.motion.end, np.array(position))


def growing(method, system, position):
    system.motion.radius[0] += 0.1
    return Own(method.step).integrate(system, position)


seen: list[int] = []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (in_place, "it changes the positions"),
        (handed_back, "it returns the array that it was given"),
        (remembering, "it does not give the same bits again"),
        (careless, "it raises StateRejected: a position is not a number"),
        (uncounted, "it does not count its steps"),
        (too_short, "it ends at 109.0 s, not at 110.0 s"),
        (nothing, "its order is "),
        (growing, "it changes what is known of the cells"),
        (lambda *_: None, "it does not return an Outcome"),
    ],
)
def test_a_broken_promise_is_named(change, problem):
    with pytest.raises(AssertionError, match=r"^own: ") as caught:
        check_integrator(broken(change))
    assert problem in str(caught.value)


def test_a_method_of_another_order_than_it_claims():
    check_integrator(Own)
    with pytest.raises(AssertionError, match=r"its order is 1\.0\d, not 2"):
        check_integrator(type("Second", (Own,), {"info": replace(Own.info, order=2)}))


def test_a_method_without_a_setting():
    @dataclass(frozen=True)
    class Fixed:
        def integrate(self, system, position):
            return Own(1.0).integrate(system, position)

    with pytest.raises(AssertionError, match="takes no 'atol'"):
        check_integrator(Fixed)


@pytest.mark.parametrize("what", [3, "nothing", object])
def test_what_is_no_integrator_is_refused(what):
    with pytest.raises(mc.SceneError, match=r"'nothing'|is no integrator"):
        check_integrator(what)
