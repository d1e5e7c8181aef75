"""Files of others cost a small multiple of their size in memory and time, whatever they hold."""

import json
import subprocess
import sys

import pytest

SHAPES = {
    "wide": "<a/>",
    "attributes": "<a name='b' units='min' enabled='true'>1</a>",
    "repeated": "<cell_definition name='b'><phenotype><volume><total>1</total></volume></phenotype>"
    "</cell_definition>",
    "deep": "<a>" * 40 + "</a>" * 40,
    "remarks": "text<!-- a remark -->",
    "lines": "\n",
    "interactions": "<attack_rate name='b'>0</attack_rate><damage_rate>1</damage_rate>",
}
READ = """
import json, os, resource, sys, time
from multicell.errors import MulticellError
from multicell.importing.files import read_xml
from multicell import import_physicell
import multicell.schema
from pathlib import Path

def cost(what, path):
    read = {"read": read_xml, "import": import_physicell}[what]
    before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    try:
        read(Path(path))
    except MulticellError:
        pass
    taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    return [1024 * taken, time.process_time() - began]

for line in sys.stdin:
    child = os.fork()
    if child == 0:
        print(json.dumps(cost(*json.loads(line))), flush=True)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        print("null", flush=True)
"""
"""Reads each file in a process of its own, which has read no other."""


@pytest.fixture(scope="module")
def cost():
    """Return a function for memory in bytes and CPU time in s of reading a file."""
    process = subprocess.Popen(
        [sys.executable, "-c", READ], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )

    def asked(what, path):
        process.stdin.write(json.dumps([what, str(path)]) + "\n")
        process.stdin.flush()
        answer = json.loads(process.stdout.readline())
        assert answer, "the process ended with an error, which is above"
        return answer

    with process:
        yield asked
        process.stdin.close()


def written(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("shape", SHAPES)
def test_xml_costs_a_multiple_of_its_size(shape, cost, tmp_path):
    piece, sizes = SHAPES[shape], (250_000, 1_000_000)
    costs = []
    for size in sizes:
        text = f"<root name='r'>{piece * (size // len(piece))}</root>"
        costs.append(cost("read", written(tmp_path / "a.xml", text)))
    (_, before), (memory, time) = costs
    assert memory < 60 * sizes[1] + 40e6
    assert time < 10 * before + 1.0  # sixteen times, where time grows with the square


def test_a_long_name_is_held_once(cost, tmp_path):
    text = f"<r><a name='{'n' * 10**6}'>{'<b>1</b>' * 50_000}</a></r>"
    memory, _ = cost("read", written(tmp_path / "a.xml", text))
    assert memory < 60 * len(text) + 40e6


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["attributes", "repeated", "interactions"])
@pytest.mark.parametrize("where", ["cell_definitions", "user_parameters", "cell_interactions"])
def test_an_import_costs_a_multiple_of_its_size(shape, where, cost, project, tmp_path):
    piece, sizes = SHAPES[shape], (100_000, 400_000)
    path, costs = project(), []
    plain = path.read_text(encoding="utf-8")
    assert f"</{where}>" in plain
    for size in sizes:
        more = piece * (size // len(piece))
        costs.append(
            cost("import", written(path, plain.replace(f"</{where}>", f"{more}</{where}>", 1)))
        )
    (_, before), (memory, time) = costs
    assert memory < 150 * sizes[1] + 60e6
    assert time < 10 * before + 1.0


@pytest.mark.slow
def test_a_long_name_stands_shortened_in_the_account(cost, project):
    path = project()
    plain = path.read_text(encoding="utf-8")
    more = f"<x name='{'n' * 10**6}'>{'<y>1</y>' * 30_000}</x>"
    path = written(path, plain.replace("</user_parameters>", f"{more}</user_parameters>", 1))
    memory, _ = cost("import", path)
    assert memory < 200e6
