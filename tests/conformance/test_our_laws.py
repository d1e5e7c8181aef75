"""Contact laws, growth laws and responses of the package keep what is asked of the user's own."""

import pytest
from law_samples import SAMPLES

from multicell.behaviours.growth_laws.laws import GROWTH_LAWS
from multicell.behaviours.laws import RESPONSE_LAWS
from multicell.schema import specs
from multicell.testing import GrowthLawTests, PairLawTests, ResponseTests

RESPONSES = {
    "hill": {"half": 2.0, "power": 3.0}, "monod": {"half": 2.0}, "threshold": {"half": 2.0},
    "linear": {"begin": 1.0, "end": 4.0}, "table": {"points": ((1.0, 0.2), (4.0, 0.9))},
    "constant": {},
}  # fmt: skip


class TestPairLaws(PairLawTests):
    # each law compiles all kernels: one is enough where time is short
    @pytest.fixture(
        params=[
            pytest.param(name, marks=() if name == "hertz" else pytest.mark.slow)
            for name in SAMPLES
        ]
    )
    def law(self, request):
        return SAMPLES[request.param]


class TestGrowthLaws(GrowthLawTests):
    @pytest.fixture(params=GROWTH_LAWS)
    def law(self, request):
        kind = GROWTH_LAWS[request.param]
        return kind(**({"target": 1.3} if "target" in specs(kind) else {}))


class TestResponses(ResponseTests):
    @pytest.fixture(params=RESPONSE_LAWS)
    def law(self, request):
        return RESPONSE_LAWS[request.param](**RESPONSES[request.param])
