"""Laws of response of the user's own: a Python function of signals becomes a law.

>>> import multicell as mc
>>> @mc.response(parameters={"half": ""})
... def saturating(drug, p):
...     return drug / (p.half + drug)
>>> law = saturating(half=0.5)
>>> float(law.share(1.5, falls=False))
0.75
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from multicell.behaviours.laws import OWN_RESPONSES, ResponseLaw
from multicell.plugins.laws import OwnLaw
from multicell.plugins.named import own_code
from multicell.plugins.user_laws import law_of, refuse_names

if TYPE_CHECKING:
    from multicell.cells import FloatArray


class UserResponse(OwnLaw, ResponseLaw):
    """A law made by :func:`response`; its parameters are the fields of the dataclass.

    Attributes
    ----------
    signals
        How many signals its function takes.
    """

    signals: ClassVar[int]
    _function: ClassVar[Callable[..., Any]]

    def share(self, signal: Any, *, falls: bool) -> FloatArray:
        """Return the share of the full effect, (n,); of several signals ``signal`` is a tuple."""
        given = signal if isinstance(signal, tuple) else (signal,)
        arrays = np.broadcast_arrays(*(np.asarray(one, dtype=float) for one in given))
        with own_code("responses"):
            found = type(self)._function(*arrays, self)
            share = np.broadcast_to(np.asarray(found, dtype=float), arrays[0].shape)
        return 1.0 - share if falls else share


def response(*, parameters: Mapping[str, Any]) -> Callable[[Callable[..., Any]], type[Any]]:
    """Make a law of response of a function that returns the share of the full effect.

    The function is called as ``share(signal, ..., p)``: each signal is an array with a number for
    each cell, in base units, and ``p`` has the parameters as attributes. It returns an array of
    shares from 0 to 1. A scene names it ``law = "file.py:name"``, with its signals in order,
    ``signal = "drug, oxygen"``, and its ``parameters``.

    Parameters
    ----------
    parameters
        Name -> ``""`` for each parameter, all numbers without unit; or a declaration of
        :mod:`multicell.schema` such as ``number(default=0.5, above=0.0)``.

    Returns
    -------
    A class of laws. :func:`multicell.testing.check_response` reports broken promises.

    Raises
    ------
    TypeError
        For a function whose last argument is not ``p``, or that has no signal; for a parameter
        whose name is taken.
    SceneError
        When a law is made with a value that is refused.
    """

    def make(function: Callable[..., Any]) -> type[Any]:
        refuse_names(UserResponse, parameters)
        *signals, last = list(signature(function).parameters) or [""]
        if last != "p" or not signals:
            raise TypeError(f"{function.__qualname__!r} must have signals and then p as arguments")
        own = {"signals": len(signals), "_function": staticmethod(function)}
        return law_of(UserResponse, function, parameters, OWN_RESPONSES, [function], own)

    return make
