"""Holds what textual languages share: positions, tokens, a parser of operators, and the tree of imperative code."""
