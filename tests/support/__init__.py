"""Helpers shared by several suites."""
