"""Fixes of findings: changes of the project file that a page offers on buttons."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError, Finding, Fix
from kennfeld.base.lazy_dataclass import dataclass

MAX_OPTIONS = 400  # of a choice; a field finds one of more names by its letters


@dataclass(frozen=True)
class FixRow:
    """A fix of a finding by its title, and the values to choose from if it needs one."""

    title: str
    options: Sequence[str]


@dataclass(frozen=True)
class ChosenFix:
    """The fix that a user takes: the text of its finding, its title, and the chosen value."""

    finding: str
    fix: str
    option: str = ""


def fix_rows(finding: Finding) -> list[FixRow]:
    """Return the fixes of a finding as a page offers them."""
    return [FixRow(fix.title, fix.options) for fix in finding.fixes if len(fix.options) <= MAX_OPTIONS]


def apply_fix(session: Session, asked: ChosenFix) -> None:
    """Apply a fix as one change.

    Raises:
        ArgumentError: the finding is gone, so that a second click would change something else.
    """
    own = [fix for finding in session.findings if str(finding) == asked.finding for fix in finding.fixes]
    fix = next((each for each in own if each.title == asked.fix), None)
    if fix is None:
        raise ArgumentError(f"there is nothing to fix any more: {asked.finding[:200]}")
    if fix.options and asked.option not in fix.options:
        raise ArgumentError(f"{fix.title}: choose one of {', '.join(fix.options[:10])}")
    chosen = _with_option(fix, asked.option) if fix.options else fix
    session.do(session.key_command(chosen.title, chosen.changes))


def _with_option(fix: Fix, option: str) -> Fix:
    """Return the fix with a value that was chosen for its last key."""
    keys, _ = fix.changes[-1]
    changes: list[tuple[Any, Any]] = [*fix.changes[:-1], (keys, option)]
    return replace(fix, title=f"{fix.title} {option}", changes=tuple(changes), options=())
