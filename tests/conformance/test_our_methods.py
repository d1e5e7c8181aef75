"""Methods of integration of the package keep what is asked of the user's own."""

import pytest

from multicell.integrators.registry import METHODS
from multicell.testing import IntegratorTests

pytestmark = pytest.mark.kernels


class TestMethods(IntegratorTests):
    @pytest.fixture(params=METHODS)
    def method(self, request):
        return request.param
