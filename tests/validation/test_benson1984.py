"""Oxygen in water: solubility by Benson and Krause (1984), and water vapour by steam tables."""

import pytest

from multicell.scene.scene import Scene
from multicell.units import oxygen_solubility, vapour_pressure

SUBJECT, SOURCE = "oxygen in water", "benson1984"


def test_at_body_temperature_as_physiology_has_it(compare):
    """A Bunsen coefficient of 0.0239 (litres at 0 °C and 101.325 kPa in a litre of water)."""
    bunsen = oxygen_solubility(37.0) * 101.325 * 22.392e-3
    what = "Bunsen coefficient of oxygen at 37 °C (physiology)"
    compare.value(what, 0.0239, bunsen, 6e-3 * 0.0239)
    per_mmhg = oxygen_solubility(37.0) * 0.133322387
    what = "solubility of oxygen at 37 °C (physiology)"
    compare.value(what, 1.40e-3, per_mmhg, 5e-3 * 1.40e-3, "mM/mmHg")


# mg/L in water in moist air of 101.325 kPa (Benson & Krause 1984)
SATURATED = {0: 14.62, 5: 12.77, 10: 11.29, 15: 10.08, 20: 9.09, 25: 8.26, 30: 7.56, 35: 6.95,
             40: 6.41}  # fmt: skip


@pytest.mark.parametrize("temperature", SATURATED)
def test_a_percentage_is_of_gas_at_sea_level_with_water_vapour(temperature, compare):
    """Dry air has 20.946 % of oxygen."""
    oxygen = {"boundary": "20.946 %", "temperature": temperature}
    scene = Scene.from_dict({"duration": "1 h", "nutrients": {"oxygen": oxygen}})
    ours, theirs = scene.nutrients["oxygen"].boundary * 31.998, SATURATED[temperature]
    what = f"oxygen in water below moist air at {temperature} °C"
    compare.value(what, theirs, ours, 5e-3 * theirs, "mg/L")


def test_the_pressure_of_water_vapour_is_that_of_steam_tables(compare):
    """Of IAPWS-95, kPa."""
    known = {0.0: 0.6112, 20.0: 2.3393, 37.0: 6.2823, 50.0: 12.352, 60.0: 19.946}
    for temperature, pressure in known.items():
        what = f"pressure of water vapour at {temperature:g} °C (steam tables, IAPWS-95)"
        compare.value(what, pressure, vapour_pressure(temperature), 2e-3 * pressure, "kPa")
