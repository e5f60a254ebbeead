"""Components of ASCET 6 that tests and the fuzzer share: tables, filters, conditions and a state machine."""

from tests.importers.ascet.amd_files import Component, Drawing, Item, Method, instance, message, parameter

FILTER = Drawing()
_error = FILTER.operator("-", FILTER.element("in", "Argument", "calc"), FILTER.element("memory"))
_gain = FILTER.operator("*", _error, FILTER.operator("/", FILTER.element("dT"), FILTER.element("T")))
FILTER.write("memory", FILTER.operator("+", FILTER.element("memory"), _gain), ("calc", 1))
FILTER.write("return", FILTER.element("memory"), ("calc", 2), "Return")
LOW_PASS = Component(
    "LowPass",
    [Item("memory", value=0.5), parameter("T", 0.4, others={"Slow": 2.0}), Item("dT", basic="dt", scope="imported")],
    [Method("calc", [Item("in")], Item("return"))],
    FILTER,
    "Lib",
    "ASCET_Class",
)
X, Y = [0.0, 10.0, 30.0], [0.0, 1.0]
MAP = [[1.0, 2.0, 4.0], [2.0, 1.0, 7.0]]  # a row for each y
ELEMENTS = [
    message("n", unit="rpm"),
    message("load"),
    message("torque", "exported", unit="Nm"),
    message("high", "exported", basic="log"),
    parameter("gain", 1.5, scope="exported", limits=(0, 10), comment="gain of  all"),
    parameter("limit", 12.0),
    parameter("curve", (X, [1.0, 3.0, 2.0]), scope="exported", unit="Nm"),
    parameter("map", (X, Y, MAP)),
    Item("count", value=0.0),
    instance("slow", "/Lib/LowPass", "Slow"),
    instance("fast", "/Lib/LowPass"),
]


def plant_component(elements=ELEMENTS, name="Plant"):
    drawing = Drawing()
    n, load = drawing.element("n"), drawing.element("load")
    base = drawing.value_of("curve", "getAt", "oned", x=n)
    drawing.begin()
    field = drawing.value_of("map", "getAt", "twod", x=drawing.element("n"), y=drawing.element("load"))
    added = drawing.end(result=field)["result"]
    total = drawing.operator("*", drawing.element("gain", "Parameter"), drawing.operator("+", base, added))
    drawing.write("torque", drawing.value_of("slow", "calc", **{"in": total}), ("calc", 2))
    yes, no = drawing.control("IfThenElse", drawing.operator(">", n, drawing.element("limit")), ("calc", 1))
    drawing.write("high", drawing.literal("true"), (yes, 2))
    drawing.write("count", drawing.operator("+", drawing.element("count"), drawing.literal("1.0")), (yes, 1))
    drawing.write("high", drawing.literal("false"), (no, 1))
    (inner,) = drawing.control("IfThen", drawing.operator(">", load, drawing.literal("0.5")), (no, 2))
    drawing.write("count", drawing.value_of("fast", "calc", **{"in": load}), (inner, 1))
    return Component(name, elements, [Method("calc")], drawing)


def _machine():
    def action(kind, name):
        return f'<{kind}><MethodAction methodName="{name}"/></{kind}>'

    def state(name, start, ports, *actions):
        connectors = "".join(f'<Connector graphicOID="{port}"/>' for port in ports)
        return (
            f'<DiagramElement><State name="{name}" history="false" startState="{start}"><Interfaces>{connectors}'
            f"</Interfaces><Actions>{''.join(actions)}</Actions></State></DiagramElement>"
        )

    def transition(first, last, priority, condition):
        ends = f'<Start graphicOID="{first}"/><End graphicOID="{last}"/>'
        return (
            f'<DiagramElement><Transition priority="{priority}" triggerName="run">{ends}<Actions>'
            f"{action('Condition', condition)}</Actions></Transition></DiagramElement>"
        )

    return (
        state("Off", "true", (101, 102), action("EntryAction", "stop"))
        + state("On", "false", (103, 104), action("EntryAction", "start"), action("StaticAction", "count"))
        + transition(101, 103, 1, "is_high")
        + transition(104, 102, 1, "is_low")
    )


def machine_component():
    drawing = Drawing()
    drawing.write("torque", drawing.literal("0.0"), ("stop", 1))
    drawing.write("torque", drawing.literal("1.0"), ("start", 1))
    counted = drawing.operator("+", drawing.element("torque"), drawing.literal("10.0"))
    drawing.write("torque", counted, ("count", 1))
    n = drawing.element("n")
    drawing.write("return", drawing.operator(">", n, drawing.literal("5")), ("is_high", 1), "Return")
    drawing.write("return", drawing.operator("<", n, drawing.literal("3")), ("is_low", 1), "Return")
    actions = [Method(name, public=False) for name in ("stop", "start", "count")]
    conditions = [Method(name, result=Item("", basic="log"), public=False) for name in ("is_high", "is_low")]
    return Component("Plant", ELEMENTS[:3], [Method("run"), *actions, *conditions], drawing, machine=_machine())
