"""Growth of volume, limited by nutrient and pressure, and loss of volume after death."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from multicell.cells import SPHERE, Cells, FloatArray, State

if TYPE_CHECKING:
    from multicell.scene.parts import Death
    from multicell.scene.scene import Scene


_GROWING = int(State.PROLIFERATING)  # numbers compare with arrays faster than names do


def division_volume(scene: Scene) -> float:
    """Return the volume at which a cell divides, µm³."""
    return float(SPHERE * scene.cells.division_radius**3)


def birth_volume(scene: Scene) -> float:
    """Return the volume of a newborn cell, half the division volume, µm³."""
    return 0.5 * division_volume(scene)


def growth_factor(
    scene: Scene, concentrations: Mapping[str, FloatArray], pressure: FloatArray
) -> FloatArray:
    """Return how fast cells would grow here, as a fraction of unlimited growth.

    The factor is the product of Monod's c / (K + c) over all nutrients that growth needs, and of
    the ATP made in place of c where the scene has ``energy`` limit it, of
    I / (I + c) over those that inhibit it, and of min(1, max(0, 1 - p / p_crit)): pressure slows
    growth linearly and stops it at the critical pressure, tension does not speed it up. It
    describes the surroundings only; which cells do grow is decided by their state in
    :func:`volumes_after`.

    Parameters
    ----------
    scene
        A scene without ``growth`` gives zeros.
    concentrations : mapping of (n,), mM
        Concentration at the cells, for every nutrient of the scene.
    pressure : (n,), kPa
        Compression by the neighbours, tension negative.

    Returns
    -------
    (n,) float64
        In [0, 1].

    Raises
    ------
    KeyError
        If a nutrient of the scene has no concentrations.

    References
    ----------
    J. Monod, Annu. Rev. Microbiol. 3 (1949) 371; A. N. Malmi-Kakkada et al., Phys. Rev. X 8
    (2018) 021025 for growth that stops at a critical pressure.
    """
    pressure = np.asarray(pressure, dtype=np.float64)
    if scene.growth is None:
        return np.zeros_like(pressure)
    factor = np.ones(pressure.shape)
    for name, nutrient in scene.nutrients.items():
        c = np.asarray(concentrations[name])
        if nutrient.growth_half_saturation is not None:
            factor *= c / (nutrient.growth_half_saturation + c)
        if nutrient.growth_inhibition is not None:
            factor *= nutrient.growth_inhibition / (nutrient.growth_inhibition + c)
    if scene.energy is not None and scene.energy.growth_half_saturation is not None:
        made = scene.energy.supply(scene.nutrients, concentrations)
        factor *= made / (scene.energy.growth_half_saturation + made)
    critical = scene.growth.critical_pressure
    if critical is not None:
        factor *= np.minimum(1.0, np.maximum(0.0, 1.0 - pressure / critical))
    return factor


def volumes_after(scene: Scene, cells: Cells, factor: FloatArray, dt: float) -> FloatArray:
    """Return the volume of each cell after a time ``dt``.

    Proliferating cells grow by the scene's law (:mod:`multicell.growth_laws`), so that one
    that nothing limits doubles in its cycle time; quiescent cells keep their volume; necrotic cells
    shrink as V' = -V / lysis_time, after they have swollen as V' = V ln(swelling) / swelling_time
    where the scene has them swell; apoptotic ones shrink as V' = -V / apoptosis_time. All is
    integrated exactly for the given factor. Growth may pass the division volume within the step:
    the excess goes to the daughters.

    Parameters
    ----------
    scene
        Without ``growth`` no cell grows, without ``death`` no cell shrinks.
    cells
        The population, n cells.
    factor : (n,)
        From :func:`growth_factor`.
    dt
        Length of the step, s.

    Returns
    -------
    (n,) float64, µm³
    """
    volume = cells.volume
    if scene.growth is not None and not scene.growth.phases:
        birth, living = birth_volume(scene), cells.state == _GROWING
        law = scene.growth.growth_law
        if law.constant:
            volume += np.where(living, dt * (factor * birth / cells.cycle_time), 0.0)
        else:
            share = np.where(living, dt * factor / cells.cycle_time, 0.0)
            volume = np.where(living, law.volume_after(volume, share, birth), volume)
    if scene.death is not None and cells.dead.any():
        necrotic = cells.state == State.NECROTIC
        volume[necrotic] *= _necrotic_factor(scene.death, cells.age[necrotic], dt)
        volume[cells.state == State.APOPTOTIC] *= np.exp(-dt / scene.death.apoptosis_time)
    return volume


def _necrotic_factor(death: Death, since: FloatArray, dt: float) -> FloatArray:
    """Return the volume of necrotic cells after ``dt`` over that now, a time ``since`` death."""
    if death.swelling == 1.0:
        return np.full_like(since, np.exp(-dt / death.lysis_time))
    swelling = np.clip(death.swelling_time - since, 0.0, dt)
    rate = np.log(death.swelling) / death.swelling_time
    return np.asarray(np.exp(rate * swelling - (dt - swelling) / death.lysis_time))
