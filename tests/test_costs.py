"""The account of what tests cost."""

import costs


def row(test, own, others=0.0, *, slow=False, compiled=()):
    return {
        "test": test,
        "slow": slow,
        "own": own,
        "others": others,
        "compiling": 0.5 * own,
        "garbage": 0.25 * own,
        "compiled": list(compiled),
        "took": dict.fromkeys(compiled[:1], 0.5 * own),
    }


def test_costs_are_summed_by_file_and_what_is_compiled_again_is_counted():
    rows = [
        row("a.py::first", 1.0, compiled=["f (int64,)", "g ()"]),
        row("b.py::second", 4.0, 2.0, slow=True, compiled=["f (int64,)", "f (float64,)"]),
        row("a.py::third", 3.0, compiled=["f (int64,)"]),
    ]
    lines = [line.split() for line in costs.table(rows)]
    head, whole, most, other, again, took, *tests = lines
    assert head == ["cpu", "short", "compiling", "others", "garbage", "tests"]
    assert whole == ["10.0", "4.0", "4.0", "2.0", "2.0", "3.0", "all"]
    assert most == ["6.0", "0.0", "2.0", "2.0", "1.0", "1.0", "b.py"]
    assert other == ["4.0", "4.0", "2.0", "0.0", "1.0", "2.0", "a.py"]
    assert again == ["5", "functions", "compiled,", "2", "of", "them", "again"]
    assert took == ["4.0", "f", "(int64,)"]
    assert tests == [["6.0", "b.py::second"], ["3.0", "a.py::third"], ["1.0", "a.py::first"]]
