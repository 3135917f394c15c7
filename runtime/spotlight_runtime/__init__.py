"""SpotLight at run time."""
