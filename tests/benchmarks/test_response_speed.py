"""What a response costs in a coupling step of 100,000 cells.

pytest -m benchmark tests/benchmarks/test_response_speed.py -s
"""

import time

import pytest

import multicell as mc
from multicell.biology.responding import value_of

pytestmark = pytest.mark.benchmark


def test_a_response_costs_at_most_a_hundredth_of_a_step(benchmark):
    scene = mc.load_scene("spheroid").with_changes(
        {
            "initial.count": 100_000,
            "initial.stage": "asynchronous",
            "types": {"sensitive": {}, "resistant": {}},
            "responses": [
                {"behaviour": "growth rate", "signal": "oxygen", "law": "hill", "half": 0.01,
                 "power": 3, "base": 0, "largest": 1, "cells": "sensitive"},
            ],
        }
    )  # fmt: skip
    run = mc.Simulation(scene, threads=1)
    run.step()
    began = time.process_time()
    run.step()
    step = time.process_time() - began
    found, cells = run.signals, run.cells

    def respond():
        return value_of(run.plan, "growth rate", 1.0, found, cells)

    assert benchmark.pedantic(respond, rounds=20, warmup_rounds=2).shape == (len(cells),)
    each = benchmark.stats.stats.median / len(run.plan.responses["growth rate"])
    print(f"\nstep {step:.2f} s; a response {1e3 * each:.2f} ms, {each / step:.2%} of it")
