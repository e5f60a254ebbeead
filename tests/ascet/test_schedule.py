"""Task schedules of applications."""

import pytest

from kennfeld.ascet.schedule import Task, parse_schedule
from kennfeld.base.errors import InputError

APPLICATION = """application {
	class Plant.Cell representation Plant.Cell.Impl
	class Plant.Sensor
}
schedule {
	startup { process Plant.Cell.init }
	shutdown { }
	task Fast priority 0 scheduling none period 2.5ms delay 0ms {
		process Plant.Cell.calc
		process Plant.Sensor.calc
	}
	task Slow priority 1 period 1s delay 20ms { }
	task Event priority 2 { process Plant.Sensor.event }
}
"""


def test_tasks_have_their_processes_periods_priorities_and_delays():
    schedule = parse_schedule(APPLICATION)
    assert schedule.classes == ("Plant.Cell", "Plant.Sensor")
    assert schedule.startup == ("Plant.Cell.init",)
    assert schedule.tasks == (
        Task("Fast", ("Plant.Cell.calc", "Plant.Sensor.calc"), 0.0025),
        Task("Slow", (), 1.0, priority=1, delay=0.02),
        Task("Event", ("Plant.Sensor.event",), priority=2),
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schedule { task T period 5parsec { } }", "line 1, column 27: expected one of the units"),
        ("schedule { task T period 0ms { } }", "a period must be a finite time > 0"),
        ("schedule { task T delay fast { } }", "expected a delay such as 10ms"),
        ("schedule { task T priority 1.5 { } }", "a priority must be an integer"),
        ("schedule { task T { process } }", "expected a name"),
        ("application { class A", "} is missing"),
        ("tasks", "expected 'schedule'"),
    ],
)
def test_errors_name_the_place(text, message):
    with pytest.raises(InputError, match=message):
        parse_schedule(text)
