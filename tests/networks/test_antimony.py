"""Networks from texts of Antimony."""

import numpy as np
import pytest

pytest.importorskip("sbmlode")
pytest.importorskip("antimony")

from multicell.errors import SceneError
from multicell.networks import antimony_text
from multicell.networks.files import read_network

TEXT = """
model own
  compartment cell = 2
  species A in cell = 3, B in cell = 0
  A -> 2 B; k*A*cell
  k = 0.5
  at (A < 1): k = 0.25
end
"""


def read(tmp_path, text, **more):
    path = tmp_path / "own.ant"
    path.write_text(text)
    return read_network(path, **more)


def test_a_text_is_read_as_the_network_that_it_describes(tmp_path):
    network = read(tmp_path, TEXT)
    assert (network.name, network.states, network.start) == ("own", ("A", "B"), (3.0, 0.0))
    out = np.empty(2)
    network.rates(0.0, np.array([3.0, 0.0]), np.empty(0), np.array(network.values), out)
    assert list(out) == [-1.5, 3.0]
    assert [event.trigger(0.0, np.array([0.5, 0.0]), np.empty(0), np.empty(9)) > 0
            for event in network.events] == [True]  # fmt: skip


def test_modules_within_one_file_are_put_together(tmp_path):
    text = (
        "model decay\n X -> ; k*X\n X = 1; k = 2\nend\nmodel *own()\n a: decay()\n b: decay()\nend"
    )
    network = read(tmp_path, text)
    assert len(network.states) == 2
    assert network.start == (1.0, 1.0)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("rate k 2", "is no valid Antimony"),
        ('import "/etc/passwd"', "line 1: imports another file"),
        ('A = 1\nIMPORT /* */ "x.xml"', "line 2: imports another file"),
        ("A := 1 + delay(time, 1)", "a delay"),
        ("A = 1; B = 1; 0 = A + B", "is no valid Antimony|an algebraic rule"),
        ("A = 1; A' = 1; at 2 after A > 3: A = 0", "a delay"),
        ("A = 1; A' = 1; at A > 3, priority = 2: A = 0", "an event with a priority"),
        ("A = " + "(" * 100_000 + "1" + ")" * 100_000, "cannot read|is no valid|too deeply"),
        ("A = 1 " * 300_000, "of more than 1,000,000 characters"),
    ],
)
def test_what_is_not_read_is_refused_by_name(tmp_path, text, problem):
    with pytest.raises(SceneError, match=problem) as caught:
        read(tmp_path, text)
    assert "own.ant" in str(caught.value)


def test_a_library_that_does_not_come_back_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(antimony_text, "_SECONDS", 0.01)
    with pytest.raises(SceneError, match="took Antimony more than"):
        read(tmp_path, TEXT)


def test_a_library_that_crashes_ends_its_own_process_only(tmp_path, monkeypatch):
    monkeypatch.setattr(antimony_text, "_CHILD", "import os; os.abort()")
    with pytest.raises(SceneError, match="cannot read"):
        read(tmp_path, TEXT)
