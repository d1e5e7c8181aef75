"""What a division costs CVODE, and what it leaves behind, if its daughters part smoothly.

Problem: 200 JKR cells (division radius 5 µm, E 1 kPa, σ 0.1 nN/µm, ν ½, 5 kPa s), radii as in a
population of all ages, settle for ten days; the one nearest the middle has the division radius
and divides, nothing else grows or divides. Ways to divide:

``inside``   two daughters of radius ρ = 2^(-1/3) r at ± (r - ρ), the spherical shock;
``parting``  the same, with a slack of the overlap at birth less that at rest, which falls
             linearly to zero over M.

For each tolerance: steps, evaluations and Jacobian products beyond those of the same time
without a division, in all and of the dearest coupling step; then what the end (``--rest`` after
M, so that all have come to rest) differs by from ``inside``: root mean square distance of the
other 199 cells and of the farthest, of the daughters, radius of gyration and contact energy.
Cost: a few seconds on one core for each tolerance.
Command: python tests/benchmarks/compare_division.py [--atol 0.01,0.001] [--cells 200]
    [--coupling 600] [--phase 3600] [--rest 172800] [--viscosity 5] [--axes 5]
    [--surface-energy 0.1] [--spacing 0.86] | [--scene]

Found (means of five axes, steps beyond a run without a division, ``inside`` / ``parting``):

=========================================  =========  ===========  ===========  ===========
atol in µm                                 0.1        0.01         0.001        0.0001
=========================================  =========  ===========  ===========  ===========
200 cells, as above                        5.0 / 4.2  19.0 / 21.8  49.8 / 59.8  118 / 136
200 cells, 0.05 kPa s                      26 / 39    41 / 94      103 / 258    194 / 436
200 cells, coupling step 1 h               16 / 18    41 / 36      91 / 72      175 / 159
200 cells, σ 0.001 nN/µm (spacing 0.93)    5.0 / 0.0  11.6 / 5.0   35.2 / 29.6
division-shock to 130 min, all steps       38 / 42     47 / 52      66 / 94      100 / 147
the mother alone                           9.0 / 2.0  17.4 / 8.0   29.0 / 20.0  47.8 / 41.0
the mother alone, 0.05 kPa s               19 / 4.0   35.4 / 6.0   46.0 / 11.2  70.8 / 22.8
=========================================  =========  ===========  ===========  ===========

Smooth parting saves a factor of 3 to 6 only where the sisters' own shock is all there is and is
over long before M ends (1.2 to 4.5 at 5 kPa s). In a cluster at rest it saves none.
Part of the shock is that the neighbours
lose the mother's flanks, which no slack between the sisters softens; and a shock that decays
takes steps as the logarithm of time, where cells that are pushed about for an hour take some at
each of six restarts. Even the sisters alone take more (8 steps at 0.01 µm) than a third of what
the shock costs in the cluster (19). Fewer steps go into the dearest coupling step (10 for 12
at 0.01 µm, 5 for 13 with σ 0.001). The ends differ by which pocket a few cells settle in: the
others by 0.14 µm (rms, median of the axes; 0.002 where they find the same pocket), the radius of
gyration by 1e-4, the contact energy by up to 4e-4 of itself.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from strategies import cluster

from multicell import JKR, load_scene
from multicell.comparison.record import record
from multicell.comparison.replay import replay
from multicell.contact.law import effective_modulus, effective_radius
from multicell.integrators.cvode import Cvode
from multicell.mechanics.motion import Motion
from multicell.mechanics.system import Mechanics

HALF = 0.5 ** (1.0 / 3.0)
MODULUS = effective_modulus(1.0, 0.5, 1.0, 0.5)
COUNTS = ("steps", "evaluations", "jacobian_products")
WAYS = ("inside", "parting")


@dataclass(frozen=True)
class Division:
    """How far apart daughters begin, their radius, and over M their slack if they part, µm."""

    begin: float
    radius: float
    slack: np.ndarray | None

    @classmethod
    def of(cls, law: JKR, way: str, mother: float, times: np.ndarray) -> Division:
        """Return a division of a mother of radius ``mother`` with M from 0 to 1 in ``times``."""
        daughter = HALF * mother
        inside = 2.0 * (mother - daughter)
        slack = (2.0 * daughter - rest_overlap(law, daughter) - inside) * (1.0 - times)
        return cls(inside, daughter, slack if way == "parting" else None)


def rest_overlap(law, radius):
    """Return the overlap at rest of two cells of one radius, µm."""
    return law.equilibrium_overlap(MODULUS, effective_radius(radius, radius))


def settled(setting, tight):
    """Return centres and radii of cells at rest, and which one is to divide."""
    position, _, _ = cluster(setting.cells, 3, spacing=setting.spacing, variation=0.0)
    radius = (
        5.0 * HALF * (1.0 + np.random.default_rng(3).uniform(size=setting.cells)) ** (1.0 / 3.0)
    )
    middle = int(np.linalg.norm(position - position.mean(axis=0), axis=1).argmin())
    radius[middle] = 5.0
    for _ in range(10):
        still = motion(radius, 0.0 * radius, 0.0, 86400.0)
        position = moved(position, still, tight, setting.law, 5.0)[0]
    return position, radius, middle


def motion(radius, rate, begin, end, offset=None, offset_rate=0.0):
    n = len(radius)
    made = Motion(radius, rate, np.ones(n), np.full(n, 0.5), begin, end)
    if offset is None:
        return made
    pair = np.array([[n - 2, n - 1]])
    return replace(made, offset_pairs=pair, offset=np.array([[offset, offset_rate]]))


def moved(position, motion, method, law, viscosity):
    """Return where the cells are after a coupling step, and the mechanics."""
    system = Mechanics(law, viscosity)
    system.begin(motion)
    outcome = method.integrate(system, position)
    if not outcome.done:
        raise SystemExit(f"{outcome.problem} (t = {outcome.time:g} s)")
    return outcome.position, system


def run(cells, division, setting, method):
    """Return final positions, counts of each coupling step of M and its half after, and energy."""
    position, radius = cells
    coupling = setting.coupling
    steps = round(setting.phase / coupling)
    counts = []
    slack = None if division is None else division.slack
    for k in range(steps + max(steps // 2, 6)):
        extra = ()
        if slack is not None and k < steps:
            extra = (slack[k], (slack[k + 1] - slack[k]) / coupling)
        step = motion(radius, 0.0 * radius, k * coupling, (k + 1) * coupling, *extra)
        position, system = moved(position, step, method, setting.law, setting.viscosity)
        counts.append([getattr(system.work, name) for name in COUNTS])
    tight = Cvode(rtol=1e-8, atol=1e-5)
    still = motion(radius, 0.0 * radius, 0.0, setting.rest)
    position, system = moved(position, still, tight, setting.law, 5.0)
    return position, np.array(counts), system.energy(setting.rest, position)


def divided(start, axis, division):
    """Return the cells with two daughters, at the end, in place of the mother."""
    position, radius, middle = start
    keep = np.arange(len(radius)) != middle
    offset = 0.5 * division.begin * axis
    daughters = [position[middle] - offset, position[middle] + offset]
    centres = np.concatenate([position[keep], daughters])
    return centres, np.append(radius[keep], [division.radius] * 2)


def shock(cells, division, setting):
    """Return the largest pressure of a daughter at birth, kPa, and Euler's largest step, s."""
    position, radius = cells
    extra = () if division.slack is None else (division.slack[0], 0.0)
    system = Mechanics(setting.law, setting.viscosity)
    system.begin(motion(radius, 0.0 * radius, 0.0, 1.0, *extra))
    bound = system.stiffness_bound(0.0, position)
    return system.pressure(0.0, position)[-2:].max(), 2.0 / bound


def compare(atol, setting, start, axes):
    method = Cvode(rtol=1e-6, atol=atol)
    _, base, _ = run(start[:2], None, setting, method)
    print(f"\natol {atol:g} µm; without a division {base.sum(axis=0).tolist()} {', '.join(COUNTS)}")
    times = np.linspace(0.0, 1.0, round(setting.phase / setting.coupling) + 1)
    ends, excess = {}, {}
    for way in WAYS:
        division = Division.of(setting.law, way, start[1][start[2]], times)
        rows = []
        for k, axis in enumerate(axes):
            found, counts, energy = run(divided(start, axis, division), division, setting, method)
            ends[way, k] = found, energy
            rows.append([*(counts - base).sum(axis=0), counts[:, 0].max()])
        mean = excess[way] = np.mean(rows, axis=0)
        with np.errstate(all="ignore"):
            ratio = excess["inside"][:3] / mean[:3]
        print(
            f"{way:9s} beyond: {mean[0]:6.1f} steps {mean[1]:6.1f} evaluations "
            f"{mean[2]:6.1f} products; dearest coupling step {mean[3]:5.1f} steps; "
            f"inside costs {ratio[0]:.2f}, {ratio[1]:.2f}, {ratio[2]:.2f} times that"
        )
    report("parting", ends, len(axes))


def report(way, ends, axes):
    """Print what the ends of a way differ by from those of ``inside``; daughters may swap."""
    rows = []
    for k in range(axes):
        (found, energy), (other, known) = ends[way, k], ends["inside", k]
        apart = np.linalg.norm(found - other, axis=1)
        swapped = np.linalg.norm(found[-2:] - other[:-3:-1], axis=1)
        others = apart[:-2] if len(apart) > 2 else np.zeros(1)
        rows.append(
            [
                math.sqrt(float((others**2).mean())), others.max(),
                min(apart[-2:].max(), swapped.max()),
                gyration(found) / gyration(other) - 1.0, energy / known - 1.0,
            ]
        )  # fmt: skip
    for name, row in (("median", np.median(rows, axis=0)), ("largest", np.abs(rows).max(axis=0))):
        print(
            f"{way:9s} ends ({name}): others apart {row[0]:.2g} (rms) {row[1]:.2g} (max), "
            f"daughters {row[2]:.2g} µm, gyration {row[3]:+.1e}, energy {row[4]:+.1e}"
        )


def built_in(atol):
    """Print the steps after the division of ``division-shock``, instant and with slack over 1 h."""
    scene = load_scene("division-shock").with_changes({"duration": "130 min"})
    problem, _ = record(scene, Cvode(rtol=1e-6, atol=1e-5), threads=1)
    first = next(k for k, step in enumerate(problem.steps) if step.before is not None)
    daughters = problem.steps[first].before.offset[-2:]
    motion = problem.steps[first].motion
    radius, young = motion.radius[-2:], motion.young[-2:]
    rest = problem.template.law.equilibrium_overlap(
        effective_modulus(young[0], 0.5, young[1], 0.5), effective_radius(*radius)
    )
    slack = radius.sum() - np.linalg.norm(daughters[1] - daughters[0]) - rest
    parting = list(problem.steps)
    pair = np.array([[len(motion.radius) - 2, len(motion.radius) - 1]])
    for k in range(6):
        now = np.array([[slack * (1.0 - k / 6.0), -slack / 3600.0]])
        step = parting[first + k]
        parting[first + k] = replace(
            step, motion=replace(step.motion, offset_pairs=pair, offset=now)
        )
    method, counts, ends = Cvode(rtol=1e-6, atol=atol), [], []
    for steps in (problem.steps, parting):
        early = replay(replace(problem, steps=steps[:first]), method)
        found = replay(replace(problem, steps=steps), method)
        counts.append(found.work.steps - early.work.steps)
        ends.append(found.positions[-1])
    apart = math.sqrt(float(((ends[1] - ends[0])[:-2] ** 2).sum(axis=1).mean()))
    print(
        f"division-shock, atol {atol:g} µm: {counts[0]} and {counts[1]} steps after the division "
        f"in {len(parting) - first} coupling steps; others apart at the end {apart:.2g} µm (rms)"
    )


def gyration(position):
    return math.sqrt(float(((position - position.mean(axis=0)) ** 2).sum(axis=1).mean()))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--atol", default="0.1,0.01,0.001,0.0001")
    parser.add_argument("--cells", type=int, default=200, help="1: the mother alone")
    parser.add_argument("--coupling", type=float, default=600.0, help="s")
    parser.add_argument("--phase", type=float, default=3600.0, help="M, s")
    parser.add_argument("--rest", type=float, default=172800.0, help="s")
    parser.add_argument("--viscosity", type=float, default=5.0, help="kPa s")
    parser.add_argument("--axes", type=int, default=5)
    parser.add_argument("--surface-energy", type=float, default=0.1, help="nN/µm")
    parser.add_argument("--scene", action="store_true", help="division-shock itself instead")
    parser.add_argument("--spacing", type=float, default=0.86, help="at the start, in diameters")
    setting = parser.parse_args()
    if setting.scene:
        for atol in map(float, setting.atol.split(",")):
            built_in(atol)
        return
    setting.law = JKR(surface_energy=setting.surface_energy)
    start = settled(setting, Cvode(rtol=1e-8, atol=1e-5))
    axes = np.random.default_rng(0).normal(size=(setting.axes, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    print(
        f"{setting.cells} cells, coupling step {setting.coupling:g} s, M {setting.phase:g} s, "
        f"{setting.viscosity:g} kPa s"
    )
    for way in WAYS:
        division = Division.of(setting.law, way, start[1][start[2]], np.linspace(0.0, 1.0, 7))
        pressure, step = shock(divided(start, axes[0], division), division, setting)
        print(f"{way:9s} at birth: pressure {pressure:.3g} kPa, Euler stable to {step:.3g} s")
    for atol in map(float, setting.atol.split(",")):
        compare(atol, setting, start, axes)


if __name__ == "__main__":
    main()
