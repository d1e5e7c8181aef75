"""A small spheroid that is limited by oxygen at a few hundred cells
=================================================================

Problem
    80 cells with high uptake (60 amol/s each) at all stages of the cycle, in medium with
    0.02 mM of oxygen, for three days. Uptake causes a gradient of oxygen: inner cells become
    quiescent and the innermost ones die, while the rim continues to grow. Thresholds are
    lower than the defaults, to match the poor medium.
Scaling
    432 coupling steps of 10 min, up to about 530 cells; each step integrates the motion and
    solves for the oxygen field once.
Cost
    About 5 s on one core, the pictures included; longer when numba compiles the first time.
Command
    .. code-block:: sh

        python examples/small_spheroid.py [FOLDER]

    It writes FOLDER/report.html, growth.png, section.png, profiles.png and all results.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import multicell as mc
from multicell.scene.scene import Scene


def setup(**changes: Any) -> Scene:
    """Return the scene; arguments replace whole entries, such as ``duration="1 d"``."""
    return Scene.from_dict(
        {
            "title": "A small spheroid short of oxygen",
            "duration": "3 d",
            "seed": 1,
            "initial": {"count": 80, "spacing": 0.85, "jitter": 0.02, "stage": "uniform"},
            "growth": {"cycle_time": "15 h", "critical_pressure": "0.1 kPa"},
            "death": {"lysis_time": "24 h"},
            "nutrients": {
                "oxygen": {
                    "boundary": "0.02 mM",
                    "uptake": "60 amol/s",
                    "growth_half_saturation": "0.003 mM",
                    "quiescence": "0.007 mM",
                    "necrosis": "0.0045 mM",
                }
            },
            "output": {"every": "3 h"},
        }
        | changes
    )


def main(output: str | Path, **changes: Any) -> dict[str, Any]:
    """Run the scene, write results, pictures and the report; return the summary."""
    return mc.run(setup(**changes), output=output, overwrite=True).summary()


if __name__ == "__main__":
    summary = main(*(sys.argv[1:2] or ["out/small_spheroid"]))
    states = ", ".join(f"{count} {state}" for state, count in summary["states"].items())
    print(f"{summary['cells']} cells ({states}), diameter {summary['diameter']:.0f} um")
    print(f"necrotic radius {summary['necrotic_radius']:.0f} um")
