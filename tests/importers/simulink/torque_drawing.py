"""The paper's torque model, drawn as blocks and written as formula."""

from tests.importers.simulink.simulink_files import Model

TORQUE = """
trqOpt = MapOptTorque(Speed, Rel_Airmass)
ignOpt = MapOptIgnition(Speed, Rel_Airmass)
deltaSpark = ignOpt - Ignition
etaSpark = CurveEtaDeltaSpark(deltaSpark)
product = trqOpt * etaSpark
dragTorque = MapDragTorque(Speed, Rel_Airmass)
TorquePredict = product - dragTorque
"""

SHARED = dict.fromkeys(("MapOptTorque", "MapOptIgnition", "MapDragTorque"), ("n", "q"))


def torque(axes=SHARED):
    """The model; `axes` names the variables of the breakpoints of its maps."""
    drawn = Model("torque", step="0.1", solver="FixedStepDiscrete")
    for name in ("Speed", "Rel_Airmass", "Ignition"):
        drawn.inport(name)
    inner = drawn.subsystem("Engine")
    for name in ("Speed", "Rel_Airmass", "Ignition"):
        inner.inport(name)
    for table, (first, second) in axes.items():
        inner.block("Lookup_n-D", table, ports=(2, 1), Table=table, ExtrapMethod="Clip",
                    BreakpointsForDimension1=first, BreakpointsForDimension2=second)  # fmt: skip
        inner.line("Speed", f"{table}:1")
        inner.line("Rel_Airmass", f"{table}:2")
    inner.block("Sum", "deltaSpark", ports=(2, 1), Inputs="+-")
    inner.block("Lookup_n-D", "etaSpark", ports=(1, 1), NumberOfTableDimensions="1", Table="CurveEtaDeltaSpark",
                BreakpointsForDimension1="d", ExtrapMethod="Clip")  # fmt: skip
    inner.block("Product", "product", ports=(2, 1))
    inner.block("Sum", "Sum", ports=(2, 1), Inputs="+-")
    inner.outport("TorquePredict")
    inner.line("MapOptIgnition", "deltaSpark:1")
    inner.line("Ignition", "deltaSpark:2")
    inner.chain("deltaSpark", "etaSpark")
    inner.line("MapOptTorque", "product:1", name="trqOpt")
    inner.line("etaSpark", "product:2")
    inner.line("product", "Sum:1")
    inner.line("MapDragTorque", "Sum:2", name="dragTorque")
    inner.chain("Sum", "TorquePredict")
    for at, name in enumerate(("Speed", "Rel_Airmass", "Ignition"), 1):
        drawn.line(name, f"Engine:{at}")
    drawn.outport("TorquePredict")
    drawn.chain("Engine", "TorquePredict")
    return drawn
