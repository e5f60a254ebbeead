"""The problem: criteria, penalties and limits over the samples, checked."""
