"""Block handlers, grouped by Simulink library; importing a module registers its handlers."""

from kennfeld.importers.simulink.blocks import (  # noqa: F401
    bit_operations,
    continuous,
    delays,
    discontinuities,
    discrete,
    logic,
    lookup_tables,
    math_operations,
    matrix_operations,
    pid_controllers,
    ports_and_subsystems,
    prelookup_tables,
    recorded_sources,
    signal_attributes,
    signal_routing,
    sources,
    toolbox_blocks,
    user_defined_functions,
)
