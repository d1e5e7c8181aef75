"""Populations made by hand, for the tests of everything that reads results."""

import numpy as np

from multicell.cells import Cells, State
from multicell.population.extents import centre, distances
from multicell.results.frame import Field, Frame
from multicell.results.observable import TissueState
from multicell.results.summary import history_row
from multicell.scene.scene import Scene

NECROSIS, QUIESCENCE, BOUNDARY = 0.005, 0.02, 0.07  # mM

# of their own: the built-in scenes may change their numbers
BARE = Scene.from_dict({"title": "Cells at rest", "duration": "1 h", "coupling_step": "1 min"})
SCENE = Scene.from_dict(
    {
        "title": "Oxygen-limited spheroid by hand",
        "duration": "11 d",
        "growth": {"cycle_time": "15 h"},
        "death": {},
        "nutrients": {
            "oxygen": {
                "boundary": BOUNDARY,
                "quiescence": QUIESCENCE,
                "necrosis": NECROSIS,
                "diffusion": 2000.0,
                "uptake": 20.0,
            }
        },
    }
)


def cells_at(position, radius=5.0, state=State.PROLIFERATING, pressure=0.0):
    """Return cells of the given centres; the other arguments may be scalars or arrays."""
    position = np.atleast_2d(np.asarray(position, float))
    n = len(position)
    return Cells(
        id=np.arange(n),
        parent=np.full(n, -1),
        position=position,
        radius=np.full(n, radius),
        young=np.ones(n),
        poisson=np.full(n, 0.5),
        state=np.full(n, state),
        age=np.linspace(0.0, 5e4, n),
        cycle_time=np.full(n, 5.4e4),
        pressure=np.full(n, pressure),
    )


def ball(count, spacing=8.4, seed=1, jitter=0.6):
    """Return about ``count`` points of a face-centred cubic lattice, cut to a ball and shaken."""
    volume = spacing**3 / np.sqrt(2.0)
    radius = (3.0 * count * volume / (4.0 * np.pi)) ** (1 / 3)
    reach = int(np.ceil(np.sqrt(2.0) * radius / spacing)) + 1
    grid = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), -1)
    points = grid.reshape(-1, 3)
    points = points[points.sum(axis=1) % 2 == 0] * spacing / np.sqrt(2.0)
    inside = points[np.linalg.norm(points, axis=1) < radius]
    return inside + np.random.default_rng(seed).normal(0.0, jitter, inside.shape)


def oxygen(radius, size):
    """Return a radial oxygen profile in mM about a spheroid of radius ``size``."""
    depth = np.clip((size - radius) / 85.0, 0.0, 1.0)
    inner = 0.05 * (1.0 - depth) ** 2 + 0.001
    outer = BOUNDARY - (BOUNDARY - 0.051) * size / np.maximum(radius, size)
    return np.where(radius < size, inner, outer)


def spheroid(count=4000, time=9.0 * 86400.0, seed=1):
    """Return a frame with a spheroid: necrotic core, quiescent layer, growing rim."""
    position = ball(count, seed=seed) + np.array([12.0, -7.0, 3.0])
    cells = cells_at(position)
    middle = centre(cells, 3)
    radius = distances(cells, middle)
    size = float(radius.max()) + 5.0
    c = oxygen(radius, size)
    cells.state[:] = np.select(
        [c < NECROSIS, c < QUIESCENCE], [State.NECROTIC, State.QUIESCENT], State.PROLIFERATING
    )
    rng = np.random.default_rng(seed + 1)
    cells.radius[:] = np.where(cells.state == State.NECROTIC, 3.4, rng.uniform(4.2, 5.0, len(c)))
    cells.pressure[:] = 0.05 * (1.0 - (radius / size) ** 2)
    return Frame(
        time=time,
        step=round(time / 600.0),
        cells=cells,
        concentrations={"oxygen": c},
        fields={"oxygen": _field(middle, size)},
    )


def _field(middle, size, spacing=10.0):
    n = int(np.ceil(2.0 * (size + 50.0) / spacing))
    origin = middle - 0.5 * n * spacing
    axis = (np.arange(n) + 0.5) * spacing - 0.5 * n * spacing
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    values = oxygen(np.sqrt(x**2 + y**2 + z**2), size)
    return Field(name="oxygen", unit="mM", origin=origin, spacing=spacing, values=values)


def growing_frames(count=8, days=9.0, last=4000):
    times = np.linspace(0.0, days * 86400.0, count)
    cells = last ** (1.0 - (1.0 - times / times[-1]) ** 1.6)
    return [spheroid(max(int(n), 1), t) for n, t in zip(cells, times, strict=True)]


def history_of(frames):
    return [history_row(TissueState(f, BARE)) for f in frames]
