"""The block types by family; importing them enters them in the registry."""

from kennfeld.models.simulink.blocktypes import (
    arithmetic,
    charts,
    conditional,
    continuous,
    controllers,
    delays,
    discrete,
    functions,
    logic,
    nonlinear,
    ports,
    routing,
    sources,
    stores,
    tables,
)

__all__ = [
    "arithmetic",
    "charts",
    "conditional",
    "continuous",
    "controllers",
    "delays",
    "discrete",
    "functions",
    "logic",
    "nonlinear",
    "ports",
    "routing",
    "sources",
    "stores",
    "tables",
]
