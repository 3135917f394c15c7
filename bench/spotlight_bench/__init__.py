"""Evaluation of backbones and methods against ground truth."""
