"""Inputs that are hard on the arithmetic, by name, each against the oracle or its documented error.

`case` says what a hard case is; each `*_cases` module is a registry of one room of the runtime;
`test_catalogue` runs them all. Whole runs of the loop are data of the bench
(`spotlight_bench.stability_cases`), which also measures how their errors grow.
"""
