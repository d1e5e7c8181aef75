"""One run of a study, and the digest of all that decides its results."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, is_dataclass
from typing import Any, Final, final

from multicell.behaviours.laws import OWN_RESPONSES
from multicell.plugins.laws import OwnLaw
from multicell.plugins.named import load_object, origin
from multicell.results.observable import OWN_OBSERVABLES, find_own
from multicell.scene.scene import Scene
from multicell.schema import Tables, specs

MODEL_VERSION: Final = 12
"""To be raised by whoever changes the numbers that a scene gives.

Runs that were made with another number are computed again. ``tests/studies/test_model_version.py``
holds observables of short runs beside it.
"""

_LENGTH: Final = 24  # hexadecimal digits of a name: a clash is expected after 3e14 runs
_ORDERED: Final = (
    "chemotaxis",
    "motions",
    "nutrients",
    "reactions",
    "types",
)
"""Tables whose order decides results: which cells are of which type, which sum comes first."""


@final
@dataclass(frozen=True)
class StudyRun:
    """One run of a study.

    - ``name``: digest of what decides the results; the run's folder is ``runs/<name>``
    - ``scene``: what is run
    - ``coordinates``, axis name -> number in base units or word, ``"seed"`` -> int: where the run
      stands in its study
    - ``expected``: wall time on one core that it is expected to take, s
    """

    name: str
    scene: Scene
    coordinates: Mapping[str, Any] = field(hash=False)
    expected: float


@final
@dataclass(frozen=True)
class PlainScene:
    """A scene as it travels to a worker: plain values, and where to find what is the user's own.

    - ``values``: as a table in base units
    - ``laws``: ``/path/file.py:Name`` of each law of the user's own
    - ``observables``: the same by function of each observable of the user's own
    - ``networks``: the same by name of each network of the user's own
    """

    values: Mapping[str, Any]
    laws: tuple[str, ...] = ()
    observables: Mapping[str, str] = field(default_factory=dict)
    networks: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene) -> PlainScene:
        """Return a scene as plain values."""
        laws: list[type] = [type(scene.contact)]
        if scene.growth is not None:
            laws.append(type(scene.growth.growth_law))
        named = {part.law for part in scene.responses.values()}
        laws += [OWN_RESPONSES[name] for name in sorted(named) if name in OWN_RESPONSES]
        own = scene.output.observables.items()
        observables = {stated.function: find_own(name, stated).source for name, stated in own}
        sources = tuple(origin(law) for law in laws if issubclass(law, OwnLaw))
        networks = {
            part.network: origin(part.model.rates)
            for part in scene.networks.values()
            if part.network is not None
        }
        return cls(scene.to_dict(), sources, observables, networks)

    def load(self) -> Scene:
        """Return the scene; what is the user's own is loaded first."""
        for law in self.laws:
            from multicell.plugins.user_laws import load_law

            load_law(law)
        for function, source in self.observables.items():
            if function not in OWN_OBSERVABLES:
                from multicell.results.own_observable import load_observable

                load_observable(source)
        for network, source in self.networks.items():
            from multicell.networks.custom import OWN_NETWORKS

            if network not in OWN_NETWORKS:
                load_object(source, "networks")
        return Scene.from_dict(self.values)


def run_digest(scene: Scene) -> str:
    """Return the name of a run; see :func:`run_digests`."""
    return run_digests(scene, [scene.seed])[0]


def run_digests(scene: Scene, seeds: Iterable[int]) -> list[str]:
    """Return the name of the run of a scene with each seed: a digest of all that decides results.

    That is the scene in base units without its title, the version of the model, and the
    fingerprint of a law of the user's own (of its function and of all that it reads; it is part of
    the law's name). Scenes that are written differently, in other units or with their keys in
    another order, have the same digest; the order of named tables such as types, in which they take
    their random numbers, counts.
    """
    entries, names = canonical(scene), []
    for seed in seeds:
        content = {"model": MODEL_VERSION, "scene": {**entries, "seed": seed}}
        text = json.dumps(content, sort_keys=True, allow_nan=False, separators=(",", ":"))
        names.append(hashlib.sha256(text.encode()).hexdigest()[:_LENGTH])
    return names


def canonical(scene: Scene) -> dict[str, Any]:
    """Return all that decides the results of a scene as plain values, its keys without order."""
    entries = scene.to_dict()
    entries.pop("title", None)
    if "cells" in entries["initial"]:
        del entries["initial"]["cells"]["file"]  # where the table is makes no difference
    for network in entries.get("networks", {}).values():
        network.pop("file", None)
    _keep_order(scene, entries)
    return entries


def _keep_order(part: Any, entries: dict[str, Any]) -> None:
    """Turn tables whose order decides results into lists of name and entry."""
    for name in specs(part):
        value = getattr(part, name)
        if name not in entries or not isinstance(value, Tables):
            continue
        for key, inner in value.items():
            if is_dataclass(inner):
                _keep_order(inner, entries[name][key])
        if name in _ORDERED:
            entries[name] = [[key, entries[name][key]] for key in value]
