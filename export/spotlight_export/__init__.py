"""Turn torch checkpoints into SpotLight model folders: trace, store, quantise, verify."""
