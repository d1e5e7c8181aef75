"""The pictures of a run by name, for Python, the command ``plot`` and the report page.

Every method of :class:`Plots` returns a :class:`matplotlib.figure.Figure` of about 1600 x 1000
pixels and leaves matplotlib's global state alone. The colours of the states differ in lightness
too, so that they are distinguishable with any colour vision and in grey. Nothing that draws is
loaded before it is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from inspect import signature
from typing import TYPE_CHECKING, Any, Final, TypeVar, final

from multicell.errors import OutputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from multicell.report.plots.colouring import Colouring
    from multicell.report.plots.style import History
    from multicell.report.result import Result
    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene

_Method = TypeVar("_Method", bound="Callable[..., Figure]")

_MIN_CROWD: Final = 10  # cells, below which averages over shells say nothing


@final
@dataclass(frozen=True)
class PictureKind:
    """A picture of a run."""

    options: Sequence[str]  # what its method takes, such as "frame" or "colour"
    caption: str  # on the page of a run
    on_page: Callable[[Plots], bool]  # whether the page of a run shows it: has enough to draw


PICTURES: Final[dict[str, PictureKind]] = {}
"""The pictures of a run by the names of the methods that draw them, in the order of the page."""


def one_spelling(colour: str | None, color: str | None) -> str | None:
    """Return the value of an option with a British and an American name."""
    if colour is not None and color is not None:
        raise OutputError("colour and color are two names of one option: give one of them")
    return color if colour is None else colour


def _picture(
    caption: str = "", *, on_page: Callable[[Plots], bool] = lambda _: False
) -> Callable[[_Method], _Method]:
    """Enter a method of :class:`Plots` into :data:`PICTURES`."""

    def enter(method: _Method) -> _Method:
        options = list(signature(method).parameters)[1:]
        PICTURES[method.__name__] = PictureKind(options, caption, on_page)
        return method

    return enter


@final
@dataclass(frozen=True, eq=False, repr=False)
class Plots:
    """The pictures of one run; see :class:`multicell.report.result.Result`.

    Where there is nothing to draw (no history yet, a frame without cells, no second type, no
    pull) they raise ``ValueError``.
    """

    frames: Sequence[Frame]
    history: History
    scene: Scene
    lineage: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __call__(self) -> Figure:
        """Draw :meth:`growth`, or a section of a run without a history."""
        return self.growth() if self._has("time") else self.section()

    def _shaded(self, frame: int, colour: str | None) -> tuple[Frame, Scene, Colouring]:
        from multicell.report.plots.colouring import colouring

        chosen = self.frames[frame]
        return chosen, self.scene, colouring(chosen, self.scene, colour, self.lineage)

    def _has(self, column: str) -> bool:
        return len(self.history.get(column, ())) > 0

    def _crowd(self, least: int) -> bool:
        return len(self.frames) > 0 and len(self.frames[-1].cells) >= least

    @_picture("The population in the course of the run.", on_page=lambda run: run._has("time"))
    def growth(self) -> Figure:
        """Draw number of cells, diameter and states against time.

        Where nothing grows or starves these numbers stay: it is diameter and pressure then.
        """
        from multicell.report.plots.growth import growth, motion

        alive = self.scene.growth is not None or len(self.scene.nutrients) > 0
        return (growth if alive else motion)(self.history, self.scene)

    @_picture(
        "Cells in the plane through the centre, each drawn with the radius of its cut.",
        on_page=lambda run: run._crowd(1),
    )
    def section(
        self,
        frame: int = -1,
        *,
        plane: str | None = None,
        colour: str | None = None,
        color: str | None = None,
    ) -> Figure:
        """Show the cells that a plane cuts, at frame number ``frame``.

        Parameters
        ----------
        frame
            Its number; negative ones count from the last.
        plane
            ``"x"``, ``"x=0"``, ``"z=12 um"``; absent: z through the centre of the cells.
        colour, color
            ``"state"``, ``"type"``, ``"phase"``, ``"clone"``, a quantity of the cells such as
            ``"pressure"``, or the name of a field; absent: the types or, where all cells are alike,
            the states.

        Raises
        ------
        OutputError
            For a plane that cuts no cell, and a colour that is none.
        """
        from multicell.report.plots.section import Plane, section

        where = None if plane is None else Plane.parse(plane)
        return section(*self._shaded(frame, one_spelling(colour, color)), where)

    @_picture()
    def space(
        self,
        frame: int = -1,
        *,
        cut: str = "quarter",
        turn: float = 0.0,
        colour: str | None = None,
        color: str | None = None,
    ) -> Figure:
        """Show the cells in space as shaded spheres, at frame number ``frame``.

        Parameters
        ----------
        frame
            Its number; negative ones count from the last.
        cut
            What is cut away through the centre: ``"none"``, ``"half"`` or ``"quarter"``.
        turn
            Degrees by which the eye goes round the z axis, from where cuts open to it.
        colour, color
            As for :meth:`section`.

        Raises
        ------
        OutputError
            If the cells lie in a plane, and for a cut or a colour that is none.
        """
        from multicell.report.plots.space import View, space

        return space(*self._shaded(frame, one_spelling(colour, color)), View(turn, cut))

    def quantity(self, name: str, others: Mapping[str, Result] | None = None) -> Figure:
        """Draw a column of the history against time, also those of other runs.

        Parameters
        ----------
        name
            Of the column, such as ``"diameter"``.
        others
            Further runs by the names that the legend gives them.

        Raises
        ------
        OutputError
            If a run has no such column.
        """
        from multicell.report.plots.growth import overlay

        runs = {"this run": self.history}
        runs |= {label: run.history for label, run in (others or {}).items()}
        return overlay(runs, name)

    @_picture(
        "A map of every field in the plane through the centre, each over its own range.",
        on_page=lambda run: run._crowd(1) and len(run.frames[-1].fields) > 1,
    )
    def fields(self, frame: int = -1) -> Figure:
        """Show a map of every field in the plane z = centre, at frame number ``frame``."""
        from multicell.report.plots.section import field_maps

        return field_maps(self.frames[frame], self.scene)

    @_picture(
        "Averages over shells, in a plane over rings, about the centre.",
        on_page=lambda run: run._crowd(_MIN_CROWD),
    )
    def profiles(self, frame: int = -1) -> Figure:
        """Draw concentration (or pressure) and states against the distance from the centre."""
        from multicell.report.plots.profiles import profiles

        return profiles(self.frames[frame], self.scene)

    @_picture(
        "Contacts between cells of different types, and all contacts.",
        on_page=lambda run: run._crowd(0) and run._has("heterotypic_fraction"),
    )
    def contacts(self) -> Figure:
        """Draw the contacts between unlike cells, and all, against time."""
        from multicell.report.plots.contacts import contacts

        return contacts(self.frames, self.history, self.scene)

    @_picture(
        "Responses of cells: each behaviour over its signals.",
        on_page=lambda run: len(run.scene.responses) > 0,
    )
    def responses(self) -> Figure:
        """Draw each behaviour over the signals that it responds to, short forms included."""
        from multicell.report.plots.responses import response_curves

        return response_curves(self.scene)

    @_picture(
        "Force that pulls the cells apart, beside what their contact can bear.",
        on_page=lambda run: run._crowd(0) and run._has("pull"),
    )
    def pull(self) -> Figure:
        """Draw the pull against the distance of two cells, or the diameter of more."""
        from multicell.report.plots.contacts import pull

        return pull(self.frames, self.history, self.scene)
