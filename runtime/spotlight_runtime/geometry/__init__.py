"""Cameras, floors, meshes, lights and rays, in metres and radians."""
