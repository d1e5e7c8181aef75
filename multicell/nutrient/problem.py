"""The fields' equation of a frame, for py-pde's solvers and for ours."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

from multicell.cells import FloatArray
from multicell.errors import SceneError
from multicell.nutrient.equations.equation import FieldEquation
from multicell.nutrient.equations.substance import Schedule
from multicell.nutrient.fields import FieldSystem
from multicell.nutrient.grid import restored, tissue_share
from multicell.nutrient.group import substance
from multicell.nutrient.parameters import FieldParameters
from multicell.nutrient.tissue import Tissue, reaching
from multicell.scene.dependences import solving_order

if TYPE_CHECKING:
    from pde.fields.collection import FieldCollection
    from pde.fields.scalar import ScalarField

    from multicell.results.frame import Frame
    from multicell.scene.scene import Scene


@final
@dataclass(frozen=True, eq=False)
class FieldProblem:
    """The fields of a frame that share a grid, as an equation and a state of py-pde's.

    >>> problem = mc.field_problem(scene, frame)                               # doctest: +SKIP
    >>> problem.equation.solve(problem.state, (problem.time, problem.time + 600.0),
    ...                        solver="multicell-implicit")                     # doctest: +SKIP

    Attributes
    ----------
    equation : FieldEquation
        With the frame's cells where they are and as they are: they do not move, change or die.
    state : ScalarField or FieldCollection, mM
        The frame's own fields.
    time : float, s
        Of the frame; the medium is that of the scene from there on. A finite medium stays as it is
        in the frame.
    """

    equation: FieldEquation
    state: ScalarField | FieldCollection
    time: float


def field_problem(
    scene: Scene,
    frame: Frame,
    fields: Iterable[str] | None = None,
    *,
    reactions: Mapping[str, Any] | None = None,
) -> FieldProblem:
    """Return the equation and the state of the fields of a frame.

    Uptake and secretion are those of the frame's cells, also where they depend on other fields.

    Parameters
    ----------
    scene
        That the frame comes from.
    frame
        Of any run of it; it may be one that was read from a file.
    fields
        Names of the fields that are wanted; absent: all. They must share a grid, as fields with
        the same spacing, margin, its shape and geometry do, and hold all that one of them reacts
        with.
    reactions
        Of the user's own that the run was started with.

    Raises
    ------
    SceneError
        If the scene has no fields, a name is not one of its fields, the frame does not hold it,
        fields live on different grids, or one is left out that others react with.
    """
    names = _chosen(scene, frame, fields)
    together = frame.to_pde(names)
    known = _reactions({**scene.reactions, **(reactions or {})}, names)
    layout, cells = restored(frame.fields[names[0]])[0], frame.cells
    position = layout.nearest(cells.position)  # strays exchange with the surface of the grid
    system = FieldSystem(scene)
    taken = _taken(system, scene, frame)
    substances, tissue = {}, Tissue(cells.position, cells.radius)
    for name in names:
        parameters = FieldParameters.of(scene, name)
        medium = _medium(parameters, frame, name)
        demand = system.demand(name, cells, frame.concentrations, taken)
        exchange = system.fields[name].exchange(layout, tissue)
        about = layout, position, tissue, demand, medium, exchange
        substances[name] = substance(parameters, *about)
    equation = FieldEquation(
        together.grid,
        substances,
        position,
        layout=layout,
        reactions=known,
        radius=reaching(cells.position, position, cells.radius),
        tissue=tissue_share(layout, position, cells.radius) if known else None,
    )
    state = together if len(names) > 1 else frame.fields[names[0]].to_pde()
    return FieldProblem(equation, state, frame.time)


def _chosen(scene: Scene, frame: Frame, fields: Iterable[str] | None) -> list[str]:
    """Return the names of the fields that are wanted, in the scene's order."""
    if not scene.nutrients:
        raise SceneError("nutrients", "are none: the scene has no fields, and so no equation")
    wanted = list(scene.nutrients) if fields is None else list(fields)
    if isinstance(fields, str) or not wanted:
        raise SceneError("fields", f"is {fields!r}, expected a list of names")
    for name in wanted:
        if name not in scene.nutrients:
            known = ", ".join(scene.nutrients)
            raise SceneError("fields", f"has {name!r}, which is no field of the scene ({known})")
        if name not in frame.fields or name not in frame.concentrations:
            raise SceneError("frame", f"holds no field {name!r}", "Is it one of another scene?")
    return [name for name in scene.nutrients if name in wanted]


def _reactions(reactions: Mapping[str, Any], names: list[str]) -> dict[str, Any]:
    """Return the reactions between these fields."""
    found = {}
    for name, reaction in reactions.items():
        there = [field for field in reaction.fields if field in names]
        missing = [field for field in reaction.fields if field not in names]
        if there and missing:
            problem = f"hold {there[0]} but not {missing[0]}, with which it reacts ('{name}')"
            raise SceneError("fields", problem, "Ask for both.")
        if there:
            found[name] = reaction
    return found


def _medium(parameters: FieldParameters, frame: Frame, name: str) -> Schedule:
    """Return the medium over time; a finite one is what the frame says, and stays so."""
    if parameters.nutrient.finite_medium is None:
        return parameters.schedule
    account = None if frame.progress is None else frame.progress.ledger.get(name)
    if account is None or "level" not in account:
        raise SceneError("frame", f"does not say what the finite medium of {name} holds")
    return Schedule.steady(account["level"])


def _taken(system: FieldSystem, scene: Scene, frame: Frame) -> dict[str, FloatArray]:
    """Return the uptake of each cell of the frame's fields from which others are secreted."""
    sources = {x for n in scene.nutrients.values() for x in (n.secretion_from or ())}
    taken: dict[str, FloatArray] = {}
    for name in solving_order(scene.nutrients, scene.reactions):
        if name not in sources:
            continue
        if name not in frame.fields:
            raise SceneError("frame", f"holds no field {name!r}, from which others are made")
        field = system.fields[name]
        field.restore(frame.fields[name], frame.time)
        capacity, _ = system.demand(name, frame.cells, frame.concentrations, taken)
        taken[name] = field.uptake(frame.cells.position, capacity, frame.cells.radius)
    return taken
