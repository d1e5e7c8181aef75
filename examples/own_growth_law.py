"""A growth law of one's own: von Bertalanffy's, with the volume that a cell would come to
=======================================================================================

Problem
    Uptake through the surface and upkeep of the volume: dV/dt = a V^(2/3) - b V (L. von
    Bertalanffy, Q. Rev. Biol. 32 (1957) 217). A law as a Python function, checked, then run: a
    colony of three days, compared with one whose cells grow linearly.
Scaling
    Volumes are over that at birth, so that cells divide at 2. With the volume K that a cell would
    come to, a/b = K^(1/3). multicell scales the rate so that the volume doubles in a cycle.
Cost
    A few seconds.
Command
    .. code-block:: sh

        python examples/own_growth_law.py
        multicell run growth --law examples/own_growth_law.py:Bertalanffy -o o
"""

import numpy as np

import multicell as mc
from multicell.schema import number


@mc.growth_law(parameters={"largest": number(default=3.0, above=2.0)})
def Bertalanffy(volume, p):  # noqa: N802 - a law is a class
    """dV/dt ~ K^(1/3) V^(2/3) - V, with the largest volume K over that at birth."""
    return np.cbrt(p.largest * volume**2) - volume


def main():
    """Check the law, and let a colony grow by it; return the mean ages of cells over their cycle.

    Young cells grow faster by this law than old ones, so that at equal ages they are larger.
    """
    law = Bertalanffy(largest=2.2)
    mc.testing.check_growth_law(law)
    print(f"{law} keeps what runs rely on.")
    scene = mc.load_scene("growth").with_changes({"duration": "3 d"})
    volumes = {}
    for name, changed in (("linear", "linear"), ("Bertalanffy", law)):
        cells = mc.run(scene.with_changes({"growth.law": changed})).frames[-1].cells
        volumes[name] = cells.volume
        mean = cells.volume.mean()
        print(f"{name:11} {len(cells)} cells, mean volume {mean:.0f} um3")
    return volumes


if __name__ == "__main__":
    main()
