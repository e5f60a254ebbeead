"""States that keep their history, against a simulation in Python."""

import numpy as np
import pytest

from tests.importers.ascet.esdl_projects import class_model, run

# Idle, and Run with the inner states Low and High, which has Left and Right in it
TEXT = """type States is enum { Idle, Low, Left, Right };
class C {
	@set boolean go = false; @set boolean up = false; @set boolean turn = false; @set boolean again = false;
	@get real trace = 0.0;
	void log(real in digit) { trace = trace * 10.0 + digit; }
	public void step() triggers M;
	public States now() { return M.getState(); }
	void clear() { trace = 0.0; }
	statemachine M using States {
		start Idle;
		state Idle { transition go to Run; }
		state Run {
			RUN
			entry { log(1.0); } exit { log(2.0); } static { log(9.0); }
			transition !go to Idle;
			transition again to Run;
			start Low;
			state Low { entry { log(3.0); } transition up to High; }
			state High {
				HIGH
				entry { log(4.0); } exit { log(5.0); }
				transition !up to Low;
				start Left;
				state Left { entry { log(6.0); } exit { log(8.0); } transition turn to Right; }
				state Right { entry { log(7.0); } }
			}
		}
	}
}
"""


class Machine:
    """The same machine by hand: `run` and `high` say which states keep their history."""

    def __init__(self, run, high):
        self.keeps_run, self.keeps_high = run, high
        self.state, self.in_run, self.in_high, self.trace = "Idle", "Low", "Left", 0.0

    def log(self, *digits):
        for digit in digits:
            self.trace = self.trace * 10.0 + digit

    def leave(self):
        if self.state in ("Left", "Right"):
            self.leave_high()
            self.in_run = "High"
        else:
            self.in_run = "Low"
        self.log(2)

    def leave_high(self):
        self.in_high = self.state
        if self.state == "Left":
            self.log(8)
        self.log(5)

    def enter(self):
        self.log(1)
        if self.keeps_run and self.in_run == "High":
            self.enter_high()
        else:
            self.log(3)
            self.state = "Low"

    def enter_high(self):
        self.log(4)
        self.state = self.in_high if self.keeps_high else "Left"
        self.log(6 if self.state == "Left" else 7)

    def step(self, go, up, turn, again):
        if self.state == "Idle":
            if go:
                self.enter()
        elif not go:
            self.leave()
            self.state = "Idle"
        elif again:
            self.leave()
            self.enter()
        elif self.state == "Low" and up:
            self.enter_high()
            self.log(9)
        elif self.state in ("Left", "Right") and not up:
            self.leave_high()
            self.log(3, 9)
            self.state = "Low"
        elif self.state == "Left" and turn:
            self.log(8, 7, 9)
            self.state = "Right"
        else:
            self.log(9)
        return ("Idle", "Low", "Left", "Right").index(self.state)


@pytest.mark.parametrize(("keeps_run", "keeps_high"), [(True, True), (True, False), (False, True), (False, False)])
def test_a_state_is_entered_with_the_inner_state_in_which_it_was_left(tmp_path, keeps_run, keeps_high):
    text = TEXT.replace("RUN", "history;" * keeps_run).replace("HIGH", "history;" * keeps_high)
    # the trace of a step alone fits into a number
    text = text.replace(
        "public void step() triggers M;", "public void begin_trace() { clear(); } public void step() triggers M;"
    )
    model = class_model(tmp_path, text, methods=["begin_trace", "step", "now"])
    random = np.random.default_rng(5)
    columns = {name: (random.uniform(size=300) < share).astype(float)
               for name, share in (("go", 0.75), ("up", 0.6), ("turn", 0.4), ("again", 0.15))}  # fmt: skip
    nodes, machine = run(model, columns), Machine(keeps_run, keeps_high)
    seen = []
    for at, row in enumerate(zip(*columns.values(), strict=True)):
        machine.trace = 0.0
        seen.append(machine.step(*map(bool, row)))
        assert (nodes["now"][at], nodes["trace"][at]) == (seen[-1], machine.trace), at
    assert set(seen) == {0, 1, 2, 3}
