"""A project of PhysiCell that tests write with their changes."""

import pytest
from physicell_project import writer


@pytest.fixture
def project(tmp_path):
    return writer(tmp_path)
