"""A file whose writes never seem to fail, since HDF5 cannot close one that it cannot write."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import IO, Any, final


@final
class Sink:
    """A file for HDF5 whose writes never fail: the first refusal is kept for :meth:`check`.

    HDF5 keeps a file open that it cannot write, complains at the end of the process, and may
    crash there. So it is told that all went well.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._place = self._end = 0
        self._trouble: BaseException | None = None

    def check(self) -> None:
        """Raise what a write was refused with."""
        if self._trouble is not None:
            raise self._trouble

    def seek(self, place: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._end}[whence]
        self._place = base + place
        return self._place

    def tell(self) -> int:
        """Return the place."""
        return self._place

    def write(self, data: Any) -> int:
        """Write, or note why that is refused."""
        length = self._at_place(self._file.write, data)
        self._end = max(self._end, self._place)
        return length

    def readinto(self, target: Any) -> int:
        """Read back what was written; after a refusal there may be nothing."""
        return self._at_place(self._file.readinto, memoryview(target).cast("B"))  # type: ignore[attr-defined]

    def read(self, size: int) -> bytes:
        """Read back what was written; it is what tells h5py that this is a file."""
        data = bytearray(size)
        self.readinto(data)
        return bytes(data)

    def truncate(self, size: int | None = None) -> int:
        """Set the length."""
        self._end = self._place if size is None else size
        self._try(self._file.truncate, self._end)
        return self._end

    def flush(self) -> None:
        """Hand everything to the system."""
        self._try(self._file.flush)

    def _at_place(self, action: Callable[[Any], Any], data: Any) -> int:
        """Read or write at the place, and go on behind it whatever became of it."""
        length = memoryview(data).nbytes
        self._try(self._file.seek, self._place)
        self._try(action, data)
        self._place += length
        return length

    def _try(self, action: Callable[..., Any], *given: Any) -> None:
        if self._trouble is None:
            try:
                action(*given)
            except BaseException as error:  # raised again by check()
                self._trouble = error
