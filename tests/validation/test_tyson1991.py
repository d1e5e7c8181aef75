"""The oscillator of cdc2 and cyclin of Tyson (1991), which divides the cells that it is in."""

import numpy as np
import pytest
from cycling_networks import births_of, cycling

import multicell as mc

SUBJECT, SOURCE = "networks", "tyson1991"

TYSON = """
// J. J. Tyson, PNAS 88 (1991) 7328, Table 1 and its six equations; time in minutes
model tyson
  unit minute = 60 second
  unit time_unit = minute
  species C2 = 0, CP = 0.75, pM = 0.25, M = 0, Y = 0, YP = 0
  k1 = 0.015; k3 = 200; k4 = 180; k4p = 0.018; k6 = 1; k7 = 0.6; k8 = 1e6; k9 = 1e3
  CT := C2 + CP + pM + M
  J1: -> Y; k1
  J3: CP + Y -> pM; k3 * CP * Y
  J4: pM -> M; pM * (k4p + k4 * (M/CT)^2)
  J6: M -> C2 + YP; k6 * M
  J7: YP -> ; k7 * YP
  J8: C2 -> CP; k8 * C2
  J9: CP -> C2; k9 * CP
end
"""


def test_the_oscillator_divides_cells_at_its_period(compare, tmp_path):
    pytest.importorskip("antimony")
    file = tmp_path / "tyson.ant"
    file.write_text(TYSON)
    table = {"file": str(file), "dilution": False}
    scene = cycling(table, "cycle.M > 0.1", duration="200 min", coupling_step="4 min")
    times = births_of(mc.Simulation(scene, threads=1)) / 60.0
    # one cell, two, four, eight: all of a generation at the same time
    each = np.unique(np.round(times, 2))
    assert [int(np.sum(np.abs(times - x) < 0.05)) for x in each] == [1, 2, 4, 8, 16]
    # Fig. 3a of the paper, at k4 = 180 and k6 = 1 per minute
    period = float(np.diff(each).mean())
    compare.value("period of cells that the oscillator divides", 35.0, period, 1.0, "min")
    # solve_ivp with LSODA at a relative tolerance of 1e-9; the pulse before that comes in G2
    assert each[0] == pytest.approx(48.88, abs=0.05)
    np.testing.assert_allclose(np.diff(each), 35.60, atol=0.05)
