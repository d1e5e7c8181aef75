"""Every error that a user can cause, and the exit code that each one ends with."""

from __future__ import annotations

import errno
import os
import unicodedata
from collections.abc import Sequence
from enum import IntEnum
from typing import ClassVar, Final, Self, final

_LONGEST_PATH = 200  # letters of a key that are shown

_SOMETHING_ELSE: Final = {
    errno.EISDIR,
    errno.ENOTDIR,
    errno.ELOOP,
    errno.EINVAL,
    errno.EFBIG,
    errno.ENXIO,
    errno.EEXIST,
    errno.ENAMETOOLONG,
}
"""The system refuses these for what stands in a file's place, such as a folder or a pipe, or for
its name."""


@final
class ExitCode(IntEnum):
    """How a command ends; each member states its one meaning as ``words``."""

    words: str

    DONE = 0, "done"
    FAILED = (
        1,
        (
            "the computation failed: a step that cannot be solved, "
            "a run of a study, a fit without a result, code of your own"
        ),
    )
    REFUSED = (
        2,
        (
            "the input cannot be used: a scene, an option, data, a damaged file or one of another "
            "run, a folder that holds something else, a missing package"
        ),
    )
    MACHINE = (
        3,
        (
            "the machine refused: a full disk, a file that may not be read or written or is in "
            "use, too little memory, workers that have gone; the same command continues once "
            "that is mended"
        ),
    )
    BUG = 4, "an error of multicell itself; please report it"
    INTERRUPTED = 130, "stopped by Ctrl-C or by an answer; results up to then stay readable"

    def __new__(cls, number: int, words: str) -> Self:
        """Return a member with its meaning."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.words = words
        return member


def exit_code_of(error: BaseException) -> ExitCode:
    """Return how a command ends that an error ends."""
    if is_machine_failure(error):
        return ExitCode.MACHINE
    if isinstance(error, OSError):
        return ExitCode.MACHINE if error.errno is None else ExitCode.REFUSED
    return error.exit_code if isinstance(error, MulticellError) else ExitCode.BUG


def is_machine_failure(error: BaseException | None) -> bool:
    """Return whether the machine is the cause of an error, not the content of a file.

    A file that may not be read, is locked or gone, a full disk, too many open files and too little
    memory say nothing of the file's content: nothing may be removed for them.
    """
    while error is not None and not getattr(error, "damaged", False):
        if isinstance(error, MemoryError):
            return True
        if isinstance(error, OSError) and error.errno is not None:
            return error.errno not in _SOMETHING_ELSE
        error = error.__cause__
    return False


def is_set(name: str) -> bool:
    """Return whether a variable of the environment is set, not to 0, false, no, off or nothing."""
    return os.environ.get(name, "").strip().lower() not in ("", "0", "false", "no", "off")


def printable(text: str, *, lines: bool = False) -> str:
    r"""Return a text with ``\x1b`` and the like for what is not printable, but for spaces.

    - ``lines``: ends of lines and tabs stay as well
    """
    if lines:
        text = text.replace("\r\n", "\n")
    kept = "\n\t" if lines else ""
    return "".join(
        x if x.isprintable() or x in kept or unicodedata.category(x) == "Zs" else ascii(x)[1:-1]
        for x in text
    )


class MulticellError(Exception):
    """Base of all errors raised on purpose; its text is written for the user.

    Abstract: raise one of the final classes below.

    Parameters
    ----------
    problem
        What is wrong or has happened, in words, with the value and what is allowed.
    hint
        What to try, for example the likely name of a misspelt key.
    """

    exit_code: ClassVar[ExitCode] = ExitCode.FAILED

    def __init__(self, problem: str, hint: str = "", *, where: str = "") -> None:
        self.problem, self.hint = printable(problem), printable(hint)
        super().__init__(printable(f"{where}{problem}{'. ' if hint else ''}{hint}"))

    def _render_traceback_(self) -> list[str]:
        """Return the line that IPython prints in place of a traceback."""
        if is_set("MULTICELL_DEBUG"):
            import traceback

            return traceback.format_exception(self)
        return [f"{type(self).__name__}: {self}"]


@final
class UnitWarning(UserWarning):
    """A number without a unit that was read in base units, where another one may be meant."""


@final
class SceneError(MulticellError):
    """A scene, a parameter or a quantity that cannot be accepted.

    Parameters
    ----------
    path
        Where the value stands, as dotted keys (``"nutrients.oxygen.boundary"``).
    problem, hint
        As for all errors.
    """

    exit_code: ClassVar[ExitCode] = ExitCode.REFUSED

    def __init__(self, path: str, problem: str, hint: str = "") -> None:
        self.path = path
        where = path if len(path) <= _LONGEST_PATH else f"{path[:_LONGEST_PATH]}..."
        super().__init__(problem, hint, where=f"{where}: " if path else "")


@final
class DataError(MulticellError):
    """Measured data that cannot be used.

    Parameters
    ----------
    place
        Where in the data, such as ``"growth.csv, line 3, 'diameter / um'"``.
    problem, hint
        As for all errors.
    """

    exit_code: ClassVar[ExitCode] = ExitCode.REFUSED

    def __init__(self, place: str, problem: str, hint: str = "") -> None:
        self.place = place
        super().__init__(problem, hint, where=f"{place}: ")


@final
class FitFailed(MulticellError):  # noqa: N818 - it names what happened, like StepFailed
    """A fit that cannot go on, for example because no run of it succeeds."""


@final
class FrameError(MulticellError, IndexError):
    """A number of a frame that a run does not have."""

    exit_code = ExitCode.REFUSED


@final
class OutputError(MulticellError):
    """An output folder or file that cannot be used: written, read, or trusted.

    Parameters
    ----------
    problem
        Problem, place, and hint.
    exit_code
        ``MACHINE`` for a run that could not go on writing; a folder that could not be used from
        the start is refused, unless the system is the cause (:func:`exit_code_of`).
    in_use
        Whether another run in the folder is what keeps it from being used.
    damaged
        Whether something was read that is not what was written. Where it is not, what is there may
        be whole: the machine refused to read or write it (no such file, no permission, locked, too
        many open files, disk full), or it may not be used in this way.
    """

    exit_code: ExitCode  # type: ignore[misc]  # of each one its own

    def __init__(
        self,
        problem: str,
        *,
        exit_code: ExitCode = ExitCode.REFUSED,
        in_use: bool = False,
        damaged: bool = False,
    ) -> None:
        super().__init__(problem)
        self.exit_code = ExitCode.MACHINE if in_use else exit_code
        self.in_use = in_use
        self.damaged = damaged


@final
class StepFailed(MulticellError):  # noqa: N818 - it names what happened, like StopIteration
    """A coupling step whose equations could not be solved.

    Parameters
    ----------
    time
        Simulated time in s at which the integration stopped.
    problem, hint
        As for all errors.
    cell
        Identity of the cell that shows the failure most, where there is one.
    """

    def __init__(self, time: float, problem: str, hint: str, cell: int | None = None) -> None:
        self.time, self.cell = time, cell
        where = f"cell {cell}, " if cell is not None else ""
        super().__init__(problem, hint, where=f"step failed ({where}t = {time:.6g} s): ")


@final
class NutrientFailed(MulticellError):  # noqa: N818 - it names what happened, like StepFailed
    """A nutrient field that cannot be laid or solved."""


@final
class MissingPackage(MulticellError):  # noqa: N818 - it names what is so, like StepFailed
    """An optional package that a command needs and that is not installed.

    Parameters
    ----------
    packages
        What is missing.
    extra
        The set of optional packages that has them: ``pip install "multicell[extra]"``.
    """

    exit_code: ClassVar[ExitCode] = ExitCode.REFUSED

    def __init__(self, packages: Sequence[str], extra: str) -> None:
        self.packages = tuple(packages)
        self.extra = extra
        one = len(self.packages) == 1
        super().__init__(
            f"{' and '.join(self.packages)} {'is' if one else 'are'} not installed: "
            f'pip install "multicell[{extra}]"'
        )


@final
class ClusterError(MulticellError):
    """Workers of a study that cannot be used, or that have gone.

    Parameters
    ----------
    problem, hint
        As for all errors, with the address.
    exit_code
        ``REFUSED`` before anything has run, ``MACHINE`` afterwards.
    """

    exit_code: ExitCode  # type: ignore[misc]  # of each one its own

    def __init__(self, problem: str, hint: str, *, exit_code: ExitCode = ExitCode.REFUSED) -> None:
        super().__init__(problem, hint)
        self.exit_code = exit_code
