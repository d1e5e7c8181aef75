"""Refusals of files, by name, and limits for hostile files."""

import os
import sys
import time
from itertools import pairwise

import pytest

pytest.importorskip("sbmlode")

from sbml_text import document, event, function, math, reaction

from multicell.errors import SceneError
from multicell.networks.files import read_network

DELAY = (
    '<apply><csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/delay">d'
    "</csymbol><ci>x</ci><cn>1</cn></apply>"
)
X = {"x": "1"}
L1 = (
    '<sbml xmlns="http://www.sbml.org/sbml/level1" level="1" version="2"><model name="m">'
    '<listOfCompartments><compartment name="c"/></listOfCompartments><listOfParameters>'
    '<parameter name="x" value="1"/></listOfParameters><listOfRules>'
    '<parameterRule name="x" type="rate" formula="%s"/></listOfRules></model></sbml>'
)


def package(name, inside="", *, required="true"):
    uri = f"http://www.sbml.org/sbml/level3/version1/{name}/version1"
    text = document(
        parameters=X, rates={"x": "x"}, root=f' xmlns:q="{uri}" q:required="{required}"'
    )
    return text.replace("<listOfParameters>", f"{inside}<listOfParameters>")


def read(tmp_path, text, name="own.xml"):
    path = tmp_path / name
    path.write_text(text)
    return read_network(path)


def ruled(formula, **more):
    return document(parameters=X, rates={"x": formula}, **more)


FAST = document(species={"A": "1"}, reactions=reaction("r7", "A", "", "A", fast=' fast="true"'))
OLD_FAST = (
    '<sbml xmlns="http://www.sbml.org/sbml/level2/version4" level="2" version="4"><model id="m">'
    '<listOfCompartments><compartment id="c" size="1"/></listOfCompartments><listOfSpecies>'
    '<species id="A" compartment="c" initialAmount="1"/></listOfSpecies><listOfReactions>'
    '<reaction id="r7" fast="true"><listOfReactants><speciesReference species="A"/>'
    f"</listOfReactants><kineticLaw>{math('A')}</kineticLaw></reaction></listOfReactions>"
    "</model></sbml>"
)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (FAST.replace("version2", "version1").replace('version="2"', 'version="1"'),
         r"a fast reaction \('r7', line 2\)"),
        (OLD_FAST, r"a fast reaction \('r7', line 1\)"),
        (ruled(DELAY), "a delay"),
        (ruled("1", events=event("e", "x > 1", {"x": "0"}, f"<delay>{math('1')}</delay>")),
         "a delay"),
        (ruled("1", events=event("e", "x > 1", {"x": "0"}, f"<priority>{math('1')}</priority>")),
         "an event with a priority"),
        (document(parameters=X, rules=f"<algebraicRule>{math('x - 1')}</algebraicRule>"),
         "an algebraic rule"),
        (package("comp"), "a model made of submodels"),
        (package("comp", "<q:listOfSubmodels/>", required="false"), "a model made of submodels"),
        (package("fbc", "<q:listOfObjectives/>", required="false"), "flux balance analysis"),
        (package("qual"), r"a qualitative \(Boolean\) model"),
        (package("spatial"), "the package 'spatial'"),
        (ruled('<csymbol definitionURL="http://x.org/normal" encoding="text">n</csymbol>'),
         "symbol normal"),
        (ruled("1", events=event("e", "x == 2", {"x": "0"})), r"event trigger \('e'\)"),
        (L1 % "x +", r"line 2: 'rateRule|parameterRule' has no formula that can be read"),
        (document(parameters=X, rates={"y": "x"}), "names 'y', which it does not define"),
        (document(parameters=X, rates={"x": "x"}, initial={"y": "2"}), "names 'y'"),
        (document(species={"A": "1"}, reactions=reaction("r", "A", "B", "A")), "names 'B'"),
        (document(species={"A": 'initialAmount="1" compartment="no"'}), "names 'no'"),
        (document(species={"A": "1"}, parameters={"A": "1"}), "has two things called 'A'"),
        (document(parameters=X, rates={"x": "x"}).replace('constant="false"', 'constant="true"'),
         "has a rule for 'x', which it calls constant"),
        (ruled("nothing"), "has a formula of 'nothing'"),
        (ruled("f(x)"), "calls 'f'"),
        (ruled("f(x)", functions=function("f", "a, b", "a + b")), "calls 'f' with 1 arguments"),
        (ruled("f(x)", functions=function("f", "a", "g(a)") + function("g", "a", "f(a)")),
         "need each other in a circle"),
        (document(parameters=X | {"a": "1", "b": "1"}, rates={"x": "a"},
                  assigned={"a": "b", "b": "a"}), "need each other in a circle: 'a', 'b'"),
        (ruled("<apply><sin/></apply>"), r"has 'sin\(\)', which is not among the arithmetic"),
        (ruled('<cn type="integer">99999999999999999999</cn>'), "is no valid SBML"),
        (document(parameters={"x": "NaN"}, rates={"x": "1"}), "begins with 'x' at nan"),
        (document(parameters={"x": "INF"}, rates={"x": "1"}), "begins with 'x' at inf"),
        ("<html><body/></html>", "is no SBML: its first element is 'html'"),
        ("words", "is not well-formed XML"),
        ("", "is not well-formed XML"),
        (document(parameters=X)[:-20], "is not well-formed XML"),
        (document().replace("<model id=\"own\"></model>", ""), "has no model"),
        (document().replace("level3", "level9").replace('"3"', '"9"'), "is no valid SBML"),
    ],
)  # fmt: skip
def test_what_is_not_read_is_refused_by_name(tmp_path, text, problem):
    with pytest.raises(SceneError, match=problem) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith("own.xml")


def test_all_that_is_not_read_is_said_at_once(tmp_path):
    more = f"<priority>{math('1')}</priority>"
    text = ruled(DELAY, events=event("e", "x > 1", {"x": "0"}, more))
    with pytest.raises(SceneError, match=r"a delay .*, an event with a priority"):
        read(tmp_path, text)


def test_remarks_and_harmless_packages_change_nothing(tmp_path):
    text = ruled("2").replace("<listOfParameters>", "<notes><p xmlns='http://www.w3.org/1999/xhtml'>"
                              "<algebraicRule/></p></notes><listOfParameters>")  # fmt: skip
    assert read(tmp_path, text).states == ("x",)
    assert read(tmp_path, package("layout", required="false")).states == ("x",)


@pytest.mark.parametrize(
    "text",
    [
        document(parameters={'x&quot;);__import__(&quot;os': "1"}),
        document(parameters={"xé": "1"}),
        document(parameters={"x" * 200: "1"}, rates={"x" * 200: "1"}),
        ruled('<ci>__import__("os").system("touch HERE")</ci>'),
        ruled('<apply><ci>exec</ci><ci>x</ci></apply>'),
        ruled('<apply><ci>x.__class__</ci><ci>x</ci></apply>'),
        L1 % "__import__(x)",
        L1 % "x; import os",
        ruled("x").replace("<model", "<!-- --><model").replace('id="own"', "id=\"own'''\""),
    ],
)  # fmt: skip
def test_no_text_of_a_document_gets_into_code(tmp_path, text):
    with pytest.raises(SceneError):
        read(tmp_path, text)
    assert os.listdir(tmp_path) == ["own.xml"]


def test_a_function_called_like_one_of_python_is_only_arithmetic(tmp_path):
    network = read(tmp_path, ruled("exec(x)", functions=function("exec", "a", "a + 1")))
    assert "exec" not in network.source


def doubled(count):
    lines = [function("f0", "a", "a")]
    lines += [function(f"f{k}", "a", f"f{k - 1}(a) + f{k - 1}(a)") for k in range(1, count)]
    return "".join(lines)


def entities(count):
    names = "".join(f'<!ENTITY e{k + 1} "{f"&e{k};" * 10}">' for k in range(count))
    return f'<!DOCTYPE x [<!ENTITY e0 "ha">{names}]><x>&e{count};</x>'


def rates_of_rates(count):
    names = [f"x{k}" for k in range(count)]
    rates = {b: f"rateOf({a}) + rateOf({a})" for a, b in pairwise(names)}
    return document(parameters=dict.fromkeys(names, "1"), rates={"x0": "1", **rates})


def sizes_of_sizes(count):
    rules = {f"{one}{k}": f"a{k + 1} * b{k + 1}" for k in range(count) for one in "ab"}
    last = {f"a{count}": f"a{count}", f"b{count}": "1"}
    return document(
        species={"S": "1"}, sizes={"cell": "1"}, parameters=dict.fromkeys([*rules, *last], "1"),
        assigned={"cell": "a0 + b0", **rules}, rates=last, reactions=reaction("r", "S", "", "S"),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (entities(12), "has a document type"),
        ('<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><x>&e;</x>', "document type"),
        (ruled("<apply><sin/>" * 100_000 + "<ci>x</ci>" + "</apply>" * 100_000), "too deeply"),
        (L1 % ("-" * 4900 + "x"), "nested too deeply"),
        (L1 % "^".join("x" * 2400), "nested too deeply"),
        (L1 % "+".join("x" * 3000), "a formula of more than 5000 characters"),
        (ruled("f40(x)", functions=doubled(41)), "more than 100,000 parts once expanded"),
        (rates_of_rates(40), "more than 100,000 parts once expanded"),
        (sizes_of_sizes(60), "more than 100,000 parts once expanded"),
        (document(parameters={f"k{k}": "1" for k in range(20_001)}), "more than 20,000"),
    ],
)
def test_what_grows_or_nests_beyond_use_is_refused_soon(tmp_path, text, problem):
    begin = time.perf_counter()
    with pytest.raises(SceneError, match=problem):
        read(tmp_path, text)
    assert time.perf_counter() - begin < 20.0  # a growing one would take hours


def test_a_file_of_50_megabytes_is_refused_unread(tmp_path):
    path = tmp_path / "own.xml"
    with path.open("wb") as file:
        file.truncate(50_000_000)
    with pytest.raises(SceneError, match="it is larger than 20 MB"):
        read_network(path)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("none.xml", "there is no file"),
        ("folder.xml", "cannot be read"),
        ("own.py", "is no file of a network by its name"),
        ("latin.xml", "is not UTF-8 text"),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(tmp_path, name, problem):
    (tmp_path / "folder.xml").mkdir()
    (tmp_path / "own.py").write_text("1/0")
    (tmp_path / "latin.xml").write_bytes("é".encode("latin-1"))
    with pytest.raises(SceneError, match=problem):
        read_network(tmp_path / name)


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes by name")
def test_a_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "own.xml")
    with pytest.raises(SceneError, match="is no regular file"):
        read_network(tmp_path / "own.xml")
