"""Errors of approximate JKR and of its smoothing: a chart
=======================================================

Problem
    Two cells of radius 10 um, E = 1 kPa, Poisson ratio 0.5, surface energy 0.1 nN/um.
    Left: force over overlap for the approximate law (eq. 3.6) and for the exact one with
    both its branches. The exact law has the same pull-off force, a third of the equilibrium
    overlap, and hysteresis. Right: the change of the approximate law by smoothing (linear
    onset below a length) over that length, and the largest stiffness of the smoothed law.
Scaling
    The right panel is relative to h0, the equilibrium overlap of the approximate law, and
    therefore valid for all cells.
Cost
    About two seconds, nearly all of it to load matplotlib.
Command
    .. code-block:: sh

        python examples/exact_jkr.py [FOLDER]

    It writes FOLDER/exact_jkr.png.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from multicell.contact.exact_jkr import ExactJKR
from multicell.contact.jkr import JKR
from multicell.contact.law import effective_modulus, effective_radius
from multicell.report.plots.style import BLUE, INK, QUIET, RED, styled

FloatArray = NDArray[np.float64]
GREEN = "#2a9d6a"


@final
@dataclass(frozen=True)
class Pair:
    """Two like cells: E_ij (kPa), r_ij (um) and surface energy (nN/um)."""

    modulus: float
    radius: float
    surface_energy: float

    @property
    def constants(self) -> tuple[float, float]:
        """Arguments of the laws."""
        return self.modulus, self.radius

    @property
    def approximate(self) -> JKR:
        """Eq. 3.6."""
        return JKR(surface_energy=self.surface_energy)

    @property
    def exact(self) -> ExactJKR:
        """Johnson, Kendall and Roberts 1971."""
        return ExactJKR(surface_energy=self.surface_energy)

    @property
    def h0(self) -> float:
        """Equilibrium overlap of the approximate law, um."""
        return float(self.approximate.equilibrium_overlap(*self.constants))

    @property
    def pull_off(self) -> float:
        """Deepest attraction of both laws, nN, as a positive number."""
        return -float(self.exact.pull_off_force(self.radius))


def setup(
    radius: float = 10.0, young: float = 1.0, poisson: float = 0.5, surface_energy: float = 0.1
) -> Pair:
    """Return the pair of two cells of a radius (um), Young's modulus (kPa) and Poisson ratio."""
    modulus = float(effective_modulus(young, poisson, young, poisson))
    return Pair(modulus, float(effective_radius(radius, radius)), surface_energy)


def smoothing_errors(pair: Pair, lengths: FloatArray) -> dict[str, FloatArray]:
    """Return the relative changes by a smoothing of given lengths (um), and the largest stiffness.

    ``force`` is the largest change of the force over the pull-off force, ``depth`` the change of
    the deepest attraction, ``binding`` that of the energy at the plain law's equilibrium,
    ``overlap`` that of the equilibrium overlap, and ``stiffness`` the steepest descent of the
    force in units of pull-off force / h0. The first four are at least zero.
    """
    plain, h0 = pair.approximate, pair.h0
    result = {name: [] for name in ("force", "depth", "binding", "overlap", "stiffness")}
    for length in lengths:
        law = JKR(surface_energy=pair.surface_energy, smoothing=float(length))
        h = np.concatenate([np.linspace(0, 1, 2001)[1:] * length, np.linspace(0, 1.2, 4001) * h0])
        force = law.force(h, *pair.constants)
        change = np.abs(force - plain.force(h, *pair.constants))
        result["force"].append(change.max() / pair.pull_off)
        # up to 2^(-4/3) h0 the deepest point is not smoothed: no change at all
        deep = length <= h0 / 2.0 ** (4.0 / 3.0)
        result["depth"].append(0.0 if deep else 1.0 + force.min() / pair.pull_off)
        energies = [float(one.energy(h0, *pair.constants)) for one in (law, plain)]
        result["binding"].append(1.0 - energies[0] / energies[1])
        result["overlap"].append(1.0 - float(law.equilibrium_overlap(*pair.constants)) / h0)
        first = float(law.stiffness(1e-12 * length, *pair.constants))
        result["stiffness"].append(-first * h0 / pair.pull_off)
    return {name: np.array(values) for name, values in result.items()}


@styled
def draw(pair: Pair) -> Figure:
    """Return the figure."""
    figure = Figure(figsize=(15.0, 8.0), dpi=110)
    figure.text(0.045, 0.95, "What the approximate JKR law costs", fontsize=16, weight="bold")
    figure.text(
        0.045,
        0.912,
        f"Two cells of radius {2 * pair.radius:g} µm, surface energy "
        f"{pair.surface_energy:g} nN/µm. Below zero overlap a neck holds the cells together.",
        color=QUIET,
    )
    _laws(figure.add_axes((0.05, 0.085, 0.5, 0.74)), pair)
    lengths = np.logspace(-3.0, np.log10(2.0), 120) * pair.h0
    errors = smoothing_errors(pair, lengths)
    _errors(figure.add_axes((0.635, 0.45, 0.34, 0.375)), lengths / pair.h0, errors)
    _stiffness(figure.add_axes((0.635, 0.085, 0.34, 0.25)), lengths / pair.h0, errors)
    return figure


def _laws(axes: Any, pair: Pair) -> None:
    """Draw force over overlap for both laws, with both branches of the exact one."""
    exact, h0, scale = pair.exact, pair.h0, pair.pull_off
    broken = float(exact.breaking_overlap(*pair.constants))
    turning = float(exact.contact_radius(broken, *pair.constants, touching=True))
    overlap, force = exact.curve(np.linspace(0.0, turning, 400), *pair.constants)
    axes.plot(overlap, force, color=RED, lw=1.6, ls=(0, (4, 2)), label="exact, unstable branch")
    stable = turning + np.linspace(0.0, 1.0, 800) ** 2 * 5.0 * turning
    overlap, force = exact.curve(stable, *pair.constants)
    axes.plot(overlap, force, color=RED, lw=2.4, label="exact JKR, stable branch")
    h = h0 * np.linspace(0.0, 1.0, 1200) ** 2 * 1.55
    axes.plot(
        h,
        pair.approximate.force(h, *pair.constants),
        color=BLUE,
        lw=2.4,
        label="approximate JKR (eq. 3.6)",
    )
    axes.plot([-0.66 * h0, 0.0], [0.0, 0.0], color=RED, lw=2.4)
    first, last = float(exact.first_contact_force(pair.radius)), 5.0 / 9.0 * -scale
    for x, start, end in ((0.0, 0.0, first), (broken, last, 0.0)):
        arrow = {
            "arrowstyle": "-|>",
            "color": RED,
            "lw": 1.4,
            "ls": ":",
            "shrinkA": 0,
            "shrinkB": 0,
        }
        axes.annotate("", (x, end), (x, start), arrowprops=arrow)
    _marks(axes, pair, broken, last)
    axes.axhline(0.0, color="#9aa7b1", lw=0.8, zorder=0)
    axes.axhline(-scale, color="#9aa7b1", lw=0.8, ls="--", zorder=0)
    axes.text(1.53 * h0, -scale * 1.03, "pull-off  −(3/2) π σ r", ha="right", va="top", color=QUIET)
    axes.set(xlim=(-0.66 * h0, 1.55 * h0), ylim=(-1.22 * scale, 1.2 * scale))
    axes.set(xlabel="overlap (µm)", ylabel="force (nN), repulsion positive")
    axes.set_title("Force over overlap")
    axes.legend(loc="upper left", reverse=True)


def _marks(axes: Any, pair: Pair, broken: float, last: float) -> None:
    """Mark equilibria, first contact and breaking."""
    h0, scale = pair.h0, pair.pull_off
    rest = float(pair.exact.equilibrium_overlap(*pair.constants))
    deepest = float(pair.exact.pull_off_overlap(*pair.constants))
    for x, y, colour in (
        (rest, 0.0, RED),
        (h0, 0.0, BLUE),
        (deepest, -scale, RED),
        (h0 / 2.0 ** (4.0 / 3.0), -scale, BLUE),
        (0.0, -8.0 / 9.0 * scale, RED),
        (broken, last, RED),
    ):
        axes.plot(x, y, "o", color=colour, markersize=7, markeredgecolor="white", zorder=5)
    notes = [
        (f"rest: h₀/3 = {rest:.2f} µm", rest, 0.0, (14, -20), RED, "left"),
        (f"rest: h₀ = {h0:.2f} µm", h0, 0.0, (10, -20), BLUE, "left"),
        ("contact forms: jumps\nto 8/9 of pull-off", 0.0, 0.0, (-6, 24), RED, "right"),
        ("breaks: from\n5/9 of pull-off", broken, -0.28 * scale, (-8, 0), RED, "right"),
    ]
    for words, x, y, offset, colour, side in notes:
        axes.annotate(
            words, (x, y), offset, textcoords="offset points", color=colour, ha=side, va="center"
        )


def _errors(axes: Any, lengths: FloatArray, errors: dict[str, FloatArray]) -> None:
    """Draw the model error of the smoothing."""
    curves = [
        ("force", "largest change of force / pull-off", INK),
        ("binding", "binding energy", GREEN),
        ("depth", "pull-off force", RED),
        ("overlap", "equilibrium overlap", BLUE),
    ]
    for name, label, colour in curves:
        shown = np.where(errors[name] > 0.0, errors[name], np.nan)
        axes.loglog(lengths, shown, color=colour, lw=2.2, label=label)
    axes.set(xlim=(lengths[0], lengths[-1]), ylim=(1e-6, 1.5))
    axes.set_title("Relative model error of the smoothing")
    axes.legend(loc="upper left", fontsize=10, handlelength=1.4, borderaxespad=0.2)


def _stiffness(axes: Any, lengths: FloatArray, errors: dict[str, FloatArray]) -> None:
    """Draw the largest stiffness that the smoothing leaves."""
    axes.loglog(lengths, errors["stiffness"], color=INK, lw=2.2)
    axes.set(xlim=(lengths[0], lengths[-1]), xlabel="smoothing length / h₀")
    axes.set_title("Steepest descent of the force × h₀ / pull-off")
    axes.set(ylim=(3.0, 40.0), yticks=[5, 10, 20, 40], yticklabels=["5", "10", "20", "40"])
    axes.minorticks_off()
    where = {"transform": axes.transAxes, "ha": "right", "va": "top", "color": QUIET}
    axes.text(0.97, 0.9, "without smoothing: unbounded", **where)


def main(output: str | Path) -> dict[str, float]:
    """Draw the figure; return the numbers that it marks (um, nN)."""
    pair, folder = setup(), Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    draw(pair).savefig(folder / "exact_jkr.png")
    exact = pair.exact
    return {
        "equilibrium overlap, eq. 3.6 (um)": pair.h0,
        "equilibrium overlap, exact (um)": float(exact.equilibrium_overlap(*pair.constants)),
        "breaking overlap, exact (um)": float(exact.breaking_overlap(*pair.constants)),
        "pull-off force, both (nN)": -pair.pull_off,
        "force at first contact, exact (nN)": float(exact.first_contact_force(pair.radius)),
        "force at breaking, exact (nN)": float(exact.breaking_force(pair.radius)),
    }


if __name__ == "__main__":
    for label, value in main(*(sys.argv[1:2] or ["out/exact_jkr"])).items():
        print(f"{label:36s} {value:9.4f}")
