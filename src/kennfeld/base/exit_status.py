"""The signal in the exit status of a process."""

import signal


def signal_name(status: int) -> str:
    """Return the name of the signal that ended a process; empty if none did, or if the system does not know it.

    A status is negative for a signal. Windows, which has few of them, counts events from 0 among them.

    >>> signal_name(-11), signal_name(0)
    ('SIGSEGV', '')
    """
    return next((member.name for member in signal.Signals if member == -status), "") if status < 0 else ""
