"""The block types by family; importing them enters them in the registry."""

from kennfeld.models.simulink.blocktypes import (
    arithmetic,
    conditional,
    continuous,
    discrete,
    logic,
    nonlinear,
    ports,
    routing,
    sources,
    tables,
)

__all__ = [
    "arithmetic", "conditional", "continuous", "discrete", "logic", "nonlinear", "ports", "routing", "sources",
    "tables",
]  # fmt: skip
