"""The fixture by which tests of validation record what they compare (``comparisons``)."""

import json
from dataclasses import asdict

import pytest
from comparisons import ANEW, PROPERTY, Comparing, stored_rows


@pytest.fixture
def compare(request, record_property):
    """Compare, and hand each row to the report of the test."""
    file, test = request.path.name, request.node.name
    known = None
    if not request.config.pluginmanager.hasplugin(ANEW):
        stored = (row for row in stored_rows() if (row.file, row.test) == (file, test))
        known = {row.what: row for row in stored}
    comparing = Comparing(file, test, request.module.SUBJECT, request.module.SOURCE, known)
    yield comparing
    if request.node.rep_call_passed:
        comparing.finish()
    for row in comparing.rows:
        record_property(PROPERTY, json.dumps(asdict(row)))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    """Note whether a test passed, for the end of its fixture."""
    outcome = yield
    if call.when == "call":
        item.rep_call_passed = outcome.get_result().passed
