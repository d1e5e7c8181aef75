"""Numbers of short runs beside the version of the model: whoever changes them raises it."""

import pytest

import multicell as mc
from multicell.studies.runs import MODEL_VERSION

CHANGED = """
The numbers of a run have changed. Results that studies keep are found by the scene and the
version of the model: raise MODEL_VERSION in multicell/studies/runs.py, and give the new numbers
here, or runs made before the change are taken for runs made after it."""

SCENES = {
    "growth": {"duration": "34 h"},
    "spheroid": {
        "duration": "3 h",
        "initial.count": 60,
        "initial.stage": "uniform",
        "nutrients.oxygen.boundary": "0.032 mM",
        "nutrients.oxygen.spacing": "12 um",
    },
    "sorting-signal": {"duration": "30 min", "initial.count": 40},
    "doublet": {
        "nutrients.signal": {
            "boundary": 0,
            "uptake": 0,
            "secretion": "0.01 amol/s",
            "diffusion": "10 um^2/s",
            "spacing": "10 um",
            "margin": "50 um",
            "regime": "transient",
        },
        "duration": "10 min",
        "integrator": "rkc2",
        "pull": None,
    },
}
NUMBERS = {
    12: {
        "growth": {"cells": 4, "volume": 1413.2421188721537, "distance": 8.122308148674017},
        "spheroid": {
            "cells": 70,
            "volume": 25719.406131665884,
            "distance": 128.25364522634015,
            "oxygen": 0.027996074766916623,
        },
        "sorting-signal": {
            "cells": 40,
            "volume": 16491.355589038554,
            "distance": 90.69607040771024,
            "factor": 2.3737148191840975e-07,
        },
        "doublet": {
            "cells": 2,
            "volume": 8379.15539468978,
            "distance": 12.14720884896446,
            "signal": 9.955420528322894e-06,
        },
    }
}
AVX512 = {
    12: {
        "sorting-signal": {
            "distance": 90.6964919026131,
            "factor": 2.3737000593342047e-07,
        }
    }
}
"""Where the last digits of NumPy's functions, which differ on such processors, decide of a step."""


def numbers(name):
    result = mc.run(mc.load_scene(name).with_changes(SCENES[name]))
    frame = result.frames[-1]
    found = {
        "cells": len(frame.cells),
        "volume": frame.cells.volume.sum(),
        "distance": (frame.cells.position**2).sum() ** 0.5,
    }
    for field, levels in frame.concentrations.items():
        found[field] = levels.mean()
    return found


@pytest.mark.parametrize("name", SCENES)
def test_numbers_belong_to_the_version_of_the_model(name):
    found = numbers(name)
    known = NUMBERS[MODEL_VERSION][name]
    there = known | AVX512[MODEL_VERSION].get(name, {})
    assert any(found == pytest.approx(x, rel=1e-9) for x in (known, there)), CHANGED
