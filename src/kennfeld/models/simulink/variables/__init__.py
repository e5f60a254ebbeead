"""The variables of a model: where their values come from, and what a name means to a block."""
