"""What is relit: intrinsic maps of background and object, and the files they come in."""
