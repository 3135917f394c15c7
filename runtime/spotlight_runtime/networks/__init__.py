"""Model folders and the ONNX sessions they open."""
