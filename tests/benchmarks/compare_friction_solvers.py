"""Γ(x) ẋ = F by CVODE with Γ⁻¹F in every right-hand side, or by IDA's implicit residual?

Problem: a jittered, compressed ball of 1000 JKR cells (radius 5 µm, E 1 kPa, σ 0.1 nN/µm)
settles; friction between cells γ_n = γ_t = 0.1 nN s/µm³ and Stokes drag of 5 or of 0.05 kPa s.
A reference by CVODE at tight tolerance gives the error, the root mean square over the cells
of the distance to it. Each row is a warm-up and the shortest of three runs.
Cost: about a minute on one core. The times leave out setting up the problem.
Command: python tests/benchmarks/compare_friction_solvers.py [--quick]

Ways: ``cvode`` solves Γ v = F by conjugate gradients in every right-hand side; its
Jacobian product Γ⁻¹(K v - (dΓ·v) ẋ) is exact or "frozen" (without dΓ), with the relative
tolerance that is named, and its preconditioner is made of the diagonal blocks of
Γ - γK, or of 6πηr - γK ("Stokes blocks"). ``ida`` is the residual Γẋ - F with GMRES and the
blocks of cj Γ - K, exact or frozen likewise.
docs/theory/motion.md has what was found.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from sksundae.cvode import CVODE, CVODEJacTimes, CVODEPrecond
from sksundae.ida import IDA, IDAJacTimes, IDAPrecond

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from strategies import cluster, divided, mechanics

from multicell.mechanics import blocks as kernels
from multicell.mechanics import neighbours
from multicell.mechanics.friction import FrictionMatrix


@njit
def derivative(rows, first, second, start, inner_end, outer_end, coefficient, rate, u, out):
    """Subtract (dΓ/dx · u) ẋ for γ_n = γ_t: only the contact area π r_ij h depends on x."""
    for c in range(start.size):
        for p in range(start[c], outer_end[c]):
            i, j = first[p], second[p]
            dx, dy, dz = rows[j, 0] - rows[i, 0], rows[j, 1] - rows[i, 1], rows[j, 2] - rows[i, 2]
            d = math.sqrt(dx * dx + dy * dy + dz * dz)
            total = rows[i, 3] + rows[j, 3]
            if d < total:
                approach = dx * (u[i, 0] - u[j, 0])
                approach += dy * (u[i, 1] - u[j, 1]) + dz * (u[i, 2] - u[j, 2])
                w = coefficient * math.pi * rows[i, 3] * rows[j, 3] / total * approach / d
                for k in range(3):
                    f = w * (rate[i, k] - rate[j, k])
                    out[i, k] -= f
                    if p < inner_end[c]:
                        out[j, k] += f


def add_blocks(matrix, out):
    """Add the 3 x 3 diagonal blocks of Γ to ``out``, (n, 6): xx, yy, zz, xy, xz, yz."""
    gamma = matrix._measured()
    out[:, :3] += gamma.stokes[:, None]
    axes = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    for start, (inner, outer) in zip(gamma.start, gamma.ends, strict=True):
        for side, end in ((0, outer), (1, inner)):
            cells, link = gamma.near[start:end, side], gamma.link[start:end]
            for k, (a, b) in enumerate(axes):
                entry = link[:, 0] * (a == b)
                if gamma.sign != 0.0:
                    entry = entry + gamma.sign * link[:, 1 + a] * link[:, 1 + b]
                np.add.at(out[:, k], cells, entry)


@dataclass
class Problem:
    """Cells, their friction, and the counts of one integration."""

    viscosity: float
    duration: float
    coefficient: float = 0.1
    n: int = 1000
    divided: int = 0
    counts: dict[str, int] = field(default_factory=dict)

    def begin(self) -> None:
        cells = cluster(self.n - self.divided, 1, spacing=0.8)
        mothers = np.random.default_rng(3).choice(len(cells[1]), self.divided, replace=False)
        position, radius, young = divided(*cells, mothers, 3)
        order = neighbours.spatial_order(position, 10.0)
        self.position, radius, young = position[order], radius[order], young[order]
        self.system = mechanics(radius, young, duration=self.duration, viscosity=self.viscosity)
        self.stokes = self.system.drag * radius[:, None]
        size = self.n, self.system.drag, self.system.chunk
        self.gamma, self.linear = (
            FrictionMatrix((self.coefficient, self.coefficient), *size) for _ in range(2)
        )
        self.velocity = np.zeros((self.n, 3))
        self.guess = np.empty((self.n, 3))
        self.inverse = np.empty((self.n, 6))
        self.counts = dict.fromkeys(("rhs", "products", "setups", "solves", "cg", "steps"), 0)

    def force(self, t: float, y: np.ndarray) -> np.ndarray:
        self.counts["rhs"] += 1
        out = np.empty((self.n, 3))
        self.system.velocity(t, y.reshape(-1, 3), out)
        self.gamma.measure(self.system._rows, self.system.neighbours.pairs)
        out *= self.stokes
        return out

    def linearise(self, t: float, y: np.ndarray, yp: np.ndarray) -> None:
        self.system.linearise(t, y.reshape(-1, 3))
        self.linear.measure(self.system._rows, self.system.neighbours.pairs)
        self.rows, self.rate = self.system._rows.copy(), yp.reshape(-1, 3).copy()

    def stiffness(self, v: np.ndarray, exact: bool) -> np.ndarray:
        """Return K v - (dΓ·v) ẋ."""
        self.counts["products"] += 1
        out = np.empty((self.n, 3))
        self.system.jacobian_product(v.reshape(-1, 3), out)
        out *= self.stokes
        if exact:
            pairs = self.system.neighbours.pairs
            derivative(
                self.rows, pairs.first, pairs.second, pairs.start, pairs.inner_end,
                pairs.outer_end, self.coefficient, self.rate, v.reshape(-1, 3), out,
            )  # fmt: skip
        return out

    def blocks(self, mass: float, stiff: float, friction: bool = True) -> None:
        """Invert mass Γ + stiff K, blocks of the diagonal, over the Stokes drag."""
        self.counts["setups"] += 1
        self.system._fill_blocks(self.system._linear)
        total = np.zeros((self.n, 6))
        if friction:
            add_blocks(self.linear, total)
        else:
            total[:, :3] += self.stokes
        total = mass * total + stiff * self.system._blocks
        total[:, :3] -= self.stokes
        kernels.invert_blocks(self.system._rows, total, 1.0, self.system.drag, self.inverse)

    def apply_blocks(self, r: np.ndarray, out: np.ndarray) -> None:
        self.counts["solves"] += 1
        kernels.apply_blocks(self.inverse, r / self.stokes, out)


def cvode(problem, rtol, atol, *, exact=True, inner=1e-3, outer=1e-8, precond="blocks", krylov=5):
    p = problem

    def rhs(t, y, yp):
        p.counts["cg"] += p.gamma.solve(p.force(t, y), p.velocity, outer)
        yp[:] = p.velocity.ravel()

    def product(t, y, yp, v, jv):
        p.counts["cg"] += p.linear.solve(p.stiffness(v, exact), p.guess, inner, warm=False)
        jv[:] = p.guess.ravel()

    def setup(t, y, yp, jok, jnew, gamma):
        p.linearise(t, y, yp)
        p.blocks(1.0, gamma, precond != "stokes")
        if precond == "blocks":
            p.own = np.zeros((p.n, 6))
            add_blocks(p.linear, p.own)
        jnew[0] = 1

    def solve(t, y, yp, r, z, gamma, delta, lr):
        w = np.empty((p.n, 3))
        if precond == "stokes":
            w = p.stokes * r.reshape(-1, 3)
        elif precond == "blocks":
            kernels.apply_blocks(p.own, r.reshape(-1, 3), w)
        else:
            p.linear.apply(r.reshape(-1, 3).copy(), w)
        p.apply_blocks(w, z.reshape(-1, 3))

    solver = CVODE(
        rhs, method="BDF", rtol=rtol, atol=atol, linsolver="gmres", krylov_dim=krylov,
        jactimes=CVODEJacTimes(p.linearise, product),
        precond=CVODEPrecond(setup, solve, side="right"),
    )  # fmt: skip
    solver.init_step(0.0, p.position.ravel())
    return _march(solver, p)


def ida(problem, rtol, atol, *, exact=True, krylov=5):
    p = problem

    def residual(t, y, yp, res):
        force = p.force(t, y)
        out = res.reshape(-1, 3)
        p.gamma.apply(yp.reshape(-1, 3).copy(), out)
        out -= force

    def prepare(t, y, yp, res, cj):
        p.linearise(t, y, yp)

    def product(t, y, yp, res, v, jv, cj):
        out = jv.reshape(-1, 3)
        p.linear.apply(v.reshape(-1, 3).copy(), out)
        out *= cj
        out -= p.stiffness(v, exact)

    def setup(t, y, yp, res, cj):
        p.linearise(t, y, yp)
        p.blocks(cj, 1.0)

    def solve(t, y, yp, res, r, z, cj, delta):
        p.apply_blocks(r.reshape(-1, 3), z.reshape(-1, 3))

    y0 = p.position.ravel()
    p.gamma.solve(p.force(0.0, y0), p.velocity, 1e-12)
    solver = IDA(
        residual, rtol=rtol, atol=atol, linsolver="gmres", krylov_dim=krylov,
        jactimes=IDAJacTimes(prepare, product), precond=IDAPrecond(setup, solve),
    )  # fmt: skip
    solver.init_step(0.0, y0, p.velocity.ravel().copy())
    return _march(solver, p)


def _march(solver, p):
    t = 0.0
    while t < p.duration:
        result = solver.step(p.duration, method="onestep", tstop=p.duration)
        if not result.success:
            return np.full((p.n, 3), math.nan)
        t = result.t
        p.counts["steps"] += 1
    return result.y.reshape(-1, 3).copy()


WAYS = {
    "cvode exact 1e-3": lambda p, a: cvode(p, 0.0, a),
    "cvode exact 1e-2": lambda p, a: cvode(p, 0.0, a, inner=1e-2, outer=1e-6),
    "cvode frozen 1e-2": lambda p, a: cvode(p, 0.0, a, exact=False, inner=1e-2, outer=1e-6),
    "cvode frozen 1e-1": lambda p, a: cvode(p, 0.0, a, exact=False, inner=1e-1, outer=1e-6),
    "cvode frozen 1e-1, Stokes blocks": lambda p, a: cvode(
        p, 0.0, a, exact=False, inner=1e-1, outer=1e-6, precond="stokes"
    ),
    "ida exact": lambda p, a: ida(p, 0.0, a),
    "ida frozen": lambda p, a: ida(p, 0.0, a, exact=False),
    "ida frozen, Krylov 20": lambda p, a: ida(p, 0.0, a, exact=False, krylov=20),
}
ATOL = (1e-2, 1e-3, 1e-4)
SCENES = {
    "1000 cells settle, 5 kPa s": Problem(5.0, 300.0),
    "1000 cells settle, 0.05 kPa s": Problem(0.05, 10.0),
    "1000 cells, 20 just divided, 5 kPa s": Problem(5.0, 300.0, divided=20),
    "1000 cells, 20 just divided, 0.05 kPa s": Problem(0.05, 10.0, divided=20),
    "1000 cells, 20 just divided, 0.05 kPa s, ten times the friction": Problem(
        0.05, 100.0, coefficient=1.0, divided=20
    ),
    "1000 cells, 200 just divided, 5 kPa s": Problem(5.0, 600.0, divided=200),
    "1000 cells, 20 just divided, 0.005 kPa s": Problem(0.005, 10.0, divided=20),
    "10 000 cells settle, 5 kPa s": Problem(5.0, 300.0, n=10_000),
    "10 000 cells settle, 0.05 kPa s": Problem(0.05, 10.0, n=10_000),
}


def measure(way, problem, atol, reference, runs):
    times = []
    for _ in range(runs + 1):
        problem.begin()
        start = time.perf_counter()
        end = WAYS[way](problem, atol)
        times.append(time.perf_counter() - start)
    error = float(np.sqrt(np.square(end - reference).sum(axis=1).mean()))
    return error, min(times[1:]), problem.counts


def seconds_at(error, rows):
    """Return the time at an error, between the measured ones on logarithmic axes."""
    found, seconds, _ = zip(*sorted(rows, key=lambda row: row[0]), strict=True)
    return float(np.exp(np.interp(np.log(error), np.log(found), np.log(seconds))))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="one run a row")
    runs = 1 if parser.parse_args().quick else 3
    for scene, problem in SCENES.items():
        problem.begin()
        reference = cvode(problem, 0.0, 1e-7, inner=1e-6, outer=1e-12)
        moved = np.sqrt(np.square(reference - problem.position).sum(axis=1).mean())
        print(f"\n{scene}, {problem.duration:g} s; cells move {moved:.3g} µm (rms)")
        for way in WAYS:
            rows = [measure(way, problem, atol, reference, runs) for atol in ATOL]
            for atol, (error, seconds, counts) in zip(ATOL, rows, strict=True):
                text = "  ".join(f"{name} {count}" for name, count in counts.items())
                print(f"  {way:32s} {atol:5.0e}  {error:8.1e} µm  {seconds:6.4f} s  {text}")
            print(f"{way}: {seconds_at(1e-3, rows):.4f} s at an error of 1e-3 µm", flush=True)


if __name__ == "__main__":
    main()
