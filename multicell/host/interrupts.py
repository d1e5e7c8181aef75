"""Ctrl-C and other signals wait for the end of what must not be cut in two.

Python calls the handler of a signal between any two of its instructions. What the handler raises
may leave half of something behind. So the handlers, whatever they are, are replaced meanwhile by
one that notes the signal, and called afterwards.

Two blocks nest in each other. :data:`WHOLE_STEP` is a coupling step, or a whole run: Ctrl-C waits
for its end, a second one does not. :data:`UNCUT` is what numba compiles, a file that is written, or
a library that calls Python back: every signal waits for its end, or for a pause that it makes. In
other threads than the main one, where Python calls no handlers, both do nothing.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # signal's own look for names of handlers
import _thread
import signal
import sys
import threading
from collections.abc import Iterable
from types import FrameType
from typing import Any, Final, Self, final

_ALL: Final = sorted(
    signal.valid_signals() - {getattr(signal, name, None) for name in ("SIGKILL", "SIGSTOP")}
)
_URGENT: Final = 2
"""How often a signal has come that is delivered within a step; later ones wait again."""

_MAIN: Final = threading.main_thread()
"""A process that another thread forks has another one, and delays nothing."""

_replaced: dict[int, Any] = {}  # number of a signal -> its handler while it is replaced
_counts: dict[int, int] = {}  # how often signals have come since the outermost block began
_waiting: dict[int, bool] = {}  # signals that have not been delivered, and whether that is urgent


def _note(number: int, _: FrameType | None) -> None:
    """Note a signal; the handler of all that are replaced."""
    _counts[number] = _counts.get(number, 0) + 1
    _waiting[number] = _waiting.get(number, False) or _counts[number] == _URGENT
    if not UNCUT.depth:
        _deliver(urgent=True)


def _deliver(*, urgent: bool) -> None:
    """Call the handlers of signals that wait: of urgent ones, and of those in place again."""
    for number, pressing in list(_waiting.items()):
        if not urgent or pressing or number not in _replaced:
            del _waiting[number]
            handler: Any = _replaced.get(number) or signal.getsignal(number)
            try:
                handler(number, None)
            finally:
                _deliver(urgent=urgent)
            return


@final
class Block:
    """A context in which signals are noted, and at whose outermost end their handlers are called.

    - ``signals``: numbers; those without a handler of Python's stay as they are
    """

    def __init__(self, signals: Iterable[int]) -> None:
        self._signals = tuple(signals)
        self._own: list[int] = []
        self.depth = 0

    def __enter__(self) -> Self:
        if not _in_main_thread():
            return self
        if self.depth and not any(number in _replaced for number in self._signals):
            self.depth = 0  # a handler raised while an earlier block was being entered or left
        if not self.depth and self._own:
            self._restore()
        self.depth += 1
        if self.depth == 1:
            try:
                for number in self._signals:
                    handler = _signal.getsignal(number)
                    if callable(handler) and number not in _replaced:
                        _replaced[number] = handler
                        self._own.append(number)
                        _signal.signal(number, _note)
            except BaseException:  # of the handler of a signal that has come just before
                self._leave()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        if _in_main_thread():
            self._leave()
            if _waiting and not UNCUT.depth:
                _deliver(urgent=True)

    def _leave(self) -> None:
        self.depth = max(self.depth - 1, 0)
        if not self.depth:
            self._restore()

    def _restore(self) -> None:
        """Put the handlers back that this block has replaced."""
        raised: BaseException | None = None
        while self._own:
            number = self._own[-1]
            try:
                if _signal.getsignal(number) is _note:
                    _signal.signal(number, _replaced[number])
                self._own.pop()
                del _replaced[number]
            except BaseException as error:  # of the handler of another one that is in place again
                raised = error
        if not _replaced:
            _counts.clear()
        if raised is not None:
            raise raised

    def pause(self) -> None:
        """Call handlers that wait for the end of the outermost block of this kind alone.

        What they raise comes from here: a callback that begins so ends the library that calls it
        by that library's own exit, and at no other place.
        """
        if _waiting and self.depth == 1 and _in_main_thread():
            self.__exit__()
            self.__enter__()

    @staticmethod
    def deliver() -> None:
        """Call the handlers of all signals that have come."""
        _deliver(urgent=False)


def _in_main_thread() -> bool:
    return threading.get_ident() == _MAIN.ident


WHOLE_STEP: Final = Block([signal.SIGINT])
UNCUT: Final = Block(_ALL)


_pressed: list[int] = []


def watch_command() -> None:
    """Note every Ctrl-C of a command, and raise it again where Python can only print it.

    Python prints an exception that comes while it deletes an object, and continues. So does the
    compiled code of others where it calls Python: SciPy's Sobol' sequences read a file so.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return

    raised_again: list[Any] = []

    def press(number: int, frame: FrameType | None) -> None:
        _pressed.append(number)
        if not raised_again:  # a thread that is being started raises for this one, too
            raise KeyboardInterrupt

    def unraisable(found: Any) -> None:
        if isinstance(found.exc_value, KeyboardInterrupt):
            again = threading.Timer(0.02, _thread.interrupt_main)
            again.daemon = True
            raised_again.append(again)
            try:
                again.start()
            finally:
                raised_again.clear()
        else:
            sys.__unraisablehook__(found)

    def uncaught(kind: type[BaseException], error: BaseException, trace: Any) -> None:
        if not issubclass(kind, KeyboardInterrupt):  # raised again, and reported in one word
            sys.__excepthook__(kind, error, trace)

    signal.signal(signal.SIGINT, press)
    sys.unraisablehook, sys.excepthook = unraisable, uncaught


def end_command() -> None:
    """Hear no Ctrl-C any more: all that is left to do is to leave."""
    if _in_main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def interrupted() -> bool:
    """Return whether there was a Ctrl-C since the command began."""
    return bool(_pressed)
