"""Where every molecule of a field came from and went to, over a whole run."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final, final

if TYPE_CHECKING:
    from multicell.nutrient.medium import WellMixed

_MEDIUM: Final = ("held", "level", "fresh", "discarded", "spoiled", "changes")


FADED = 1e-6
"""Part of the medium's highest concentration below which a field that fades is not followed any
more with an error relative to itself: steps would stay as short as ever down to nothing."""


@final
@dataclass(frozen=True)
class FieldReport:
    """What a steady solve took and how well it balances; rates in amol/s.

    ``inflow + produced - uptake - decayed`` is zero up to ``residual``. ``inflow`` includes what a
    perfusion brings and is net; ``outflow`` is what leaves through the faces, ``washed`` what a
    perfusion takes. A field that takes part in reactions gains ``made`` besides and loses ``used``;
    for others these are None.
    """

    newton: int
    cg: int
    residual: float
    inflow: float
    uptake: float
    produced: float
    decayed: float
    outflow: float = 0.0
    washed: float = 0.0
    made: float | None = None
    used: float | None = None

    def kept(self) -> dict[str, float]:
        """Return what another report can be made from."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@final
@dataclass
class Ledger:
    """Running totals of one field, amol.

    A steady field stores nothing: what comes in and is secreted is taken up or decays at once.
    A transient one stores the rest. The remainder says how well the account is balanced. It is
    rated by the larger of all that went through and all that was ever there at a time: where
    nothing happens, flows are rounding, and a part of them would say nothing.

    Attributes
    ----------
    inflow
        Over the sides of the grid and, where the field is perfused, from the flow; net.
    outflow
        What has left a steady field over its sides, part of the above.
    washed
        What a perfusion took with it; as much or more it brought, and inflow holds the difference.
    content
        The most that the field held at the end of any step.
    uptake, secreted, decayed
        By the cells; by the cells; by first-order decay.
    relaid
        What the grid gained with medium that it came to enclose when it followed the tissue.
    stored
        What a transient field holds now beyond what it held at the start.
    held : float or None
        What the stirred part of a finite medium holds now; None where the medium is not finite.
    level : float, mM
        Its concentration.
    fresh, discarded
        What fresh medium brought to it, at the start and at changes, and what the old took along.
    spoiled
        What decayed in it.
    changes
        How many changes of the medium have been done.
    injected : float or None
        By points and planes; None where there are none.
    made, used : float or None
        By reactions with other fields, what they make of it and take from it at each place; None
        where there are none.
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
    injected: float | None = None
    made: float | None = None
    used: float | None = None

    def kept(self) -> dict[str, float]:
        """Return what another ledger can be made from; without a medium that is not finite."""
        return {
            name: value
            for name, value in asdict(self).items()
            if (name not in _MEDIUM or self.held is not None)
            and (name not in ("injected", "made", "used") or value is not None)
        }

    def copy(self) -> Ledger:
        """Return an account of its own with the same totals."""
        other = object.__new__(Ledger)
        other.__dict__.update(self.__dict__)
        return other

    def note(self, medium: WellMixed) -> None:
        """Take over the account of a finite medium."""
        self.held, self.level = medium.amount, medium.concentration
        self.fresh, self.discarded = medium.fresh, medium.discarded
        self.spoiled, self.changes = medium.decayed, medium.changes

    def add(
        self,
        inflow: float,
        uptake: float,
        dt: float = 1.0,
        *,
        secreted: float = 0.0,
        decayed: float = 0.0,
        outflow: float = 0.0,
        relaid: float = 0.0,
        stored: float = 0.0,
        content: float = 0.0,
        washed: float = 0.0,
        injected: float = 0.0,
        made: float | None = None,
        used: float | None = None,
    ) -> None:
        """Add rates (amol/s) that held for a time ``dt`` (s), or amounts where it is left out.

        ``relaid`` and ``stored`` are amounts always, and so is ``content``, what the field holds.
        """
        self.inflow += inflow * dt
        self.uptake += uptake * dt
        self.secreted += secreted * dt
        self.decayed += decayed * dt
        self.outflow += outflow * dt
        self.washed += washed * dt
        if injected:
            self.injected = (self.injected or 0.0) + injected * dt
        if made is not None and used is not None:
            self.made = (self.made or 0.0) + made * dt
            self.used = (self.used or 0.0) + used * dt
        self.relaid += relaid
        self.stored += stored
        self.content = max(self.content, content)

    @property
    def remainder(self) -> float:
        """What came in and was secreted but neither left nor is there, amol."""
        gained = self.inflow + self.secreted + self.relaid + (self.injected or 0.0)
        gained += (self.made or 0.0) - (self.used or 0.0)
        return gained - self.uptake - self.decayed - self.stored

    @property
    def turnover(self) -> float:
        """The larger of all that was gained and all that was spent, with what passed, amol."""
        gained = max(self.inflow, 0.0) + self.secreted + max(self.relaid, 0.0)
        gained += (self.injected or 0.0) + (self.made or 0.0)
        spent = self.uptake + self.decayed + max(-self.inflow, 0.0) + max(-self.relaid, 0.0)
        spent += self.used or 0.0
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
        """What fresh medium brought that went nowhere and is not there, amol."""
        gone = self.discarded + self.spoiled + self.inflow + self.relaid
        return self.fresh - gone - (self.held or 0.0)

    def summary(self) -> dict[str, float]:
        """Return totals in amol, and the remainder relative to turnover or content."""
        return {
            "inflow": self.inflow,
            "outflow": self.outflow,
            "washed": self.washed,
            "uptake": self.uptake,
            "secreted": self.secreted,
            "decayed": self.decayed,
            "relaid": self.relaid,
            "stored": self.stored,
            "content": self.content,
            "remainder": self.remainder,
            "relative_remainder": self.relative_remainder,
            **({} if self.injected is None else {"injected": self.injected}),
            **({} if self.made is None else {"made": self.made, "used": self.used or 0.0}),
            **self._medium(),
        }

    def _medium(self) -> dict[str, float]:
        """Return the account of a finite medium, amol."""
        if self.held is None:
            return {}
        return {
            "medium_held": self.held,
            "medium_fresh": self.fresh,
            "medium_discarded": self.discarded,
            "medium_decayed": self.spoiled,
            "medium_remainder": self.medium_remainder,
        }
