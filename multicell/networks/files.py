"""The door to networks in files: SBML and Antimony."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

from multicell.errors import SceneError
from multicell.host.extras import needs
from multicell.networks.documents import read_network_document
from multicell.networks.network import Network

_SBML: Final = (".xml", ".sbml")
_ANTIMONY: Final = (".ant", ".txt")


def read_network(
    path: str | Path, inputs: Sequence[str] = (), given: Collection[str] = ()
) -> Network:
    """Read a network from a file of SBML (Level 1, 2 or 3) or Antimony.

    Nothing in a file is run but arithmetic: formulas are checked against a list, and identifiers
    do not get into the code.

    Parameters
    ----------
    path
        A file whose name ends in ``.xml`` or ``.sbml``, or in ``.ant`` or ``.txt`` for Antimony.
    inputs
        What the surroundings set at each time: parameters or species of the file. Reactions do not
        change a species that is an input.
    given
        Parameters that are set before anything is computed, and need no value in the file.

    Returns
    -------
    Network
        Its functions take arrays of float64. Concentrations, amounts and times are in the units of
        the file.

    Raises
    ------
    SceneError
        With the file's name, for a file that cannot be read, is neither of the two, or holds what
        is not read: fast reactions, delays, algebraic rules, priorities of events, submodels.
    MissingPackage
        Where the packages of the extra ``networks`` are not installed.
    """
    source = Path(path).expanduser()
    _ending(source)  # the name comes first
    return network_of_text(read_network_document(source), source, inputs, given)


def _ending(path: str | Path) -> str:
    ending = Path(path).suffix.lower()
    if ending not in (*_SBML, *_ANTIMONY):
        hint = "SBML ends in .xml or .sbml, Antimony in .ant or .txt."
        raise SceneError("", f"'{path}' is no file of a network by its name", hint)
    return ending


def network_of_text(
    text: str, path: str | Path, inputs: Sequence[str] = (), given: Collection[str] = ()
) -> Network:
    """Return the network of a file whose text is known; see :func:`read_network`."""
    ending, name = _ending(path), Path(path).name
    needs("libsbml", "sbmlode")
    from multicell.networks.sbml import network_from_sbml

    if ending in _ANTIMONY and not text.lstrip().startswith("<"):
        from multicell.networks.antimony_text import sbml_of

        needs("antimony")
        text, name = sbml_of(text, name), f"{name} as SBML"
    return network_from_sbml(text, name, inputs, given)
