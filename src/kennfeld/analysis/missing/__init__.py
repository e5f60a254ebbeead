"""Which term is missing in a function, and where: candidates, their scores, refits, and patches of formula text."""
