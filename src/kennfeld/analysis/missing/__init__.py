"""Terms that a function lacks, and where: candidates, their scores, refits, and patches of formula text."""
