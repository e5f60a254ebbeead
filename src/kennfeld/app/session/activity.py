"""Activities that take a while, as pages show them, and the wish of a user to stop one."""

import threading
from collections.abc import Callable

Tell = Callable[[str, float | None], object]  # what is done, and the share that is; an empty text at the end


class StoppedError(Exception):
    """The user has stopped what was being done. Not an `InputError`, which others would collect and go on."""


def _silent(text: str, share: float | None) -> None:
    """Tell nobody."""


class Activity:
    """The present activity of the thread of the sessions.

    Args:
        tell: called with each step, in this thread.

    Attributes:
        present: what was told last; an empty text if nothing is being done. May be read from any thread.
    """

    def __init__(self, tell: Tell = _silent) -> None:
        self._tell, self._stop = tell, threading.Event()
        self.present: tuple[str, float | None] = ("", None)

    def begin(self) -> None:
        """Forget an earlier wish to stop; called before a question is answered."""
        self._stop.clear()

    def say(self, text: str, share: float | None = None) -> None:
        """Tell what is being done.

        Args:
            text: in a few words.
            share: of the work that is done, from 0 to 1; None if it is not known.

        Raises:
            StoppedError: the user has stopped it.
        """
        if self._stop.is_set():
            raise StoppedError
        self.present = (text, share)
        self._tell(text, share)

    def end(self) -> None:
        """Tell that nothing is being done any more."""
        if self.present[0]:
            self.present = ("", None)
            self._tell("", None)

    def stop(self) -> None:
        """Have the next `say` raise `StoppedError`; may be called from any thread."""
        self._stop.set()
