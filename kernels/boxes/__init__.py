"""Boxes around primitives: trees, spatial hashes, and the operations on sixteen boxes at once."""
