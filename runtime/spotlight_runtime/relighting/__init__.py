"""From a scene and its lights to a relit picture at the photograph's size."""
