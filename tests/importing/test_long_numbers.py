"""Numbers of thousands of digits, which Python refuses to read, are refused in words."""

import pytest
from physicell_project import ON

import multicell as mc
from multicell.importing.files import whole_number

LONG = "7" * 5000
PLACES = {
    "random_seed": ("<random_seed>7<", f"<random_seed>{LONG}<", "no random seed"),
    "identifier": ('name="hunter" ID="3"', f'name="hunter" ID="{LONG}"', "must be a whole number"),
    "code of a cycle": ('<cycle code="5"', f'<cycle code="{LONG}"', "must be one of"),
}


@pytest.mark.parametrize("place", PLACES)
def test_numbers_of_settings(place, project):
    old, new, said = PLACES[place]
    with pytest.raises(mc.SceneError, match=said) as error:
        mc.import_physicell(project((old, new)))
    assert len(str(error.value)) < 500


def test_numbers_in_signals_of_rules(project):
    rules = f"tumour cell,contact with cell type {LONG},increases,cycle entry,0,1,4,0\n"
    account = str(mc.import_physicell(project(ON, rules=rules)).account)
    assert account


@pytest.mark.parametrize(
    ("text", "number"),
    [("0", 0), ("007", 7), (str(2**63 - 1), 2**63 - 1), (str(2**63), None), (LONG, None),
     ("0" * 5000 + "3", 3), ("-1", None), ("1.0", None), ("", None), ("²", None), ("٣", 3)],
)  # fmt: skip
def test_a_whole_number_is_one_of_64_bits(text, number):
    assert whole_number(text) == number
