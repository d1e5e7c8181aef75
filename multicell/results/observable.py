"""Observables: numbers of the state of a run, with their names, units and titles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.cells import Cells, FloatArray, IntArray, State
from multicell.errors import SceneError
from multicell.population.extents import Extent, NoExtent
from multicell.results.observables import touching

if TYPE_CHECKING:
    from multicell.results.frame import Frame
    from multicell.scene.parts import OwnObservable
    from multicell.scene.scene import Scene

_STATES: Final = tuple(state.name.lower() for state in State)


@final
class TissueState:
    """The state of a run as observables see it.

    Parameters
    ----------
    frame
        The state; observables that do not ask for fields do without them.
    scene
        Of the run.

    Attributes
    ----------
    frame, scene
        As given.
    """

    def __init__(self, frame: Frame, scene: Scene) -> None:
        self.frame = frame
        self.scene = scene

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return self.frame.time

    @property
    def cells(self) -> Cells:
        """All cells."""
        return self.frame.cells

    @property
    def concentrations(self) -> Mapping[str, FloatArray]:
        """Concentration of each field at the cells by its name, (n,) mM."""
        return self.frame.concentrations

    @property
    def dimensions(self) -> int:
        """Dimensions of the scene, 2 or 3."""
        return self.scene.dimensions

    @cached_property
    def contacts(self) -> IntArray:
        """Rows of the cells of each pair in contact, (m, 2); overlapping pairs if none is known."""
        return touching(self.frame, self._period)

    @property
    def _period(self) -> FloatArray | None:
        domain = self.scene.domain
        return None if domain is None else domain.period

    @cached_property
    def extent(self) -> Extent | NoExtent:
        """Extent of the population, of which all lengths are made; none where space repeats."""
        if self._period is not None:
            return NoExtent()
        return Extent(self.cells, self.dimensions)

    @cached_property
    def state_counts(self) -> Mapping[str, int]:
        """Number of cells in each state, by the name of the state in lower case."""
        state = self.cells.state
        return {name: int(np.count_nonzero(state == k)) for k, name in enumerate(_STATES)}

    @cached_property
    def sealed(self) -> TissueState:
        """The same state in arrays that cannot be written into."""
        cells = self.cells.shared()
        for name, column in self.cells.columns():
            setattr(cells, name, _seal(column))
        found = {name: _seal(values) for name, values in self.concentrations.items()}
        return TissueState(replace(self.frame, cells=cells, concentrations=found), self.scene)


def _seal(values: NDArray[Any]) -> NDArray[Any]:
    view = values.view()
    view.setflags(write=False)
    return view


def always(scene: Scene) -> bool:
    """Return that an observable exists in each scene."""
    return True


@final
@dataclass(frozen=True, eq=False, repr=False)
class Observable:
    """One observable, or one for each of several names that a scene gives.

    Attributes
    ----------
    name
        Column of the history. A star stands for a name that the scene gives, such as a field's.
    measure
        Function of the state (:class:`multicell.results.observable.TissueState`), and of the
        scene's name in place of a star. NaN where the number does not exist. None for what the
        coupling step itself finds and hands on.
    unit
        Base unit; empty for counts and ratios.
    title
        Name in words; by default ``name`` with spaces.
    exists
        Whether a scene has what the observable needs; of a starred name, for which names.
    entry
        Dotted name in the summary, by default ``name``; None for what is in the history only.
    at_end
        Whether it is in the summary only.
    absent
        When the number does not exist, in words; empty for one that is finite in every state.
    doc
        Its meaning, for the documentation (Markdown).
    signed
        Whether it may be negative.
    shown
        How key figures write it; None where it is none.
    shown_if_zero
        Whether it is a key figure also where it is 0.
    counts
        Whether it counts cells, of which each may stand for several (``cells.represents``).
    function, source
        Of the user's own: ``file.py:name@fingerprint``, by which scenes find it, and
        ``/path/file.py:name``, which other processes load. Empty for ours.
    """

    name: str
    measure: Callable[..., float | int] | None = None
    unit: str = ""
    title: str = ""
    exists: Callable[[Scene], Any] = field(default=always)
    entry: str | None = ""
    at_end: bool = False
    absent: str = ""
    doc: str = ""
    signed: bool = False
    shown: Callable[[Any], str] | None = None
    shown_if_zero: bool = True
    counts: bool = False
    function: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", self.title or self.name.replace("_", " "))
        if self.entry == "":
            object.__setattr__(self, "entry", self.name)

    def __call__(self, frame: Frame, scene: Scene) -> float:
        """Return the number in a frame of a run."""
        return float(self.value(TissueState(frame, scene)))

    def __repr__(self) -> str:
        return f"<observable {self.name} {self.function}>"

    def stated(self) -> dict[str, str]:
        """Return the statement of a scene on an observable of the user's own."""
        return {"function": self.function, "unit": self.unit}

    def keys(self, scene: Scene) -> list[str]:
        """Return the texts for the star in a scene; one empty text for a name without a star."""
        found = self.exists(scene)
        return list(found) if "*" in self.name else [""] if found else []

    def value(self, state: TissueState, key: str = "") -> float | int:
        """Return the number for one of :meth:`keys`."""
        assert self.measure is not None
        found = self.measure(state, key) if key else self.measure(state)
        return represented(state.scene, int(found)) if self.counts else float(found)


def represented(scene: Scene, count: int) -> int:
    """Return how many cells of the tissue a number of cells stands for."""
    each = scene.cells.represents
    return count if each is None else round(count * each)


OWN_OBSERVABLES: Final[dict[str, Observable]] = {}
"""Observables of the user's own by ``function``, as :func:`multicell.observable` enters them."""


def find_own(name: str, stated: OwnObservable) -> Observable:
    """Return the observable that a scene names."""
    path, function = f"output.observables.{name}", stated.function
    found = OWN_OBSERVABLES.get(function)
    if found is not None and found.name == name:
        if found.unit != stated.unit:
            raise SceneError(f"{path}.unit", f"is '{stated.unit}', must be '{found.unit}'")
        return found
    source = function.partition("@")[0]
    newer = [known for known in OWN_OBSERVABLES if known.startswith(f"{source}@")]
    hint = f"No scene runs a file by itself: name it with --observable {source}, or import it."
    if newer:
        hint = f"'{source}' has changed since: as it is now it is '{newer[-1]}'."
    raise SceneError(path, f"is '{function}', which this process does not know", hint)
