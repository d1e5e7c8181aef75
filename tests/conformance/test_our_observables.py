"""Observables of the package keep what is asked of the user's own."""

import pytest

import multicell as mc
from multicell.results.measures import OBSERVABLES
from multicell.testing import ObservableTests, check_observable

FEW = {"duration": "1 h", "coupling_step": "10 min", "initial": {"count": 9}}
WALLED = {**FEW, "domain": {**{axis: [-60.0, 60.0] for axis in "xyz"}}}
PULLED = {"duration": "1 min", "coupling_step": "10 s", "initial": {"count": 2, "spacing": 0.95},
          "pull": {"force": 1.0, "rate": 0.01}}  # fmt: skip
HIT = {**FEW, "growth": {},
       "radiation": {"course": {"dose": "2 Gy", "times": ["10 min"], "alpha": "0.3 1/Gy",
                                "mitotic_divisions": 1}}}  # fmt: skip
PHASED = {**FEW,
          "growth": {"phases": {"G1": {"duration": "9 h"}, "S": {"duration": "8 h"},
                                "G2": {"duration": "4 h"}, "M": {"duration": "1 h"}}}}  # fmt: skip
GEL = {**FEW, "domain": {"shape": "sphere", "radius": "60 um", "stiffness": "10 kPa"}}


@mc.network(states={"A": 1.0}, parameters={"k": 1e-4})
def grown(t, y, u, p, out):
    """A state that rises."""
    out[0] = p[0] * y[0]


FURTHER = {
    **dict.fromkeys(("necrotic_ratio", "inhibited_radius", "inhibited_ratio"), PHASED),
    **dict.fromkeys(("volume_fraction", "wall_pressure", "tissue_pressure"), WALLED),
    "domain_radius": GEL,
    "ki67_positive": {**PHASED, "growth": {**PHASED["growth"], "ki67_decay": "1 h"}},
    "pull": PULLED, "clonogens": HIT, "doomed": HIT,
    **{f"network_{x}_*": {**FEW, "networks": {"grown": {"network": grown}}}
       for x in ("mean", "low", "high")},
}  # fmt: skip


class TestObservables(ObservableTests):
    @pytest.fixture(params=[o.name for o in OBSERVABLES if o.measure is not None])
    def observable(self, request):
        (ours,) = (o for o in OBSERVABLES if o.name == request.param)
        return ours

    def test_observable_keeps_its_promises(self, observable):
        further = FURTHER.get(observable.name)
        check_observable(observable, mc.Scene.from_dict(further) if further else None)
