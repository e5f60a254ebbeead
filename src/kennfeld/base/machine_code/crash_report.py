"""Messages about processes that foreign code has crashed or ended, or in which it does not return."""

import math
import signal
from collections.abc import Sequence

from kennfeld.base.errors import Finding, Location
from kennfeld.base.exit_status import signal_name
from kennfeld.base.machine_code.call_record import ForeignCall, read_calls
from kennfeld.base.watch_folder import is_running, watch_folder

_WINDOWS = {
    0xC0000005: "access violation",
    0xC00000FD: "stack overflow",
    0xC0000094: "integer division by zero",
    0xC000001D: "illegal instruction",
    0xC0000374: "damaged memory",
    0xC0000409: "abort",
}
_REMEDY = "No results were written. Try the file in the tool that it comes from, or use another version of it."
_MEMORY = "No results were written. Use fewer samples, or free memory."
_SLOW = (
    "No results were written. Raise `timeout` under [model] if its calls may take so long, else use another version."
)
_DAMAGED = "No results were written. Install Kennfeld and its dependencies again."
_MOST_NAMES = 4


def crash_finding(calls: Sequence[ForeignCall], files: Sequence[str], status: int) -> Finding:
    """Return the error about a process that ended before its work was done.

    Args:
        calls: calls of foreign code that had not returned.
        files: names of all files of foreign code that ran.
        status: exit status of the process, negative for a signal.
    """
    location = Location(_names([call.file for call in calls] or files))
    places, death = _places(calls), describe_status(status)
    if signal_name(status) == "SIGKILL":
        return Finding(location, f"the system ended the program{places}, probably for lack of memory", _MEMORY)
    if not files:
        end = death or f"exit status {status}"
        return Finding(Location(), f"the program ended before it ran any code of the project: {end}", _DAMAGED)
    if not death:
        return Finding(location, f"its code ended the program with exit status {status}{places}", _REMEDY)
    if calls:
        return Finding(location, f"its code crashed{places}: {death}", _REMEDY)
    message = f"the program crashed ({death}) while no code of the project ran, which may have damaged memory before"
    return Finding(location, message, _REMEDY)


def hang_finding(calls: Sequence[ForeignCall], limit: float) -> Finding:
    """Return the error about calls that took longer than the limit in s."""
    message = f"its code did not return within {limit:g} s{_places(calls)}"
    return Finding(Location(_names([call.file for call in calls])), message, _SLOW)


def excess_finding(files: Sequence[str], what: str) -> Finding:
    """Return the error about code that took more of the machine than it may, such as `more than 72 processes`."""
    return Finding(Location(_names(files)), f"its code took {what}, and was ended", _REMEDY)


def unloading_finding(files: Sequence[str], status: int) -> Finding:
    """Return the warning about a crash after the work was done."""
    message = f"its code crashed when the program ended: {describe_status(status) or f'exit status {status}'}"
    return Finding(Location(_names(files)), message, "The results are complete.", severity="warning")


def worker_findings() -> list[Finding]:
    """Return an error for each file whose code ran in a process of this command when that process ended."""
    folder = watch_folder()
    calls = {} if folder is None else {call.file: call for call in read_calls(folder) if not is_running(call.process)}
    return [
        Finding(Location(file), f"a process ended while its code ran{_places([call])}", _REMEDY)
        for file, call in calls.items()
    ]


def describe_end(process: int, status: int) -> str:
    """Return how another process of this command ended; it names the foreign code that it called, if it is watched.

    Args:
        process: its number.
        status: its exit status, negative for a signal.
    """
    folder = watch_folder()
    calls = [call for call in (read_calls(folder) if folder is not None else ()) if call.process == process]
    if not calls:
        return describe_status(status) or f"exit status {status}"
    finding = crash_finding(calls, [call.file for call in calls], status)
    return f"{finding.location}: {finding.message}"


def describe_status(status: int) -> str:
    """Return the name of the signal or of the error of Windows that ended a process; empty if it ended by itself.

    >>> describe_status(-11), describe_status(3)
    ('segmentation fault (SIGSEGV)', '')
    """
    if status < 0:
        name = signal_name(status)
        # macOS adds the number: `Segmentation fault: 11`
        text = (signal.strsignal(-status) or "").partition(":")[0] if name else ""
        return f"{text[:1].lower()}{text[1:]} ({name})" if text else name or f"signal {-status}"
    # the upper two bits of a status of Windows are set for errors
    return _WINDOWS.get(status, f"error 0x{status:X}" if status >= 0xC0000000 else "")


def _places(calls: Sequence[ForeignCall]) -> str:
    return "".join(f"{',' if number else ''} {_place(call)}" for number, call in enumerate(calls[:_MOST_NAMES]))


def _place(call: ForeignCall) -> str:
    time = "" if math.isnan(call.time) else f" at t = {call.time:g} s"
    instance = "" if math.isnan(call.time) else f", instance {call.instance + 1},"
    return f"in {call.function}{instance}{time}" if " " not in call.function else f"while {call.function}"


def _names(files: Sequence[str]) -> str:
    names = list(dict.fromkeys(files))
    return ", ".join([*names[:_MOST_NAMES], *(["..."] if len(names) > _MOST_NAMES else [])])
