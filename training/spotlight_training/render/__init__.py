"""Renders the scenes that SpotLight is trained and judged on.

Procedural rooms and objects under many single lights.
"""
