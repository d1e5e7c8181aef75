"""Numbers of thousands of digits, which Python refuses to read, are refused in words."""

import pytest
from physicell_project import ON

import multicell as mc

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
