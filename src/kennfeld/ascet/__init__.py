"""ESDL, the textual language of ASCET: lexer, syntax tree and parser, and the task schedules of applications."""
