"""Random charts against the interpreter: hierarchy, parallel states, junctions, histories, events, timers."""

import numpy as np
import pytest

from tests.draws import mostly_slow
from tests.importers.simulink.chart_runs import both
from tests.importers.simulink.simulink_files import Chart

DATA = [("u", "INPUT_DATA"), ("v", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("z", "OUTPUT_DATA"), ("w", "LOCAL_DATA", "1")]
CONDITIONS = ("u > 0", "u < -0.3", "v > 0.5", "u > v", "w > y", "v < 0 && u < 1", "!(u > 0.4)", "w <= 2 || v > 1")
TIMES = ("after(2, tick)", "after(300, msec)", "before(3, tick)", "at(2, tick)", "every(2, tick)")
ACTIONS = ("y += 1", "z = y + u", "w = v", "y = 0.5*y - w", "z -= 2", "w += 0.25")


class Drawing:
    """A chart drawn by chance; the events that it sends always go to a later parallel state."""

    def __init__(self, seed):
        self.random = np.random.default_rng(seed)
        self.states, self.parents, self.parallel, self.arrows = {}, {}, [], []
        self.junctions, self.histories, self.events = [], [], []

    def one_of(self, *choices):
        return choices[self.random.integers(len(choices))]

    def chance(self, share):
        return self.random.random() < share

    def chart(self):
        self.fill("", 0)
        return Chart(
            self.states, self.arrows, DATA, self.events, self.parents, tuple(self.parallel), tuple(self.junctions),
            tuple(self.histories),
        )  # fmt: skip

    def fill(self, holder, depth):
        """Draw what is in a state: two or three states, all at once or one at a time."""
        names = [f"S{len(self.states) + at}" for at in range(2 + self.chance(0.4))]
        together = self.chance(0.35)
        for name in names:
            self.states[name], self.parents[name] = name, holder
        if together:
            self.parallel.append(holder)
            self.event(names)
        elif holder and self.chance(0.3):
            self.histories.append(f"H{holder}")
            self.parents[f"H{holder}"] = holder
        for name in names:
            self.label(name)
            if depth < 2 and self.chance(0.5 if depth else 0.7):
                self.fill(name, depth + 1)
        if not together:
            self.arrows.append(("", names[0], self.braced("{}")))
            self.connect(holder, names)

    def event(self, names):
        self.events.append((f"E{len(self.events)}", "LOCAL_EVENT", "FUNCTION_CALL_EVENT", names[-1]))

    def label(self, name):
        kinds = [kind for kind in ("en", "du", "ex", "entry, during") if self.chance(0.45)]
        lines = [f"{kind}: {self.one_of(*ACTIONS)};" for kind in kinds]
        if self.chance(0.3):
            lines.append(f"on {self.one_of(*TIMES[-2:])}: {self.one_of(*ACTIONS)};")
        self.states[name] = "\n".join([name, *lines])

    def braced(self, form):
        return form.replace("{}", "{" + self.one_of(*ACTIONS) + ";}") if self.chance(0.6) else ""

    def written(self, source, holder):
        """The label of a transition from a state."""
        event = self.one_of(*TIMES) if self.chance(0.25) else ""
        heard = [name for name, _, _, owner in self.events if owner in self.around(source)]
        if heard and self.chance(0.4):
            event = self.one_of(*heard)
        condition = f"[{self.one_of(*CONDITIONS)}]" if not event or self.chance(0.7) else ""
        sent = [f"send({name}, {owner})" for name, *_, owner in self.events if not self.meets(owner, source)]
        after = f"/{{{self.one_of(*sent)};}}" if sent and self.chance(0.2) else self.braced("/{}")
        return event + condition + self.braced("{}") + after

    def around(self, name):
        path = [name]
        while self.parents.get(path[-1]):
            path.append(self.parents[path[-1]])
        return path

    def meets(self, owner, source):
        """Return whether one of two states is within the other."""
        return owner in self.around(source) or source in self.around(owner)

    def connect(self, holder, names):
        """Draw transitions among states, some through junctions, into deeper states and within a state."""
        for name in names:
            for _ in range(1 + self.chance(0.5)):
                deeper = [one for one in self.states if name not in self.around(one) and holder in self.around(one)[1:]]
                target = self.one_of(*names, *(deeper or names))
                self.arrow(name, target, holder)
        if holder and self.chance(0.4):
            self.arrow(holder, self.one_of(*names), holder)

    def arrow(self, source, target, holder):
        label = self.written(source, holder)
        if not self.chance(0.35):
            self.arrows.append((source, target, label, holder))
            return
        first, second = (f"J{len(self.junctions) + at}" for at in range(2))
        for name in (first, second):
            self.junctions.append(name)
            self.parents[name] = holder
        self.arrows += [
            (source, first, label, holder),
            (first, second, f"[{self.one_of(*CONDITIONS)}]{self.braced('{}')}", holder),
            (first, target, f"[{self.one_of(*CONDITIONS)}]", holder),
            (second, target, f"[{self.one_of(*CONDITIONS)}]{self.braced('/{}')}", holder),
        ]
        if self.chance(0.5):
            self.arrows.append((second, first if self.chance(0.0) else target, self.braced("{}"), holder))


@pytest.mark.parametrize("seed", mostly_slow(range(40), 2))
def test_random_charts_run_as_an_interpreter_does(seed, tmp_path):
    random = np.random.default_rng(1000 + seed)
    columns = {name: np.round(random.normal(size=80), 2) for name in ("u", "v")}
    for simulated, expected in both(Drawing(seed).chart(), tmp_path, columns, ("y", "z")):
        np.testing.assert_allclose(simulated, expected, rtol=1e-9, atol=1e-9)
