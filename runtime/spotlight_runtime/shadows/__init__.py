"""Guiding shadows: cast from lights on what a depth map shows, or drawn by hand."""
