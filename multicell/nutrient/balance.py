"""Balance of every molecule of a field and its medium over a whole run."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Final, NamedTuple, final

from multicell.errors import NutrientFailed

if TYPE_CHECKING:
    from multicell.scene.nutrient import Nutrient

SIGNS: Final = {
    "inflow": 1.0,
    "secreted": 1.0,
    "made": 1.0,
    "uptake": -1.0,
    "decayed": -1.0,
    "used": -1.0,
    "outflow": 0.0,
    "washed": 0.0,
}
"""Entries of an account, and what each adds to the content; zero: it is a part of another entry."""

BALANCE_COLUMNS: Final = (*SIGNS, "level")
"""What solvers say of a field: its entries, and the concentration of the medium (mM)."""

_MEDIUM: Final = ("held", "level", "fresh", "discarded", "spoiled", "changes")
_TOTALS: Final = (
    "inflow",
    "outflow",
    "washed",
    "uptake",
    "secreted",
    "decayed",
    "relaid",
    "stored",
    "content",
    "remainder",
    "relative_remainder",
)
_WHERE_ANY: Final = ("made", "used")


FADED: Final = 1e-6
"""Part of the medium's highest concentration below which a field that fades is not followed any
more with an error relative to itself: steps would stay as short as ever down to nothing."""


@final
class FieldExchange(NamedTuple):
    """Exchange of a field, and the cost of finding it.

    Rates (amol/s) of a field at rest, amounts (amol) of one that was brought through some time.

    - ``inflow ... relaid``: see :class:`Ledger`. ``made`` and ``used`` are None for a field that
      takes part in no reaction.
    - ``newton``, ``cg``, ``residual``: of a steady solve: its steps, and the sum of all nodes'
      imbalances (amol/s)
    """

    inflow: float = 0.0
    outflow: float = 0.0
    uptake: float = 0.0
    secreted: float = 0.0
    decayed: float = 0.0
    washed: float = 0.0
    made: float | None = None
    used: float | None = None
    relaid: float = 0.0
    newton: int = 0
    cg: int = 0
    residual: float = 0.0

    def entries(self) -> dict[str, float]:
        """Return the numbers that another one can be made from."""
        found = self._asdict().items()
        return {name: x for name, x in found if x or (x is not None and name in _WHERE_ANY)}


@final
@dataclass
class Ledger:
    """Running totals of one field, amol.

    A steady field stores nothing: what comes in and is secreted is taken up or decays at once.
    A transient one stores the rest. The remainder says how well the account is balanced. It is
    rated by the larger of all that went through and all that was ever there at a time: where
    nothing happens, flows are rounding, and a part of them would say nothing.

    - ``inflow``: over the sides of the grid and, where the field is perfused, from the flow; net
    - ``outflow``: what has left over the sides, part of the above
    - ``washed``: what a perfusion took with it; as much or more it brought, and inflow holds the
      difference
    - ``content``: the most that the field held at the end of any step
    - ``uptake``, ``secreted``, ``decayed``: by the cells; by the cells; by first-order decay
    - ``relaid``: what the grid gained with medium that it came to enclose when it followed the
      tissue
    - ``stored``: what a transient field holds now beyond what it held at the start
    - ``held``, float or None: what the stirred part of a finite medium holds now; None where the
      medium is not finite
    - ``level``, float, mM: its concentration
    - ``fresh``, ``discarded``: what fresh medium brought to it, at the start and at changes, and
      what the old took along
    - ``spoiled``: what decayed in it
    - ``changes``: how many changes of the medium have been done
    - ``made``, ``used``, float or None: gain and loss by reactions with other fields at each place;
      None where there are none
    - ``released``, float or None: at once, as the scene states; None where nothing was
    """

    inflow: float = 0.0
    uptake: float = 0.0
    secreted: float = 0.0
    decayed: float = 0.0
    relaid: float = 0.0
    stored: float = 0.0
    outflow: float = 0.0
    content: float = 0.0
    washed: float = 0.0
    held: float | None = None
    level: float = 0.0
    fresh: float = 0.0
    discarded: float = 0.0
    spoiled: float = 0.0
    changes: float = 0
    made: float | None = None
    used: float | None = None
    released: float | None = None

    def copy(self) -> Ledger:
        """Return the same account, to be continued."""
        made = object.__new__(Ledger)
        made.__dict__.update(self.__dict__)
        return made

    def entries(self) -> dict[str, float]:
        """Return the numbers that another ledger can be made from; no medium that is not finite."""
        return {
            name: value
            for name, value in asdict(self).items()
            if (name not in _MEDIUM or self.held is not None)
            and (name not in (*_WHERE_ANY, "released") or value is not None)
        }

    def note(self, medium: WellMixed | None) -> None:
        """Take over the account of a finite medium, if there is one."""
        if medium is None:
            return
        self.held, self.level = medium.amount, medium.concentration
        self.fresh, self.discarded = medium.fresh, medium.discarded
        self.spoiled, self.changes = medium.decayed, medium.changes

    def add(self, found: FieldExchange, dt: float = 1.0, *, stored: float = 0.0) -> None:
        """Enter rates that held for a time ``dt`` (s), or amounts where it is left out.

        ``relaid`` and ``stored`` are amounts (amol) always.
        """
        own = self.__dict__
        for name in SIGNS:
            value = getattr(found, name)
            if value is not None:
                own[name] = (own[name] or 0.0) + value * dt
        self.relaid += found.relaid
        self.stored += stored

    def release(self, amount: float) -> None:
        """Enter what was released at once, amol."""
        self.released = (self.released or 0.0) + amount
        self.stored += amount

    def fill(self, content: float) -> None:
        """Note the content of the field, amol."""
        self.content = max(self.content, content)

    def _changes(self) -> list[float]:
        """Return the change of the content by each entry, amol."""
        signed = [sign * (getattr(self, name) or 0.0) for name, sign in SIGNS.items()]
        return [*signed, self.relaid, self.released or 0.0]

    @property
    def remainder(self) -> float:
        """Remainder of the balance: inflow and secretion that neither left nor is there, amol."""
        return sum(self._changes()) - self.stored

    @property
    def turnover(self) -> float:
        """The larger of all that was gained and all that was spent, with what passed, amol."""
        changes = self._changes()
        gained, spent = (sum(max(sign * x, 0.0) for x in changes) for sign in (1.0, -1.0))
        return max(gained, spent, abs(self.stored)) + self.outflow + self.washed

    @property
    def relative_remainder(self) -> float:
        """Size of the remainder over the larger of turnover and content; 0 where all is zero."""
        scale = max(self.turnover, self.content)
        found = abs(self.remainder) / scale if scale > 0.0 else 0.0
        if self.held is None or not self.fresh > 0.0:
            return found
        return max(found, abs(self.medium_remainder) / self.fresh)

    @property
    def medium_remainder(self) -> float:
        """Remainder of fresh medium that went nowhere and is not there, amol."""
        gone = self.discarded + self.spoiled + self.inflow + self.relaid
        return self.fresh - gone - (self.held or 0.0)

    def summary(self) -> dict[str, float]:
        """Return totals in amol, and the remainder relative to turnover or content."""
        found = {name: getattr(self, name) for name in _TOTALS}
        if self.released is not None:
            found["released"] = self.released
        if self.made is not None:
            found |= {"made": self.made, "used": self.used or 0.0}
        if self.held is None:
            return found
        return found | {
            "medium_held": self.held,
            "medium_fresh": self.fresh,
            "medium_discarded": self.discarded,
            "medium_decayed": self.spoiled,
            "medium_remainder": self.medium_remainder,
        }


@final
@dataclass(frozen=True)
class WellMixed:
    """The stirred part of a medium, with its account from the start on.

    - ``amount``, float, amol
    - ``volume``, float, µm³
    - ``fresh``, ``discarded``, float, amol: what fresh medium brought, at the start and at changes,
      and what went with the old
    - ``decayed``, float, amol
    - ``changes``, int: how many entries of the schedule have been done
    """

    amount: float
    volume: float
    fresh: float
    discarded: float = 0.0
    decayed: float = 0.0
    changes: int = 0

    @property
    def concentration(self) -> float:
        """Concentration, mM."""
        return self.amount / self.volume

    def changed(self, concentration: float, part: float) -> WellMixed:
        """Return it with a part replaced by fresh medium of a concentration in mM."""
        gone, brought = part * self.amount, part * self.volume * concentration
        return replace(
            self,
            amount=self.amount - gone + brought,
            fresh=self.fresh + brought,
            discarded=self.discarded + gone,
            changes=self.changes + 1,
        )


def volume_beyond_grid(name: str, nutrient: Nutrient, covered: float) -> float:
    """Return the volume of the medium beyond the grid, µm³."""
    assert nutrient.finite_medium is not None
    volume = nutrient.finite_medium.volume
    if not volume > covered:
        raise NutrientFailed(
            f"the finite medium of {name} is {volume:.4g} um^3 in all, but its grid covers "
            f"{covered:.4g} um^3: nothing is left that could be stirred",
            "Give finite_medium a larger volume, or the field a smaller margin",
        )
    return volume - covered
