"""The block types by family; importing them enters them in the registry."""

from kennfeld.models.simulink.blocktypes import (
    arithmetic,
    bits,
    conditional,
    continuous,
    controllers,
    delays,
    discrete,
    functions,
    logic,
    matrices,
    nonlinear,
    ports,
    routing,
    sources,
    stores,
    tables,
)

__all__ = [
    "arithmetic",
    "bits",
    "conditional",
    "continuous",
    "controllers",
    "delays",
    "discrete",
    "functions",
    "logic",
    "matrices",
    "nonlinear",
    "ports",
    "routing",
    "sources",
    "stores",
    "tables",
]
