"""An interpreter of the charts that `simulink_files` draws: one state at a time, values in a dictionary, Python's eval.

It follows the documented semantics directly, without guards and graphs, and shares no code with the import.
"""

import re

import numpy as np

from tests.importers.simulink.simulink_files import Chart, Model
from tests.importers.simulink.simulink_runs import imported, run

RANDOM = np.random.default_rng(5)
U = np.round(RANDOM.normal(size=120), 2)
V = np.round(RANDOM.normal(size=120), 2)
IO = [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA")]


class LeftError(Exception):
    """An event that an action has sent has left the state that the action belongs to."""


class Reference:
    """A chart that is run step by step with `dt` between them."""

    def __init__(self, chart, dt=0.1, **parameters):
        self.chart, self.dt, self.t = chart, dt, 0.0
        self.values = {name: float((rest or ["0"])[0] or 0) for name, _, *rest in chart.data} | parameters
        self.active, self.child, self.history = set(), {}, {}
        self.ticks, self.entered, self.counts = {}, {}, {}
        self.event, self.begun, self.last = None, False, {}
        self.names = [name for name in chart.states if name not in chart.functions]

    # structure

    def children(self, name):
        return [one for one in self.names if self.chart.parents.get(one, "") == name]

    def arrows(self, source, inner=False):
        """The transitions that leave a state or junction; of "in S" the default transitions of S."""
        for one in self.chart.transitions:
            holder = self.chart.holder(one)
            if source.startswith("in "):
                if one[0] == "" and holder == source[3:]:
                    yield one
            elif one[0] == source and ((holder == source) == inner or source not in self.names):
                yield one

    # text

    def label(self, name):
        """The actions of a state: (kinds, code)."""
        actions = []
        for line in self.chart.states[name].split("\n")[1:]:
            kinds, _, code = line.partition(":")
            actions.append(([kind.strip() for kind in re.split(r",(?![^(]*\))", kinds)], code))
        return actions

    def truth(self, text, owner):
        text = text.replace("&&", " and ").replace("||", " or ").replace("!=", "~~").replace("!", " not ")
        scope = {
            "after": lambda n, unit: self.passed(owner, unit) >= n - 1e-9,
            "before": lambda n, unit: self.passed(owner, unit) < n - 1e-9,
            "at": lambda n, unit: self.passed(owner, unit) == n,
            "every": lambda n, unit: self.passed(owner, unit) > 0 and self.passed(owner, unit) % n == 0,
            "temporalCount": lambda unit: self.passed(owner, unit),
            "hasChanged": lambda name: self.now[name] != self.before[name],
            "active": lambda name: name in self.active,
            "tick": "tick", "sec": "sec", "msec": "msec", "abs": abs, "min": min, "max": max,
        }  # fmt: skip
        text = re.sub(r"\bin\(([\w.]+)\)", r"active('\1')", text.replace("~~", "!="))
        text = re.sub(r"hasChanged\((\w+)\)", r"hasChanged('\1')", text)
        names = {one[0]: one[0] for one in self.chart.events}
        return eval(text, {"__builtins__": {}}, {**names, **self.values, **scope})

    def passed(self, owner, unit):
        if unit in ("sec", "msec"):
            return (self.t - self.entered[owner]) * (1 if unit == "sec" else 1000)
        return self.ticks[owner] if unit == "tick" else self.counts.get((owner, unit), 0)

    def happens(self, text, owner):
        for event in filter(None, (part.strip() for part in text.split("|"))):
            match = re.match(r"(after|before|at|every)\((.*),\s*(\w+)\)", event)
            base = match[3] if match else event
            now = base in ("sec", "msec") or self.event == (None if base == "tick" else base)
            if now and (not match or self.truth(event, owner)):
                return True
        return not text.strip()

    def act(self, code, owner, alive):
        for statement in filter(None, (part.strip() for part in code.split(";"))):
            events = {one[0]: (*one, "")[3] for one in self.chart.events}
            sent = re.match(r"send\((\w+)(?:,\s*(\w+))?\)$|(?:(\w+)\.)?(\w+)$", statement)
            if sent and (sent[1] or sent[4]) in events:
                event = sent[1] or sent[4]
                self.send(event, sent[2] or sent[3] or events[event])
                if not alive():
                    raise LeftError
                continue
            name, change, value = re.match(r"(\w+)\s*([-+*]?)=\s*(.*)$", statement).groups()
            value = self.truth(value, owner)
            old = self.values[name]
            self.values[name] = float({"": value, "+": old + value, "-": old - value, "*": old * value}[change])

    def send(self, event, to):
        outer, self.event = self.event, event
        for state in self.active:
            self.counts[state, event] = self.counts.get((state, event), 0) + 1
        if to == "":
            self.run_children("")
        elif to in self.active:
            self.execute(to)
        self.event = outer

    # semantics

    def step(self, **inputs):
        self.values.update(inputs)
        self.before, self.now = self.last or dict(self.values), dict(self.values)
        self.last = self.now
        self.event = None
        for state in self.ticks:
            self.ticks[state] += 1
        if not self.children(""):
            self.search("in ", "", [], [])
        elif not self.begun:
            self.begun = True
            self.enter_children("")
        else:
            self.run_children("")
        self.t += self.dt
        return dict(self.values)

    def run_children(self, name):
        for one in self.children(name):
            if one in self.active:
                was = self.child.get(name)
                self.execute(one)
                if name not in self.chart.parallel and was == one:
                    return

    def execute(self, name):
        alive = lambda: name in self.active  # noqa: E731
        if self.transitions(name, name, False) or not alive():
            return
        for kinds, code in self.label(name):
            on = [kind[3:] for kind in kinds if kind.startswith("on ")]
            if {"during", "du"} & set(kinds) or (on and any(self.happens(one, name) for one in on)):
                try:
                    self.act(code, name, alive)
                except LeftError:
                    return
        if self.transitions(name, name, True) or not alive():
            return
        self.run_children(name)

    def transitions(self, source, owner, inner):
        """Take a transition; whether one was taken, or the state was left on the way."""
        try:
            fired = self.search(source, owner, [], [], inner)
        except LeftError:
            return True
        if not fired or fired == "end":
            return False
        target, actions, holders = fired
        top = min(holders, key=lambda one: len(self.chart.around(one)))
        alive = lambda: (top == "" or top in self.active) and not self.child.get(top)  # noqa: E731
        try:
            self.leave_children(top)
            for code in actions:
                self.act(code, owner, alive)
        except LeftError:
            return True
        self.enter_way(top, target)
        return True

    def search(self, source, owner, actions, holders, inner=False):
        for one in self.arrows(source, inner):
            event, condition, before, after = parted(one[2])
            if not self.happens(event, owner) or (condition and not self.truth(condition, owner)):
                continue
            self.act(before, owner, lambda: owner == "" or owner in self.active)
            way = ([*actions, after], [*holders, self.chart.holder(one)])
            if one[1] in self.names:
                return (one[1], *way)
            if one[1] in self.chart.histories:
                return (self.chart.parents.get(one[1], ""), *way)
            if not list(self.arrows(one[1])):
                return "end"
            state = self.search(one[1], owner, *way)
            if state:
                return state
        return None

    def leave_children(self, name):
        for one in reversed(self.children(name)):
            if one in self.active:
                self.leave(one)

    def leave(self, name):
        self.leave_children(name)
        for kinds, code in self.label(name):
            if {"exit", "ex"} & set(kinds):
                self.act(code, name, lambda: name in self.active)
        self.active.discard(name)
        self.child[self.chart.parents.get(name, "")] = None

    def enter_way(self, top, target):
        if target == top:
            self.enter_children(top)
            return
        around = self.chart.around(target)
        self.enter(list(reversed(around[: around.index(top)])))

    def enter(self, way):
        name, parent = way[0], self.chart.parents.get(way[0], "")
        self.active.add(name)
        self.ticks[name], self.entered[name] = 0, self.t
        self.counts = {key: n for key, n in self.counts.items() if key[0] != name}
        if parent not in self.chart.parallel:
            self.child[parent] = self.history[parent] = name
        for kinds, code in self.label(name):
            if {"entry", "en"} & set(kinds):
                try:
                    self.act(code, name, lambda: name in self.active)
                except LeftError:
                    return
        if len(way) == 1:
            self.enter_children(name)
        elif name in self.chart.parallel:
            for one in self.children(name):
                self.enter(way[1:] if one == way[1] else [one])
        else:
            self.enter(way[1:])

    def enter_children(self, name):
        if name in self.chart.parallel:
            for one in self.children(name):
                self.enter([one])
        elif any(self.chart.parents.get(one, "") == name for one in self.chart.histories) and self.history.get(name):
            self.enter([self.history[name]])
        else:
            self.transitions(f"in {name}", name, False)


def parted(label):
    """The event, condition, condition action and transition action of a label."""
    match = re.match(r"([^\[{/]*)(?:\[(.*?)\])?\s*(?:\{(.*?)\})?\s*(?:/\s*\{?(.*?)\}?)?$", label, re.DOTALL)
    return tuple((part or "").strip() for part in match.groups())


def lone(actions, data=IO, **options):
    """A chart of one state, with these actions."""
    return Chart({"A": f"A\n{actions}"}, [("", "A", "")], data, **options)


def pair(first, second, there, back="", data=IO, **options):
    """A chart of two states with these actions, and a transition from one to the other, or to each other."""
    arrows = [("", "A", ""), ("A", "B", there), *([("B", "A", back)] if back else [])]
    return Chart({"A": f"A\n{first}", "B": f"B\n{second}"}, arrows, data, **options)


def drawn_chart(chart, inputs=("u",), outputs=("y",), name="model", **options):
    """A model of one chart "C" between inports and outports."""
    drawn = Model(name, step="0.1", solver="FixedStepDiscrete", **options)
    drawn.chart("C", chart, inputs, outputs)
    drawn.between(inputs, "C", [f"{one}_out" for one in outputs])
    return drawn


def muxed(drawn, names, end):
    """Inports of these names that make one vector, which leads to an input of a block."""
    drawn.block("Mux", "M", ports=(len(names), 1), Inputs=len(names))
    drawn.between(names, "M")
    drawn.line("M", end)


def both(chart, folder, columns, outputs=("y",), parameters=None, layout="slx parts"):
    """Return the results of the import and of the interpreter, for each output."""
    values = parameters or {}
    model = imported(drawn_chart(chart, tuple(columns), outputs), folder, layout, parameters=[values] if values else [])
    recorded = run(model, columns)
    reference = Reference(chart, **values)
    count = len(next(iter(columns.values())))
    steps = [reference.step(**{name: float(column[at]) for name, column in columns.items()}) for at in range(count)]
    return [(recorded[f"{name}_out"], np.array([step[name] for step in steps])) for name in outputs]
