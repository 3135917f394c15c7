"""Properties of whole relights, on any scene."""
