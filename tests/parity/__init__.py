"""The numpy runtime held against the float64 oracle, and against diffusers."""
