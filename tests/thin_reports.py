"""Processes of pytest-xdist send of a test what its outcome needs: the other messages take longer than most tests.

Of six messages for a test that passes, its beginning and the reports of its setup and its teardown are left out, unless
an option shows what they state.
"""

from typing import Any

import pytest


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    options = session.config.option
    if not hasattr(session.config, "workerinput") or options.xmlpath or options.durations or shows_costs(options):
        return
    plugins = session.config.pluginmanager.get_plugins()
    for interactor in (each for each in plugins if type(each).__name__ == "WorkerInteractor"):
        interactor.sendevent = thin(interactor.sendevent)


def shows_costs(options: Any) -> bool:
    return bool(options.cost or options.most_cpu)


def thin(send: Any) -> Any:
    """Return a function that sends the messages that are needed."""

    def send_needed(name: str, **content: Any) -> None:
        if is_needed(name, content):
            send(name, **content)

    return send_needed


def is_needed(name: str, content: dict[str, Any]) -> bool:
    """Return whether a message changes what is shown at the end, or tells which test comes next.

    >>> is_needed("testreport", {"data": {"when": "setup", "outcome": "passed"}})
    False
    >>> is_needed("testreport", {"data": {"when": "teardown", "outcome": "failed"}})
    True
    """
    if name == "testreport":
        return content["data"]["when"] == "call" or content["data"]["outcome"] != "passed"
    return name != "logstart"
