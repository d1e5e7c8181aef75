"""Resolve methods of the user's own: a class, an object, or ``file.py:Name``."""

from __future__ import annotations

from dataclasses import MISSING, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

from multicell.errors import SceneError
from multicell.integrators.base import Integrator, MethodInfo, info_of
from multicell.integrators.registry import METHODS, find, instantiate, meant_by
from multicell.plugins.named import load_object, origin
from multicell.schema import near_miss

if TYPE_CHECKING:
    from multicell.scene.parts import IntegratorOptions


def method_info(method: Any, what: str = "integrator") -> MethodInfo:
    """Return the information on a method of any kind.

    - ``method``: name in the registry, ``file.py:Name``, a class or an object
    - ``what``: where it was asked for, as the path of errors

    Raises SceneError if there is no such method, or it is no integrator.
    """
    if isinstance(method, str):
        info = find(method)
        if info is None and ":" not in method:
            hint = meant_by(method) or near_miss(method, METHODS)
            raise SceneError(what, f"no method is called {method!r}", hint)
        return info or method_info(load_object(method, what), what)
    if not callable(getattr(method, "integrate", None)):
        name = getattr(method, "__name__", type(method).__name__)
        problem = f"{name!r} is no integrator: it has no method integrate(system, position)"
        raise SceneError(what, problem)
    return info_of(method)


def own_integrator(method: Any, options: IntegratorOptions) -> tuple[IntegratorOptions, Integrator]:
    """Return the options that a run with a method of the user's own records, and the method.

    What is recorded is the file and name that the method came from, its settings under the names
    that they have in a scene, and the others in brackets behind its name.

    - ``method``: ``file.py:Name``, a class, which is made with the options, or an object

    Raises SceneError if there is no such method, it is no integrator or cannot be made.
    """
    found = load_object(method, "integrator") if isinstance(method, str) else method
    info = method_info(found)
    own = instantiate(info, options) if isinstance(found, type) else found
    shared = {f.name for f in fields(options)} - {"method"}
    settings = {name: getattr(own, name) for name in shared if hasattr(own, name)}
    if not settings.get("step", 1.0) > 0.0:
        # no step: under error control
        del settings["step"]
    named = replace(options, **settings)
    if info.name in METHODS and own == instantiate(METHODS[info.name], named):
        return replace(named, method=info.name), own
    return replace(named, method=origin(type(own)) + _others(own, shared)), own


def _others(method: Any, shared: set[str]) -> str:
    """Return the settings that a scene has no name for, where they are not the usual ones."""
    if not is_dataclass(method):
        return ""
    values = {
        f.name: getattr(method, f.name)
        for f in fields(method)
        if f.name not in shared and (f.default is MISSING or getattr(method, f.name) != f.default)
    }
    return f"({', '.join(f'{name}={value!r}' for name, value in values.items())})" * bool(values)
