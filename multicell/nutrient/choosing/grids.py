"""The grids that a run chooses by itself: by a tolerance, or shells as long as they are right."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, final

from multicell.nutrient.grid import ShellLayout
from multicell.scene.coupling import usual_step

if TYPE_CHECKING:
    from multicell.cells import Cells
    from multicell.nutrient.choosing.choice import Choice, Chooser
    from multicell.nutrient.choosing.estimate import Load
    from multicell.nutrient.course import Demand
    from multicell.nutrient.field import NutrientField
    from multicell.nutrient.grid import Layout
    from multicell.nutrient.group import FieldGroup
    from multicell.scene.scene import Scene


@final
class Grids:
    """Owner of what is chosen for the fields of a simulation.

    - ``groups``: names of the fields that share a grid, since they react with each other

    - ``choosers``, name -> Chooser: of the fields with a tolerance
    - ``choices``, name -> Choice: the present ones
    """

    def __init__(self, scene: Scene, groups: Iterable[Sequence[str]]) -> None:
        self._step = usual_step(scene)
        self._tolerance = {name: n.tolerance or 0.0 for name, n in scene.nutrients.items()}
        self.choosers = _choosers(scene, groups)
        self.choices: dict[str, Choice] = {}
        self._changes: dict[str, tuple[float, float]] = {}  # number and time of the last, s
        self._marched: dict[str, float] = {}  # since when a field is not steady any more, s

    def begin(self, fields: FieldGroup, cells: Cells, demand: Demand, time: float) -> None:
        """Choose for the cells at the start.

        Raises SceneError, NutrientFailed see
        :meth:`multicell.nutrient.choosing.choice.Chooser.choose`.
        """
        self._choose(fields, _load(cells, demand, time, time + self._step), None, time)

    def look(
        self, fields: FieldGroup, cells: Cells, demand: Demand, begin: float, end: float
    ) -> None:
        """Choose again for cells at the end of a coupling step, if there is reason to.

        Raises NutrientFailed.
        """
        chooser = self.choosers[fields.names[0]]
        if any(
            chooser.due(self.choices[name], len(cells), field.level(end), field.stored(), end)
            for name, field in fields.fields.items()
        ):
            now = self.choices[fields.names[0]]
            self._choose(fields, _load(cells, demand, begin, end), now, end)
            for name in fields.names:
                if now.steady and not self.choices[name].steady:
                    self._marched[name] = begin

    def _choose(self, fields: FieldGroup, load: Load, now: Choice | None, time: float) -> None:
        each = fields.fields.values()
        levels = [field.level(time) for field in each]
        contents = [0.0 if now is None else field.stored() for field in each]
        chooser = self.choosers[fields.names[0]]
        self.choices |= chooser.choose(fields, load, now, levels, contents)
        for field in each:
            self.apply(field)

    def apply(self, field: NutrientField) -> None:
        """Let a field be what is chosen for it."""
        choice = self.choices.get(field.name)
        if choice is not None:
            field.parameters = choice.applied(field.parameters)

    def note(self, field: NutrientField, before: Layout, time: float) -> None:
        """Note whether a field has gone over from shells to cubes, or back, at a time in s."""
        if isinstance(field.layout, ShellLayout) != isinstance(before, ShellLayout):
            number, _ = self._changes.get(field.name, (0, 0.0))
            self._changes[field.name] = (number + 1, time)

    def remarks(self, field: NutrientField) -> list[str]:
        """Return in words what has become of a field's grid."""
        notes = []
        if field.name in self._changes:
            number, time = self._changes[field.name]
            shells = isinstance(field.layout, ShellLayout)
            ways = "cubes to shells" if shells else "shells to cubes"
            often = "" if number == 1 else f", the last of {number:g} changes"
            why = "round" if shells else "not round"
            if field.name in self.choosers:
                why = f"{'' if shells else 'not '}round enough for its tolerance"
            notes.append(
                f"{field.name} went over from {ways} at {time / 3600.0:.4g} h{often}: "
                f"the tissue is {why}."
            )
        if field.name in self._marched:
            time = self._marched[field.name]
            notes.append(
                f"{field.name} is transient since {time / 3600.0:.4g} h: its steady state would "
                "have been off by more than its tolerance."
            )
        choice, tolerance = self.choices.get(field.name), self._tolerance[field.name]
        if choice is not None and choice.error > tolerance:
            notes.append(
                f"The finest grid of {field.name} has an estimated error of {choice.error:.2g} mM, "
                f"above its tolerance of {tolerance:g} mM."
            )
        return notes

    def rated(self, field: NutrientField) -> dict[str, float | str]:
        """Return what the summary tells of a choice."""
        return {
            "regime": field.parameters.regime,
            "nodes": int(field.field().values.size),
            "tolerance": self._tolerance[field.name],
            "estimated_error": self.choices[field.name].error,
        }

    def columns(self) -> dict[str, float]:
        """Return what the history tells of the present choices."""
        found = {f"spacing_{name}": choice.spacing for name, choice in self.choices.items()}
        return found | {f"grid_error_{name}": x.error for name, x in self.choices.items()}

    def kept(self) -> dict[str, dict[str, float]]:
        """Return all as numbers by field, which :meth:`take` takes back."""
        kept = {name: choice.kept() for name, choice in self.choices.items()}
        for name, (number, time) in self._changes.items():
            kept.setdefault(name, {}).update(changes=number, changed_at=time)
        for name, time in self._marched.items():
            kept[name]["marched_at"] = time
        return kept

    def take(self, kept: Mapping[str, Mapping[str, float]]) -> None:
        """Take back what was kept."""
        self._changes = {
            name: (entry["changes"], entry["changed_at"])
            for name, entry in kept.items()
            if "changes" in entry
        }
        self._marched = {
            name: entry["marched_at"] for name, entry in kept.items() if "marched_at" in entry
        }
        if self.choosers:
            from multicell.nutrient.choosing.choice import Choice

            self.choices = {name: Choice.of(kept[name]) for name in self.choosers}


def _choosers(scene: Scene, groups: Iterable[Sequence[str]]) -> dict[str, Chooser]:
    """Return what chooses for each field with a tolerance; without one, nothing is loaded."""
    chosen = [names for names in groups if scene.nutrients[names[0]].tolerance is not None]
    if not chosen:
        return {}
    from multicell.nutrient.choosing.choice import Chooser

    choosers = [Chooser(scene, *names) for names in chosen]
    return {name: chooser for chooser in choosers for name in chooser.names}


def _load(cells: Cells, demand: Demand, begin: float, end: float) -> Load:
    from multicell.nutrient.choosing.estimate import Load

    return Load(cells.position, cells.radius, demand, begin, end)
