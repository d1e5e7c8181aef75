r"""An observable of one's own: how strongly oxygen is layered in a spheroid
=========================================================================

Problem
    The mean distance from the centre of cells that divide, over that of all cells: 1 where cells
    divide everywhere, larger where only a rim does. It is recorded, kept on disk, and compared
    with the same function applied to the saved frames.
Scaling
    A ratio of lengths, so it has no unit. Of 500 cells in 0.03 mM of oxygen those in the middle
    rest.
Cost
    Half a minute, most of it to compile; a few seconds from then on.
Command
    .. code-block:: sh

        python examples/own_observable.py
        multicell run spheroid --set duration='1 d' \
            --observable examples/own_observable.py:rim_ratio -o out
        multicell plot out --quantity rim_ratio
"""

import numpy as np

import multicell as mc


@mc.observable(
    name="rim ratio",
    needs=["growth"],
    absent="without cells that divide, and with a single cell",
)
def rim_ratio(state):
    """Return the mean distance of dividing cells from the centre over that of all cells."""
    cells = state.cells
    dividing = cells.state == mc.State.PROLIFERATING
    if not dividing.any() or len(cells) == 1:
        return np.nan
    away = np.linalg.norm(cells.position - cells.position.mean(axis=0), axis=1)
    return away[dividing].mean() / away.mean()


@mc.observable(name="dividing volume", unit="um^3")
def dividing_volume(state):
    """Return the volume of all cells that divide."""
    return state.cells.volume[state.cells.state == mc.State.PROLIFERATING].sum()


def setup():
    """Return a scene in which both are recorded."""
    return (
        mc.load_scene("spheroid")
        .with_changes(
            {
                "duration": "3 h",
                "initial.count": 500,
                "initial.stage": "asynchronous",
                "nutrients.oxygen.boundary": "0.03 mM",
                "output.every": "1 h",
            }
        )
        .with_observables(rim_ratio, dividing_volume)
    )


def main(output=None):
    """Check both, run the scene, and return its result."""
    for own in (rim_ratio, dividing_volume):
        mc.testing.check_observable(own)
    result = mc.run(setup(), output=output)
    for frame in result.frames:
        print(f"{frame.time / 3600:.0f} h: rim ratio {rim_ratio(frame, result.scene):.3f}")
    print(f"at the end: {result.summary()['dividing_volume']:.4g} um^3 divide")
    return result


if __name__ == "__main__":
    main()
