"""Fuzzing of everything that reads a file, guided by coverage (`make fuzz`) and blind (CI)."""
