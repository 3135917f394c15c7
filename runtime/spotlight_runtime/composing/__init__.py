"""From a photograph and a product to a scene."""
